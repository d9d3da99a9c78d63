//! Calibration of predicted probabilities.

use serde::{Deserialize, Serialize};

use super::bootstrap::unit;
use super::{Scored, mean_of, present};
use gripcast_base::statistics::quantile;

/// Minimum distance of probabilities from 0 and 1 in the log loss, to keep it finite.
const LOG_LOSS_CLAMP: f64 = 1e-7;

/// Bins of a reliability table, as in Guo et al. (2017).
const BINS: usize = 15;

/// Draws of outcomes for [`ChanceCalibration`].
const DRAWS: u64 = 1000;

/// Minimum distance of an uneven base rate from 0.5.
const UNEVEN: f64 = 0.02;

/// Mean squared difference of probability and outcome, 0..1 (Brier 1950). None without samples.
pub fn brier_score(samples: &[Scored]) -> Option<f64> {
    mean_over(samples, |sample| {
        (sample.p_stable - sample.outcome()).powi(2)
    })
}

/// Mean negative log-likelihood, nats; probabilities are clamped to 1e-7..1 − 1e-7. None without
/// samples.
pub fn log_loss(samples: &[Scored]) -> Option<f64> {
    mean_over(samples, |sample| {
        let p = sample.p_stable.clamp(LOG_LOSS_CLAMP, 1.0 - LOG_LOSS_CLAMP);
        if sample.stable {
            -p.ln()
        } else {
            -(-p).ln_1p()
        }
    })
}

/// Expected calibration error over 15 bins of equal width (Naeini et al. 2015): the sample-weighted
/// mean difference between a bin's mean probability and its fraction of stable samples, 0..1. None
/// without samples.
pub fn expected_calibration_error(samples: &[Scored]) -> Option<f64> {
    ReliabilityTable::new(samples).expected_calibration_error()
}

/// Expected calibration error of perfectly calibrated probabilities: it is above 0 for a finite
/// number of samples (Bröcker & Smith 2007, *Increasing the reliability of reliability diagrams*).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChanceCalibration {
    /// Mean over the draws.
    pub mean: f64,
    /// 95 % quantile: a higher error is significant.
    pub high: f64,
    /// Number of draws.
    pub draws: u64,
}

impl ChanceCalibration {
    /// Draws outcomes from the predicted probabilities. `lifts` holds the lift of each sample:
    /// several images of one lift share its outcome. None without samples.
    pub fn new(samples: &[Scored], lifts: &[usize], seed: u64) -> Option<Self> {
        let count = lifts.iter().max().map_or(0, |last| last + 1) as u64;
        let mut drawn = samples.to_vec();
        let mut errors = Vec::new();
        for draw in 0..DRAWS {
            for (sample, &lift) in drawn.iter_mut().zip(lifts) {
                sample.stable = unit(seed, draw * count + lift as u64) < sample.p_stable;
            }
            errors.extend(expected_calibration_error(&drawn));
        }
        errors.sort_by(f64::total_cmp);
        Some(Self {
            mean: mean_of(errors.iter().sum(), errors.len())?,
            high: quantile(&errors, 0.95)?,
            draws: DRAWS,
        })
    }
}

/// Calibration after prior correction. A model trained on balanced labels assumes a base rate of
/// 0.5; its odds are multiplied by the odds of the samples' base rate (Saerens, Latinne &
/// Decaestecker 2002, *Adjusting the outputs of a classifier to new a priori probabilities*). The
/// base rate is taken from the outcomes, so this is what a user who knows it could reach.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BaseRateCalibration {
    /// Fraction of stable samples, in (0, 1).
    pub base_rate: f64,
    /// Expected calibration error of the adjusted probabilities, 15 bins.
    pub ece: f64,
    /// Brier score of the adjusted probabilities.
    pub brier: f64,
}

impl BaseRateCalibration {
    /// Corrects probabilities for a base rate of 0.5. None without both outcomes.
    pub fn new(samples: &[Scored]) -> Option<Self> {
        let base_rate = mean_over(samples, Scored::outcome)?;
        if base_rate == 0.0 || base_rate == 1.0 {
            return None;
        }
        let adjusted: Vec<Scored> = samples
            .iter()
            .map(|sample| Scored {
                p_stable: at_base_rate(sample.p_stable, base_rate),
                ..*sample
            })
            .collect();
        Some(Self {
            base_rate,
            ece: expected_calibration_error(&adjusted)?,
            brier: brier_score(&adjusted)?,
        })
    }

    /// Returns whether the base rate differs noticeably from 0.5.
    pub fn is_uneven(&self) -> bool {
        (self.base_rate - 0.5).abs() >= UNEVEN
    }
}

/// Returns the probability whose odds are those of `p` times those of the base rate.
fn at_base_rate(p: f64, base_rate: f64) -> f64 {
    let stable = p * base_rate;
    stable / (stable + (1.0 - p) * (1.0 - base_rate))
}

fn mean_over(samples: &[Scored], value: impl Fn(&Scored) -> f64) -> Option<f64> {
    let (n, sum) = present(samples).fold((0, 0.0), |(n, sum), sample| (n + 1, sum + value(sample)));
    mean_of(sum, n)
}

/// Reliability diagram: 15 bins of equal width.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReliabilityTable {
    /// All bins, empty ones included, in ascending order.
    pub bins: Vec<ReliabilityBin>,
}

/// Samples with a probability in (low, high]; the first bin includes 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReliabilityBin {
    /// Lower edge.
    pub low: f64,
    /// Upper edge.
    pub high: f64,
    /// Number of samples.
    pub n: usize,
    /// Mean predicted probability of stable.
    pub mean_p: Option<f64>,
    /// Fraction of stable samples.
    pub stable_fraction: Option<f64>,
}

#[derive(Clone, Copy, Default)]
struct Sums {
    n: usize,
    stable: usize,
    p: f64,
}

impl ReliabilityTable {
    /// Bins the samples.
    pub fn new(samples: &[Scored]) -> Self {
        let mut sums = [Sums::default(); BINS];
        for sample in present(samples) {
            let bin = (1..BINS).take_while(|&i| edge(i) < sample.p_stable).count();
            if let Some(sums) = sums.get_mut(bin) {
                sums.n += 1;
                sums.stable += usize::from(sample.stable);
                sums.p += sample.p_stable;
            }
        }
        let bins = sums.iter().enumerate().map(|(i, sums)| ReliabilityBin {
            low: edge(i),
            high: edge(i + 1),
            n: sums.n,
            mean_p: mean_of(sums.p, sums.n),
            stable_fraction: mean_of(sums.stable as f64, sums.n),
        });
        Self {
            bins: bins.collect(),
        }
    }

    /// Number of samples in all bins.
    pub fn n(&self) -> usize {
        self.bins.iter().map(|bin| bin.n).sum()
    }

    /// See [`expected_calibration_error`].
    pub fn expected_calibration_error(&self) -> Option<f64> {
        let error = |bin: &ReliabilityBin| {
            let gap = bin.mean_p? - bin.stable_fraction?;
            Some(bin.n as f64 * gap.abs())
        };
        mean_of(self.bins.iter().filter_map(error).sum(), self.n())
    }
}

/// Lower edge of a bin.
fn edge(bin: usize) -> f64 {
    bin as f64 / BINS as f64
}

#[cfg(test)]
mod tests {
    use super::super::reference_test::{scored, smooth_samples};
    use super::*;

    #[test]
    fn log_loss_of_certain_mistake_is_clamped() {
        let worst = -(1e-7_f64).ln();
        assert!((log_loss(&scored(&[(0.0, true)])).unwrap() - worst).abs() < 1e-9);
        assert!((log_loss(&scored(&[(1.0, false)])).unwrap() - worst).abs() < 1e-7);
        assert!(log_loss(&scored(&[(1.0, true)])).unwrap() < 2e-7);
        let even = log_loss(&scored(&[(0.5, true), (0.5, false)])).unwrap();
        assert!((even - std::f64::consts::LN_2).abs() < 1e-15);
    }

    #[test]
    fn brier_score_is_mean_square() {
        let samples = scored(&[(0.75, true), (0.5, false)]);
        assert_eq!(brier_score(&samples), Some(0.5 * (0.0625 + 0.25)));
    }

    #[test]
    fn bins_include_upper_edge() {
        let table = ReliabilityTable::new(&scored(&[
            (0.0, false),
            (0.2, true),
            (0.2_f64.next_up(), true),
            (1.0, true),
        ]));
        let filled: Vec<_> = (0..BINS).filter(|&i| table.bins[i].n > 0).collect();
        assert_eq!(filled, [0, 2, 3, 14]);
        assert_eq!(table.bins[2].high, 0.2);
        assert_eq!((table.bins[0].low, table.bins[14].high), (0.0, 1.0));
    }

    #[test]
    fn ece_weights_bins_by_samples() {
        // Bin of 0.9: three samples, mean 0.9, fraction 2/3. Bin of 0.1: one sample, fraction 0.
        let samples = scored(&[(0.9, true), (0.9, true), (0.9, false), (0.1, false)]);
        let expected = 0.75 * (0.9 - 2.0 / 3.0) + 0.25 * 0.1;
        let ece = expected_calibration_error(&samples).unwrap();
        assert!((ece - expected).abs() < 1e-15);
    }

    #[test]
    fn calibrated_predictions_have_small_ece() {
        // These samples are stable with the probability that is predicted.
        let samples = smooth_samples(50_000, 9);
        let calibrated = expected_calibration_error(&samples).unwrap();
        assert!(calibrated < 0.01, "{calibrated}");
        let shifted: Vec<Scored> = samples
            .iter()
            .map(|s| Scored {
                p_stable: (s.p_stable + 0.2).min(1.0),
                ..*s
            })
            .collect();
        let miscalibrated = expected_calibration_error(&shifted).unwrap();
        assert!(miscalibrated > 0.15, "{miscalibrated}");
        assert!(brier_score(&shifted) > brier_score(&samples));
    }

    #[test]
    fn chance_ece_falls_with_samples() {
        let own = |n: usize| (0..n).collect::<Vec<_>>();
        let few = ChanceCalibration::new(&smooth_samples(100, 9), &own(100), 1).unwrap();
        let many = ChanceCalibration::new(&smooth_samples(20_000, 9), &own(20_000), 1).unwrap();
        assert!(few.mean > 0.08 && few.high > few.mean, "{few:?}");
        assert!(many.mean < 0.012, "{many:?}");
        // Calibrated samples stay below it, others do not.
        let right = smooth_samples(2000, 9);
        let chance = ChanceCalibration::new(&right, &own(2000), 1).unwrap();
        assert!(expected_calibration_error(&right).unwrap() < chance.high);
        let wrong = right.iter().map(|s| Scored {
            p_stable: s.p_stable.powi(2),
            ..*s
        });
        let wrong: Vec<Scored> = wrong.collect();
        let chance = ChanceCalibration::new(&wrong, &own(2000), 1).unwrap();
        assert!(expected_calibration_error(&wrong).unwrap() > chance.high);
    }

    #[test]
    fn images_of_one_lift_share_outcome() {
        let once = smooth_samples(200, 4);
        let thrice: Vec<Scored> = once.iter().flat_map(|s| [*s; 3]).collect();
        let lifts: Vec<usize> = (0..600).map(|i| i / 3).collect();
        let own: Vec<usize> = (0..200).collect();
        let one = ChanceCalibration::new(&once, &own, 1).unwrap();
        let three = ChanceCalibration::new(&thrice, &lifts, 1).unwrap();
        assert!((one.mean - three.mean).abs() < 1e-12);
        let apart: Vec<usize> = (0..600).collect();
        let apart = ChanceCalibration::new(&thrice, &apart, 1).unwrap();
        assert!(apart.mean < 0.8 * one.mean);
    }

    #[test]
    fn base_rate_multiplies_odds() {
        assert_eq!(
            [0.0, 0.5, 1.0].map(|p| at_base_rate(p, 0.75)),
            [0.0, 0.75, 1.0]
        );
        // Odds of 1/4 times 3 are odds of 3/4.
        assert!((at_base_rate(0.2, 0.75) - 3.0 / 7.0).abs() < 1e-15);
        for p in [0.01, 0.3, 0.9] {
            assert!((at_base_rate(p, 0.5) - p).abs() < 1e-15);
            assert!((at_base_rate(at_base_rate(p, 0.8), 0.2) - p).abs() < 1e-15);
        }
    }

    #[test]
    fn prior_correction_restores_calibration() {
        // Calibrated for balanced labels; then two of three slip samples are removed.
        let even = smooth_samples(60_000, 9);
        let mut slip = 0;
        let uneven: Vec<Scored> = even
            .iter()
            .filter(|sample| {
                slip += usize::from(!sample.stable);
                sample.stable || slip % 3 == 0
            })
            .copied()
            .collect();
        let raw = expected_calibration_error(&uneven).unwrap();
        let adjusted = BaseRateCalibration::new(&uneven).unwrap();
        assert!((adjusted.base_rate - 0.75).abs() < 0.01, "{adjusted:?}");
        assert!(raw > 0.1 && adjusted.ece < 0.02, "{raw} {adjusted:?}");
        assert!(adjusted.brier < brier_score(&uneven).unwrap() - 0.01);
        assert!(adjusted.is_uneven());
        assert!(!BaseRateCalibration::new(&even).unwrap().is_uneven());
    }

    #[test]
    fn no_samples_have_no_calibration() {
        let absent = scored(&[(f64::NAN, true)]);
        for samples in [&[][..], &absent] {
            assert_eq!(brier_score(samples), None);
            assert_eq!(log_loss(samples), None);
            assert_eq!(expected_calibration_error(samples), None);
            assert_eq!(ReliabilityTable::new(samples).n(), 0);
            let lifts = vec![0; samples.len()];
            assert_eq!(ChanceCalibration::new(samples, &lifts, 0), None);
            assert_eq!(BaseRateCalibration::new(samples), None);
        }
        assert_eq!(BaseRateCalibration::new(&scored(&[(0.4, true)])), None);
    }

    #[test]
    fn out_of_range_probabilities_use_end_bins() {
        let table = ReliabilityTable::new(&scored(&[(-3.0, true), (7.0, true)]));
        assert_eq!((table.bins[0].n, table.bins[14].n), (1, 1));
    }
}
