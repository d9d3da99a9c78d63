//! Conformal scores of a model, and the coverage of its prediction sets.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::evaluate::{SEED, grouped, predict};
use super::finish::OBJECTS;
use super::metrics::{Bootstrap, Interval, Scored, resampled_mean};
use super::samples::{SampleFacts, Samples};
use gripcast_base::error::{Error, Result};
use gripcast_nn::predict::conformal::{self, KnownOutcome};
use gripcast_nn::predict::{ConformalLimits, ConformalScores, Model, ModelContract, PredictionSet};

/// Adds the scores of the validation split to the metadata of a model that is written. A split with
/// one label has none.
pub(super) fn add_conformal_scores(
    contract: &mut ModelContract,
    validation: &Samples,
    scored: &[Scored],
) {
    if let Some(scores) = scores("validation", validation.facts(), scored) {
        let metadata = scores.to_metadata();
        contract
            .other
            .insert(conformal::METADATA.to_owned(), metadata);
    }
}

fn scores(source: &str, facts: &[SampleFacts], scored: &[Scored]) -> Option<ConformalScores> {
    let known = facts
        .iter()
        .zip(scored)
        .map(|(facts, scored)| KnownOutcome {
            p_stable: scored.p_stable,
            is_stable: scored.stable,
            object: &facts.object,
        });
    ConformalScores::new(source, known)
}

/// Computes the conformal scores of a model on a split, which must have other objects than its
/// training; `source` is recorded.
///
/// # Errors
/// `Input`: another crop profile, damaged images, or samples of one label only. Errors of reading
/// the dataset.
pub fn conformal_scores(
    model: &Model,
    samples: &Samples,
    source: &str,
    on_progress: &(dyn Fn(usize) + Sync),
) -> Result<ConformalScores> {
    model
        .contract()
        .check_crop_profile(samples.crop_profile())?;
    let inputs = model.contract().modality;
    let available = samples.modality()?;
    if !available.includes(inputs) {
        let what = format!(
            "the scores are those of predictions from {}, the dataset has {}",
            inputs.words(),
            available.words()
        );
        return Err(Error::input(what)
            .at(samples.location())
            .remedy("compute them on a dataset with all inputs of the model"));
    }
    let predictions = predict(model, inputs, samples, on_progress)?;
    let scored: Vec<Scored> = predictions
        .iter()
        .zip(samples.facts())
        .map(|((p_stable, _), facts)| Scored {
            p_stable: *p_stable,
            stable: facts.is_stable,
        })
        .collect();
    scores(source, samples.facts(), &scored).ok_or_else(|| {
        let [slip, stable] = samples.by_label();
        Error::input(format!(
            "conformal scores need grasps with both outcomes, found {stable} stable and {slip} slip"
        ))
        .at(samples.location())
    })
}

/// Names of the objects that a model was trained on, as far as it states them.
pub fn trained_objects(contract: &ModelContract) -> BTreeSet<String> {
    let names = contract.other.get(OBJECTS);
    let names = names.and_then(|names| serde_json::from_str(names).ok());
    names.unwrap_or_default()
}

/// Prediction sets of a model on a split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConformalEvaluation {
    /// Limits of the sets.
    #[serde(flatten)]
    pub limits: ConformalLimits,
    /// Origin of the scores.
    pub scores_of: String,
    /// All samples.
    pub all: ConformalLabel,
    /// Stable samples.
    pub stable: ConformalLabel,
    /// Slips.
    pub slip: ConformalLabel,
}

/// Prediction sets of the samples with one label, or of all; fractions with their 95 % intervals
/// over objects, none where undefined.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConformalLabel {
    /// Number of samples.
    pub n: usize,
    /// Fraction of samples whose outcome is in the set.
    pub coverage: Option<f64>,
    /// Interval of the coverage.
    pub coverage_interval: Option<Interval>,
    /// Fraction of samples with both outcomes in the set.
    pub cant_tell: Option<f64>,
    /// Interval of that fraction.
    pub cant_tell_interval: Option<Interval>,
}

impl ConformalEvaluation {
    /// Evaluates the sets of a model at an error rate.
    ///
    /// # Errors
    /// `Input` where the model has no scores.
    pub(super) fn new(
        model: &Model,
        error_rate: f64,
        facts: &[SampleFacts],
        scored: &[Scored],
    ) -> Result<Self> {
        let limits = model.conformal_limits(error_rate)?;
        let source = model.conformal_scores().map_or("", ConformalScores::source);
        let (_, objects) = grouped(facts, |facts| facts.object.clone());
        let of = |label: Option<bool>| ConformalLabel::new(&limits, &objects, scored, label);
        Ok(Self {
            limits,
            scores_of: source.to_owned(),
            all: of(None),
            stable: of(Some(true)),
            slip: of(Some(false)),
        })
    }
}

impl ConformalLabel {
    /// `objects` holds the object of each sample.
    fn new(
        limits: &ConformalLimits,
        objects: &[usize],
        scored: &[Scored],
        label: Option<bool>,
    ) -> Self {
        let has_label = |one: &&(usize, Scored)| label.is_none_or(|label| one.1.stable == label);
        let present = objects.iter().copied().zip(scored.iter().copied());
        let present: Vec<(usize, Scored)> = present.collect();
        let chosen: Vec<&(usize, Scored)> = present.iter().filter(has_label).collect();
        let objects: Vec<usize> = chosen.iter().map(|(object, _)| *object).collect();
        let fraction = |holds: &dyn Fn(PredictionSet, bool) -> bool| {
            let values: Vec<f64> = chosen
                .iter()
                .map(|(_, one)| {
                    let holds = holds(limits.set_of(one.p_stable), one.stable);
                    f64::from(u8::from(holds))
                })
                .collect();
            let mean = resampled_mean(&values, &vec![1; values.len()]);
            let interval =
                Bootstrap::new(SEED).interval(&objects, |times| resampled_mean(&values, times));
            (mean, interval)
        };
        let (coverage, coverage_interval) = fraction(&PredictionSet::contains);
        let (cant_tell, cant_tell_interval) = fraction(&|set, _| set == PredictionSet::CantTell);
        Self {
            n: chosen.len(),
            coverage,
            coverage_interval,
            cant_tell,
            cant_tell_interval,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverage_is_counted_by_label_and_object() {
        let limits = ConformalLimits {
            error_rate: 0.1,
            max_slip: 0.6,
            min_stable: 0.4,
        };
        let scored = |p_stable, stable| Scored { p_stable, stable };
        // Stable: one told rightly, one cannot tell, one wrongly called slip. Slip: one of each.
        let all = [
            scored(0.9, true),
            scored(0.5, true),
            scored(0.1, true),
            scored(0.2, false),
            scored(0.45, false),
            scored(0.8, false),
            scored(0.3, false),
        ];
        let objects = [0, 0, 1, 1, 2, 2, 2];
        let of = |label| ConformalLabel::new(&limits, &objects, &all, label);
        let [both, stable, slip] = [of(None), of(Some(true)), of(Some(false))];
        assert_eq!((both.n, stable.n, slip.n), (7, 3, 4));
        let near = |found: Option<f64>, wanted: f64| {
            assert!(
                (found.unwrap() - wanted).abs() < 1e-12,
                "{found:?} {wanted}"
            );
        };
        near(both.coverage, 5.0 / 7.0);
        near(both.cant_tell, 2.0 / 7.0);
        near(stable.coverage, 2.0 / 3.0);
        near(stable.cant_tell, 1.0 / 3.0);
        near(slip.coverage, 0.75);
        near(slip.cant_tell, 0.25);
        let interval = both.coverage_interval.unwrap();
        assert!(
            interval.low < 5.0 / 7.0 && interval.high > 5.0 / 7.0,
            "{interval:?}"
        );
        let none = ConformalLabel::new(&limits, &[], &[], None);
        assert_eq!((none.n, none.coverage), (0, None));
    }
}
