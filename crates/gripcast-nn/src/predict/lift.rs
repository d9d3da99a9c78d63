//! Verdict in the lift: the probability that a grasp holds, from what the gels show in the first
//! millimetres.
//!
//! The prediction before the lift is combined with a small network on the motion of the gels since
//! the grasp: how far the skin is drawn, how much contact and force are left, how much of the
//! contact slips. It does not know how far the gripper has risen; nothing measures that on a hand-held
//! gripper.

use image::RgbImage;
use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};
use gripcast_imaging::TactileDifference;
use gripcast_shear::{ExpectedMarkers, GelMotion, ShearTracker};

/// Metadata key of the lift head.
pub const METADATA: &str = "gripcast.lift";
/// Number of features.
pub const FEATURES: usize = 28;
/// Minimum level and contact of the grasp for ratios.
const MIN_LEVEL: f64 = 0.3;
const MIN_CONTACT: f64 = 0.01;
/// Maximum ratio of level or contact to that of the grasp.
const MAX_RATIO: f64 = 3.0;
/// Maximum log-odds of a verdict.
const MAX_LOGIT: f64 = 5.0;
/// Maximum level of a gel that has lost contact, relative to the level before the lift.
const MAX_LOST_LEVEL: f64 = 0.7;
/// Probability after the loss of contact ([`is_lost`]). Of the 2,262 simulated lifts of the training
/// split 269 lose it so, and 8 of these hold: contacts too light to be seen.
const P_LOST: f64 = 0.03;

/// Features of the motion of both gels: the image before the lift, the previous and the newest one.
pub type Features = [f64; FEATURES];

/// Returns the features of a lift; `before` is the frame before it.
pub fn features(
    before: &[GelMotion; 2],
    previous: &[GelMotion; 2],
    now: &[GelMotion; 2],
) -> Features {
    let gel = |at: usize| {
        let (b, p, n) = (&before[at], &previous[at], &now[at]);
        let ratio = |now: f64, before: f64, min: f64| (now / before.max(min)).min(MAX_RATIO);
        let moved = [0, 1].map(|axis| n.displacement_mm[axis] - b.displacement_mm[axis]);
        let step = [0, 1].map(|axis| n.displacement_mm[axis] - p.displacement_mm[axis]);
        [
            ratio(n.level, b.level, MIN_LEVEL),
            ratio(n.contact_fraction, b.contact_fraction, MIN_CONTACT),
            ratio(n.level, p.level, MIN_LEVEL),
            moved[0].abs(),
            moved[1],
            moved[0].hypot(moved[1]),
            step[0].hypot(step[1]),
            (n.curl - b.curl).abs(),
            n.slip_ratio.unwrap_or(0.0),
            n.slip_ratio.unwrap_or(0.0) - b.slip_ratio.unwrap_or(0.0),
            n.confidence.min(b.confidence),
            b.level,
            b.contact_fraction,
        ]
    };
    let (left, right) = (gel(0), gel(1));
    let mut all = [0.0; FEATURES];
    for (i, (left, right)) in left.into_iter().zip(right).enumerate() {
        // The fingers may be swapped.
        all[2 * i] = left.min(right);
        all[2 * i + 1] = left.max(right);
    }
    all[FEATURES - 2] = f64::from(u8::from(now.iter().all(|gel| gel.has_markers)));
    all[FEATURES - 1] = f64::from(u8::from(now.iter().all(|gel| gel.slip_ratio.is_some())));
    all
}

/// Whether the contact is lost: no gel that touched before the lift touches in the previous and the
/// newest image, and the level of each has fallen.
pub fn is_lost(before: &[GelMotion; 2], previous: &[GelMotion; 2], now: &[GelMotion; 2]) -> bool {
    let touched = |gel: &usize| before[*gel].contact_fraction > 0.0;
    let mut gels = (0..2).filter(touched).peekable();
    gels.peek().is_some()
        && gels.all(|gel| {
            let is_without = |m: &[GelMotion; 2]| {
                m[gel].contact_fraction <= 0.0 && m[gel].level < MAX_LOST_LEVEL * before[gel].level
            };
            is_without(previous) && is_without(now)
        })
}

/// A dense network with one hidden layer on standardised features.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionNetwork {
    /// Mean of each feature.
    pub mean: Vec<f64>,
    /// Standard deviation of each feature.
    pub std: Vec<f64>,
    /// Weights of each hidden unit, the last its bias.
    pub hidden: Vec<Vec<f64>>,
    /// Weights of the output, the last its bias.
    pub output: Vec<f64>,
}

impl MotionNetwork {
    /// Activations of the hidden units (ReLU).
    pub fn hidden(&self, features: &Features) -> Vec<f64> {
        let standardised: Vec<f64> = self.standardised(features).collect();
        let units = self.hidden.iter().map(|weights| {
            let sum: f64 = weights.iter().zip(&standardised).map(|(w, x)| w * x).sum();
            (sum + weights.last().unwrap_or(&0.0)).max(0.0)
        });
        units.collect()
    }

    /// Features with mean 0 and standard deviation 1.
    pub fn standardised(&self, features: &Features) -> impl Iterator<Item = f64> {
        let scales = self.mean.iter().zip(&self.std);
        let values = features.iter().zip(scales);
        values
            .map(|(x, (mean, std))| (x - mean) / std)
            .collect::<Vec<_>>()
            .into_iter()
    }

    /// Log-odds that the grasp holds.
    pub fn logit(&self, features: &Features) -> f64 {
        let hidden = self.hidden(features);
        let sum: f64 = self.output.iter().zip(&hidden).map(|(w, x)| w * x).sum();
        sum + self.output.last().unwrap_or(&0.0)
    }

    fn is_usable(&self) -> bool {
        let rows = [&self.mean, &self.std, &self.output];
        let all = rows.into_iter().chain(&self.hidden).flatten();
        self.mean.len() == FEATURES
            && self.std.len() == FEATURES
            && self.std.iter().all(|std| *std > 0.0)
            && self.hidden.iter().all(|row| row.len() == FEATURES + 1)
            && self.output.len() == self.hidden.len() + 1
            && all.into_iter().all(|x| x.is_finite())
    }
}

/// The lift head of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiftHead {
    /// Network on the motion.
    pub network: MotionNetwork,
    /// Weight of the log-odds before the lift.
    pub prior_weight: f64,
    /// Weight of the log-odds of the motion.
    pub motion_weight: f64,
    /// Offset of the log-odds.
    pub offset: f64,
    /// Minimum probability of a stable grasp.
    pub threshold: f64,
    /// Probability below which the contact is being lost.
    pub alarm: f64,
}

/// Verdict in the lift.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiftVerdict {
    /// Probability that the grasp holds.
    pub p_stable: f64,
    /// Whether it is at least the threshold.
    pub is_stable: bool,
    /// Whether the contact is being lost.
    pub is_slipping: bool,
}

impl LiftHead {
    /// Reads a head from the metadata of a model.
    ///
    /// # Errors
    /// `Input`: it is damaged.
    pub fn from_metadata(text: &str) -> Result<Self> {
        let refused = |what: &str| {
            let what = format!("invalid `{METADATA}` of the model{what}");
            Error::input(what).remedy("train or export the model again")
        };
        let found: Self = serde_json::from_str(text).map_err(|e| refused("").because(e))?;
        let weights = [found.prior_weight, found.motion_weight, found.offset];
        let limits = [found.threshold, found.alarm];
        let is_usable = found.network.is_usable()
            && weights.iter().all(|x| x.is_finite())
            && limits.iter().all(|p| (0.0..=1.0).contains(p));
        match is_usable {
            true => Ok(found),
            false => Err(refused(": expected finite numbers, as many as features")),
        }
    }

    /// Serialises the head for the metadata of a model.
    pub fn to_metadata(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Probability that the grasp holds, from the log-odds before the lift and those of the motion.
    /// It stays between 0.7 and 99.3 %: no set of lifts is large enough to know more.
    pub fn probability(&self, prior: f64, motion: f64) -> f64 {
        let logit = self.prior_weight * prior + self.motion_weight * motion + self.offset;
        let logit = MAX_LOGIT * (logit / MAX_LOGIT).tanh();
        1.0 / (1.0 + (-logit).exp())
    }

    /// Verdict on the newest image of a lift, from the probability before the lift and the motion
    /// since. After the loss of contact ([`is_lost`]) there is an alarm, and the probability is at most 0.03.
    pub fn verdict(
        &self,
        p_before: f64,
        before: &[GelMotion; 2],
        previous: &[GelMotion; 2],
        now: &[GelMotion; 2],
    ) -> LiftVerdict {
        let p = p_before.clamp(1e-6, 1.0 - 1e-6);
        let prior = (p / (1.0 - p)).ln();
        let motion = self.network.logit(&features(before, previous, now));
        let p_stable = self.probability(prior, motion);
        let is_lost = is_lost(before, previous, now);
        let p_stable = if is_lost {
            p_stable.min(P_LOST)
        } else {
            p_stable
        };
        LiftVerdict {
            p_stable,
            is_stable: p_stable >= self.threshold,
            is_slipping: is_lost || p_stable < self.alarm,
        }
    }

    /// Verdicts on the images of a lift, in order; images are those of both gels, 320×240, and 40 ms
    /// apart as in training. `m_per_px` is their scale.
    ///
    /// # Errors
    /// `Input`: images of different sizes.
    pub fn follow<'a>(
        &self,
        p_before: f64,
        initial: [&RgbImage; 2],
        grasp: [&RgbImage; 2],
        lift: impl IntoIterator<Item = [&'a RgbImage; 2]>,
        m_per_px: f64,
        markers: ExpectedMarkers<'_>,
    ) -> Result<Vec<LiftVerdict>> {
        let tracker = |image| ShearTracker::new(image, m_per_px, markers);
        let [left, right] = initial;
        let mut trackers = [tracker(left)?, tracker(right)?];
        let mut motion = |images: [&RgbImage; 2]| -> Result<[GelMotion; 2]> {
            let mut gel = |at: usize| {
                let level = TactileDifference::between(initial[at], images[at])?.mean_abs();
                let shear = trackers[at].update(images[at]);
                Ok::<_, Error>(GelMotion::new(f64::from(level), &shear))
            };
            Ok([gel(0)?, gel(1)?])
        };
        let before = motion(grasp)?;
        let mut previous = before;
        let verdict = |images| {
            let now = motion(images)?;
            let verdict = self.verdict(p_before, &before, &previous, &now);
            previous = now;
            Ok(verdict)
        };
        lift.into_iter().map(verdict).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(level: f64, down_mm: f64) -> [GelMotion; 2] {
        let gel = |level: f64| GelMotion {
            level,
            contact_fraction: 0.1,
            displacement_mm: [0.0, down_mm],
            slip_ratio: Some(0.2),
            confidence: 1.0,
            has_markers: true,
            ..GelMotion::default()
        };
        [gel(level), gel(0.8 * level)]
    }

    fn head() -> LiftHead {
        // Reads the smaller ratio of the levels.
        let mut weights = vec![0.0; FEATURES + 1];
        weights[0] = 1.0;
        LiftHead {
            network: MotionNetwork {
                mean: vec![0.0; FEATURES],
                std: vec![1.0; FEATURES],
                hidden: vec![weights],
                output: vec![4.0, -2.0],
            },
            prior_weight: 1.0,
            motion_weight: 1.0,
            offset: 0.0,
            threshold: 0.5,
            alarm: 0.2,
        }
    }

    #[test]
    fn falling_level_turns_the_verdict() {
        let (head, before) = (head(), motion(10.0, 0.0));
        let verdict = |now: &[GelMotion; 2]| head.verdict(0.5, &before, &before, now);
        let held = verdict(&before);
        let logit = 5.0 * 0.4_f64.tanh();
        assert!((held.p_stable - 1.0 / (1.0 + (-logit).exp())).abs() < 1e-12);
        assert!(held.is_stable && !held.is_slipping);
        let lost = verdict(&motion(1.0, 0.0));
        assert!(!lost.is_stable && lost.is_slipping && lost.p_stable < held.p_stable);
        assert!(head.verdict(0.1, &before, &before, &before).p_stable < held.p_stable);
    }

    #[test]
    fn grasp_without_contact_is_lost() {
        let (mut head, before) = (head(), motion(10.0, 0.0));
        // A head that reads nothing and gives no alarm.
        (head.motion_weight, head.alarm) = (0.0, 0.0);
        let without = |gels: &[usize]| {
            let mut now = before;
            for gel in gels {
                (now[*gel].contact_fraction, now[*gel].level) = (0.0, 1.0);
            }
            now
        };
        let verdict = |previous: &[usize], now: &[usize]| {
            head.verdict(0.99, &before, &without(previous), &without(now))
        };
        let lost = verdict(&[0, 1], &[0, 1]);
        assert!(lost.is_slipping && !lost.is_stable && lost.p_stable <= P_LOST);
        for (previous, now) in [(&[0, 1][..], &[1][..]), (&[0], &[0, 1]), (&[1], &[1])] {
            let seen = verdict(previous, now);
            assert!(seen.is_stable && !seen.is_slipping, "{previous:?} {now:?}");
        }
        let nothing = without(&[0, 1]);
        assert!(!head.verdict(0.99, &nothing, &nothing, &nothing).is_slipping);
        // A light contact that is not seen.
        let mut faint = before;
        faint.iter_mut().for_each(|gel| gel.contact_fraction = 0.0);
        assert!(!head.verdict(0.99, &before, &faint, &faint).is_slipping);
    }

    #[test]
    fn swapped_fingers_have_equal_features() {
        let (before, now) = (motion(10.0, 0.0), motion(4.0, 0.6));
        let swapped = |[a, b]: [GelMotion; 2]| [b, a];
        let expected = features(&before, &before, &now);
        assert_eq!(
            features(&swapped(before), &swapped(before), &swapped(now)),
            expected
        );
        assert!(expected.iter().all(|x| x.is_finite()));
        let nothing = [GelMotion::default(); 2];
        let empty = features(&nothing, &nothing, &nothing);
        assert!(empty.iter().all(|x| x.is_finite()));
    }

    #[test]
    fn metadata_is_read_back_and_damage_refused() {
        let head = head();
        let text = head.to_metadata();
        assert_eq!(LiftHead::from_metadata(&text).unwrap(), head);
        for damaged in [
            text.replacen("4.0", "null", 1),
            text.replacen("[0.0,", "[", 1),
            text.replace("\"alarm\":0.2", "\"alarm\":2.0"),
            "{}".to_owned(),
        ] {
            assert!(LiftHead::from_metadata(&damaged).is_err(), "{damaged}");
        }
    }
}
