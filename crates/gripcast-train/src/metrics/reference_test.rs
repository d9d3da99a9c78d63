//! Samples for the tests, and figures of them computed by other programs.

use super::bootstrap::unit;
use super::*;

pub(super) fn scored(pairs: &[(f64, bool)]) -> Vec<Scored> {
    pairs
        .iter()
        .map(|&(p_stable, stable)| Scored { p_stable, stable })
        .collect()
}

/// Predictions in `levels` steps from 0 to 1, so with ties if `n` is larger.
fn stepped_samples(n: u64, seed: u64, levels: f64) -> Vec<Scored> {
    (0..n)
        .map(|i| {
            let (a, b) = (unit(seed, 2 * i), unit(seed, 2 * i + 1));
            Scored {
                p_stable: (a * (levels + 1.0)).floor() / levels,
                stable: b < 0.15 + 0.7 * a,
            }
        })
        .collect()
}

/// Predictions in steps of 1/32, with many ties; sums and mirror images of them are exact.
pub(super) fn dyadic_samples(n: u64, seed: u64) -> Vec<Scored> {
    stepped_samples(n, seed, 32.0)
}

/// Predictions without ties that are perfectly calibrated.
pub(super) fn smooth_samples(n: u64, seed: u64) -> Vec<Scored> {
    (0..n)
        .map(|i| {
            let p_stable = unit(seed, 2 * i);
            Scored {
                p_stable,
                stable: unit(seed, 2 * i + 1) < p_stable,
            }
        })
        .collect()
}

pub(super) fn flipped(samples: &[Scored]) -> Vec<Scored> {
    let flip = |sample: &Scored| Scored {
        stable: !sample.stable,
        ..*sample
    };
    samples.iter().map(flip).collect()
}

pub(super) fn mapped(samples: &[Scored], map: impl Fn(f64) -> f64) -> Vec<Scored> {
    let mapped = |sample: &Scored| Scored {
        p_stable: map(sample.p_stable),
        ..*sample
    };
    samples.iter().map(mapped).collect()
}

/// Figures of stepped samples by scikit-learn 1.9.1, the log loss of predictions clipped to
/// 1e-7..1 − 1e-7. The calibration error by NumPy 2.4.6, its bins found with `searchsorted`.
struct Reference {
    samples: (u64, u64, f64),
    auroc: f64,
    average_precision: f64,
    brier: f64,
    log_loss: f64,
    ece: f64,
    /// At the threshold 0.6: true stable, false stable, true slip, false slip.
    confusion: [usize; 4],
    balanced_accuracy: f64,
}

const REFERENCES: [Reference; 3] = [
    Reference {
        samples: (500, 7, 40.0),
        auroc: 0.713_987_423_798_780_9,
        average_precision: 0.652_435_948_079_956,
        brier: 0.227_910_000_000_000_03,
        log_loss: 0.906_785_855_203_956_9,
        ece: 0.118_899_999_999_999_96,
        confusion: [133, 66, 185, 116],
        balanced_accuracy: 0.635_594_169_506_712_1,
    },
    Reference {
        samples: (2000, 11, 12.0),
        auroc: 0.750_393_127_373_268_9,
        average_precision: 0.732_876_858_645_274_2,
        brier: 0.212_423_611_111_111_13,
        log_loss: 0.932_044_583_448_552_7,
        ece: 0.088_916_666_666_666_64,
        confusion: [584, 214, 768, 434],
        balanced_accuracy: 0.677_875_631_704_672_4,
    },
    Reference {
        samples: (40, 3, 1e6),
        auroc: 0.561_403_508_771_929_8,
        average_precision: 0.564_501_107_800_172_5,
        brier: 0.264_386_377_352_599_95,
        log_loss: 0.717_140_780_308_443_6,
        ece: 0.271_337_8,
        confusion: [5, 8, 13, 14],
        balanced_accuracy: 0.441_102_756_892_230_55,
    },
];

#[test]
fn metrics_match_scikit_learn() {
    for reference in &REFERENCES {
        let (n, seed, levels) = reference.samples;
        let samples = stepped_samples(n, seed, levels);
        let summary = Summary::new(&samples, 0.6);
        let figures = [
            (summary.auroc, reference.auroc),
            (summary.average_precision, reference.average_precision),
            (summary.brier, reference.brier),
            (summary.log_loss, reference.log_loss),
            (summary.ece, reference.ece),
            (summary.balanced_accuracy, reference.balanced_accuracy),
        ];
        for (ours, theirs) in figures {
            let ours = ours.unwrap();
            assert!((ours - theirs).abs() < 1e-12, "{n}: {ours} {theirs}");
        }
        let matrix = summary.confusion;
        let counts = [
            matrix.true_stable,
            matrix.false_stable,
            matrix.true_slip,
            matrix.false_slip,
        ];
        assert_eq!(counts, reference.confusion);
    }
}

#[test]
fn temperature_matches_scipy() {
    // Minimum of the log loss by scipy.optimize.minimize_scalar (SciPy's bounded method, which
    // knows it to half the digits).
    let references = [
        (
            500,
            7,
            2.835_127_101_878,
            0.772_173_574_155,
            0.621_540_834_439,
        ),
        (
            2000,
            11,
            2.383_850_271_141,
            0.707_891_876_397,
            0.593_209_809_161,
        ),
        (
            40,
            3,
            5.729_993_082_782,
            0.870_083_228_923,
            0.682_191_106_888,
        ),
    ];
    for (n, seed, temperature, before, after) in references {
        let logits: Vec<f64> = (0..n)
            .map(|i| 4.0 * (2.0 * unit(seed, 2 * i) - 1.0))
            .collect();
        let stable: Vec<bool> = stepped_samples(n, seed, 1.0)
            .iter()
            .map(|sample| sample.stable)
            .collect();
        let fit = fit_temperature(&logits, &stable).unwrap();
        assert!(
            (fit.temperature / temperature - 1.0).abs() < 1e-6,
            "{fit:?}"
        );
        assert!((fit.log_loss_before - before).abs() < 1e-11);
        assert!((fit.log_loss_after - after).abs() < 1e-11);
    }
}
