//! Conformal prediction sets: which outcomes a prediction leaves open at a chosen error rate.
//!
//! Split conformal prediction, for each label on its own (Vovk et al. 2005, *Algorithmic Learning
//! in a Random World*, Mondrian; Angelopoulos & Bates 2021, *A gentle introduction to conformal
//! prediction*). The nonconformity score of a label is 1 − its predicted probability. A label is in
//! the set of a prediction unless its score exceeds the (1 − error rate) quantile of the scores of
//! that label among grasps that the model was not trained on. So at most that fraction of the
//! stable grasps, and of the slips, has a set without its outcome, whatever the base rate, as long
//! as grasps resemble those the scores were computed on.
//!
//! Grasps of one object are not independent. The correction of the quantile for the finite number
//! of scores therefore counts objects, not grasps.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use gripcast_base::error::{Error, Result};

/// Key in the metadata of a model.
pub const METADATA: &str = "gripcast.conformal";
/// Maximum number of scores stored per label; more are thinned to this many quantiles.
const MAX_SCORES: usize = 160;
/// Scores are stored as multiples of its inverse, rounded up.
const UNITS: f64 = 1e4;

/// The outcomes that a prediction leaves open.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PredictionSet {
    /// Stable alone.
    Stable,
    /// Slip alone.
    Slip,
    /// Both: the prediction cannot tell.
    CantTell,
}

impl PredictionSet {
    /// Words for people.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Stable => "stable",
            Self::Slip => "slip",
            Self::CantTell => "can't tell",
        }
    }

    /// Whether the outcome is in the set.
    #[must_use]
    pub fn contains(self, is_stable: bool) -> bool {
        match self {
            Self::Stable => is_stable,
            Self::Slip => !is_stable,
            Self::CantTell => true,
        }
    }
}

/// A prediction whose outcome is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownOutcome<'a> {
    /// Predicted probability of stable.
    pub p_stable: f64,
    /// Outcome.
    pub is_stable: bool,
    /// Object.
    pub object: &'a str,
}

/// Nonconformity scores of grasps that a model was not trained on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConformalScores {
    /// Origin of the grasps.
    source: String,
    /// Of slips.
    slip: LabelScores,
    /// Of stable grasps.
    stable: LabelScores,
}

/// Scores of one label.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LabelScores {
    /// Number of objects.
    objects: usize,
    /// Number of grasps.
    grasps: usize,
    /// Scores in ascending order, 1e-4: all of them, or quantiles at equal distances, the last the
    /// maximum.
    scores: Vec<u16>,
}

impl ConformalScores {
    /// Computes the scores of grasps from `source` (words for people). None without both outcomes.
    pub fn new<'a>(
        source: &str,
        known: impl IntoIterator<Item = KnownOutcome<'a>>,
    ) -> Option<Self> {
        let known: Vec<KnownOutcome<'_>> = known
            .into_iter()
            .filter(|one| one.p_stable.is_finite())
            .collect();
        Some(Self {
            source: source.to_owned(),
            slip: LabelScores::new(&known, false)?,
            stable: LabelScores::new(&known, true)?,
        })
    }

    /// Reads the scores from the metadata of a model.
    ///
    /// # Errors
    /// `Input` for invalid scores.
    pub fn from_metadata(text: &str) -> Result<Self> {
        let invalid = || Error::input(format!("invalid `{METADATA}` in the model's metadata"));
        let scores: Self = serde_json::from_str(text).map_err(|e| invalid().because(e))?;
        match [&scores.slip, &scores.stable].iter().all(|s| s.is_valid()) {
            true => Ok(scores),
            false => Err(invalid().remedy("calibrate the model again: gripcast predict conformal")),
        }
    }

    /// Returns the scores as metadata of a model, at most 2 kB.
    #[must_use]
    pub fn to_metadata(&self) -> String {
        // Numbers and strings always serialise.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Origin of the grasps.
    #[must_use]
    pub fn source(&self) -> &str {
        &self.source
    }

    /// Number of grasps: slips, stable.
    #[must_use]
    pub fn grasps(&self) -> [usize; 2] {
        [self.slip.grasps, self.stable.grasps]
    }

    /// Limits of the sets at an error rate in (0, 1).
    #[must_use]
    pub fn limits(&self, error_rate: f64) -> ConformalLimits {
        ConformalLimits {
            error_rate,
            max_slip: self.slip.quantile(error_rate),
            min_stable: 1.0 - self.stable.quantile(error_rate),
        }
    }
}

impl LabelScores {
    fn new(known: &[KnownOutcome<'_>], is_stable: bool) -> Option<Self> {
        let of_label = || known.iter().filter(|one| one.is_stable == is_stable);
        let objects: BTreeSet<&str> = of_label().map(|one| one.object).collect();
        let mut all: Vec<u16> = of_label()
            .map(|one| {
                let p = one.p_stable.clamp(0.0, 1.0);
                let score = if is_stable { 1.0 - p } else { p };
                (score * UNITS).ceil() as u16
            })
            .collect();
        all.sort_unstable();
        let grasps = all.len();
        if grasps == 0 {
            return None;
        }
        let scores = match grasps > MAX_SCORES {
            true => (1..=MAX_SCORES)
                .filter_map(|i| all.get((i * grasps).div_ceil(MAX_SCORES) - 1).copied())
                .collect(),
            false => all,
        };
        Some(Self {
            objects: objects.len(),
            grasps,
            scores,
        })
    }

    fn is_valid(&self) -> bool {
        let in_range = self.scores.iter().all(|s| f64::from(*s) <= UNITS);
        let is_complete = !self.scores.is_empty() && self.scores.len() <= self.grasps;
        let is_counted = (1..=self.grasps).contains(&self.objects);
        in_range && is_complete && is_counted && self.scores.is_sorted()
    }

    /// Score that at least a fraction 1 − `error_rate` of the grasps of a new object does not
    /// exceed; 1, the maximum, if there are too few objects to know.
    fn quantile(&self, error_rate: f64) -> f64 {
        let level = (1.0 - error_rate) * (1.0 + 1.0 / self.objects as f64);
        if level > 1.0 {
            return 1.0;
        }
        let rank = (level * self.scores.len() as f64 - 1e-9).ceil().max(1.0) as usize;
        let score = self.scores.get(rank - 1).copied();
        score.map_or(1.0, |score| f64::from(score) / UNITS)
    }
}

/// Limits of the conformal sets at an error rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConformalLimits {
    /// Error rate.
    pub error_rate: f64,
    /// Slip is in the set up to this probability of stable.
    pub max_slip: f64,
    /// Stable is in the set from this probability of stable.
    pub min_stable: f64,
}

impl ConformalLimits {
    /// The set of a prediction. Between limits that exclude both outcomes it cannot tell either.
    #[must_use]
    pub fn set_of(&self, p_stable: f64) -> PredictionSet {
        match (p_stable >= self.min_stable, p_stable <= self.max_slip) {
            (true, false) => PredictionSet::Stable,
            (false, true) => PredictionSet::Slip,
            _ => PredictionSet::CantTell,
        }
    }
}

#[cfg(test)]
mod tests {
    use gripcast_base::random::SeedStream;

    use super::*;

    /// Grasps whose probability is right, shifted by `shift` in log-odds, of objects that share
    /// part of it.
    fn grasps(seed: u64, objects: usize, shift: f64) -> Vec<(f64, bool, String)> {
        let mut draw = SeedStream::named(seed, "conformal");
        let mut all = Vec::new();
        for object in 0..objects {
            let of_object = draw.between(-1.0, 1.0);
            for _ in 0..4 {
                let logit = of_object + draw.between(-3.0, 3.0);
                let is_stable = draw.uniform() < 1.0 / (1.0 + (-logit).exp());
                let p_stable = 1.0 / (1.0 + (-logit - shift).exp());
                all.push((p_stable, is_stable, format!("o{object}")));
            }
        }
        all
    }

    fn scores(grasps: &[(f64, bool, String)]) -> ConformalScores {
        let known = grasps
            .iter()
            .map(|(p_stable, is_stable, object)| KnownOutcome {
                p_stable: *p_stable,
                is_stable: *is_stable,
                object,
            });
        ConformalScores::new("test", known).unwrap()
    }

    fn coverage(limits: &ConformalLimits, grasps: &[(f64, bool, String)], label: bool) -> f64 {
        let of_label: Vec<_> = grasps.iter().filter(|g| g.1 == label).collect();
        let covered = of_label
            .iter()
            .filter(|g| limits.set_of(g.0).contains(label));
        covered.count() as f64 / of_label.len() as f64
    }

    #[test]
    fn sets_cover_both_labels_at_every_error_rate() {
        let known = scores(&grasps(1, 1000, 0.0));
        let new = grasps(2, 2000, 0.0);
        for error_rate in [0.05, 0.1, 0.2] {
            let limits = known.limits(error_rate);
            for label in [false, true] {
                let found = coverage(&limits, &new, label);
                let wanted = 1.0 - error_rate;
                assert!(
                    (wanted - 0.02..wanted + 0.03).contains(&found),
                    "{label} {found}"
                );
            }
        }
    }

    #[test]
    fn base_rate_does_not_change_the_coverage_of_a_label() {
        let known = scores(&grasps(1, 300, 0.0));
        let mut new = grasps(3, 3000, 0.0);
        let mut slips = 0;
        new.retain(|grasp| {
            slips += usize::from(!grasp.1);
            grasp.1 || slips % 5 == 0
        });
        let found = coverage(&known.limits(0.1), &new, false);
        assert!((0.86..0.95).contains(&found), "{found}");
    }

    #[test]
    fn scores_of_shifted_grasps_restore_coverage() {
        let shifted = grasps(4, 1500, 1.0);
        let other = scores(&grasps(1, 200, 0.0));
        assert!(coverage(&other.limits(0.1), &shifted, false) < 0.82);
        let same = scores(&grasps(5, 200, 1.0));
        let found = coverage(&same.limits(0.1), &shifted, false);
        assert!((0.87..0.95).contains(&found), "{found}");
    }

    #[test]
    fn smaller_error_rates_tell_less() {
        let known = scores(&grasps(1, 200, 0.0));
        let cant_tell = |error_rate: f64| {
            let limits = known.limits(error_rate);
            let all = (0..1000).map(|i| limits.set_of(f64::from(i) / 999.0));
            all.filter(|set| *set == PredictionSet::CantTell).count()
        };
        assert!(cant_tell(0.05) > cant_tell(0.1) && cant_tell(0.1) > cant_tell(0.2));
        // No number of grasps of 200 objects shows an error rate of 0.1 %.
        assert_eq!(cant_tell(0.001), 1000);
        let limits = known.limits(0.1);
        assert_eq!(limits.set_of(0.001), PredictionSet::Slip);
        assert_eq!(limits.set_of(0.999), PredictionSet::Stable);
        assert_eq!(limits.set_of(f64::NAN), PredictionSet::CantTell);
    }

    #[test]
    fn metadata_is_small_and_conservative() {
        let many = grasps(1, 3000, 0.0);
        let all = scores(&many);
        let text = all.to_metadata();
        assert!(text.len() <= 2048, "{}", text.len());
        assert_eq!(ConformalScores::from_metadata(&text).unwrap(), all);
        // Thinned scores are quantiles: at least the exact one, at most the next.
        let mut exact: Vec<f64> = many.iter().filter(|g| !g.1).map(|g| g.0).collect();
        exact.sort_by(f64::total_cmp);
        let level = 0.9 * (1.0 + 1.0 / all.slip.objects as f64);
        let wanted = exact[(level * exact.len() as f64).ceil() as usize - 1];
        let found = all.limits(0.1).max_slip;
        assert!((wanted..wanted + 0.03).contains(&found), "{wanted} {found}");
    }

    #[test]
    fn invalid_metadata_is_refused() {
        let valid = r#"{"source":"s","slip":{"objects":1,"grasps":2,"scores":[1,2]},"stable":{"objects":1,"grasps":1,"scores":[3]}}"#;
        assert!(ConformalScores::from_metadata(valid).is_ok());
        for (from, to) in [
            ("[1,2]", "[2,1]"),
            ("[1,2]", "[]"),
            ("[1,2]", "[1,10001]"),
            ("[1,2]", "[1,2,3]"),
            ("\"objects\":1", "\"objects\":0"),
            ("\"source\":\"s\",", ""),
        ] {
            assert!(
                ConformalScores::from_metadata(&valid.replace(from, to)).is_err(),
                "{to}"
            );
        }
        assert!(
            ConformalScores::new(
                "one label",
                [KnownOutcome {
                    p_stable: 0.5,
                    is_stable: true,
                    object: "a"
                }]
            )
            .is_none()
        );
    }
}
