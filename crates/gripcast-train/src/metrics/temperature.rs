//! Temperature scaling of logits (Guo et al., *On calibration of modern neural networks*, 2017).

use serde::{Deserialize, Serialize};

/// Search range of the temperature.
const RANGE: [f64; 2] = [0.05, 20.0];

/// Bisections of the range of ln T, down to adjacent numbers.
const HALVINGS: usize = 60;

/// A fitted temperature and the log loss on the data it was fitted to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TemperatureFit {
    /// Divisor of the logits; above 1 if the model is overconfident.
    pub temperature: f64,
    /// Mean log loss before scaling, nats, not clamped.
    pub log_loss_before: f64,
    /// Mean log loss after scaling, nats, not clamped.
    pub log_loss_after: f64,
    /// Whether the optimum lies outside of the range 0.05 to 20; the limit is then returned.
    pub at_limit: bool,
}

/// Returns the probability of stable of a logit: 1 / (1 + exp(−logit / temperature)).
pub fn probability_of_logit(logit: f64, temperature: f64) -> f64 {
    sigmoid(logit / temperature)
}

/// Fits the temperature, from 0.05 to 20, that minimises the log loss. **Fit it on validation data
/// only**: on training data the model is overconfident, on test data the result would be biased.
///
/// NaN and infinite logits are ignored, as are elements beyond the shorter slice. None with one
/// class only, or if all logits are 0.
pub fn fit_temperature(logits: &[f64], stable: &[bool]) -> Option<TemperatureFit> {
    let samples: Vec<(f64, bool)> = logits
        .iter()
        .copied()
        .zip(stable.iter().copied())
        .filter(|(logit, _)| logit.is_finite())
        .collect();
    let has_class = |class| samples.iter().any(|&(_, stable)| stable == class);
    let has_information = samples.iter().any(|&(logit, _)| logit != 0.0);
    if !(has_class(true) && has_class(false) && has_information) {
        return None;
    }
    let (temperature, at_limit) = best_temperature(&samples);
    Some(TemperatureFit {
        temperature,
        log_loss_before: log_loss(&samples, 1.0),
        log_loss_after: log_loss(&samples, 1.0 / temperature),
        at_limit,
    })
}

/// Finds the optimum by bisection (the loss is convex in 1/T); also returns whether it is a limit.
fn best_temperature(samples: &[(f64, bool)]) -> (f64, bool) {
    let [min, max] = RANGE;
    if slope(samples, 1.0 / min) <= 0.0 {
        return (min, true);
    }
    if slope(samples, 1.0 / max) >= 0.0 {
        return (max, true);
    }
    let [mut low, mut high] = RANGE.map(f64::ln);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if slope(samples, (-middle).exp()) > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    ((0.5 * (low + high)).exp(), false)
}

/// Derivative of the summed log loss with respect to the factor 1/T.
fn slope(samples: &[(f64, bool)], factor: f64) -> f64 {
    let term = |&(logit, stable): &(f64, bool)| {
        let outcome = f64::from(u8::from(stable));
        logit * (sigmoid(factor * logit) - outcome)
    };
    samples.iter().map(term).sum()
}

fn log_loss(samples: &[(f64, bool)], factor: f64) -> f64 {
    let term = |&(logit, stable): &(f64, bool)| {
        // ln(1 + exp(−x)), x > 0 if the sign of the logit is correct.
        let x = if stable {
            factor * logit
        } else {
            -factor * logit
        };
        (-x).max(0.0) + (-x.abs()).exp().ln_1p()
    };
    samples.iter().map(term).sum::<f64>() / samples.len() as f64
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

#[cfg(test)]
mod tests {
    use super::super::bootstrap::unit;
    use super::*;

    /// Calibrated logits from −3 to 3.
    fn calibrated(n: u64, seed: u64) -> (Vec<f64>, Vec<bool>) {
        (0..n)
            .map(|i| {
                let logit = 6.0 * unit(seed, 2 * i) - 3.0;
                (logit, unit(seed, 2 * i + 1) < sigmoid(logit))
            })
            .unzip()
    }

    #[test]
    fn scaled_logits_are_recovered() {
        let (logits, stable) = calibrated(20_000, 1);
        let calibrated = fit_temperature(&logits, &stable).unwrap();
        assert!(
            (calibrated.temperature - 1.0).abs() < 0.05,
            "{calibrated:?}"
        );
        for distortion in [0.3, 2.5, 6.0] {
            let distorted: Vec<f64> = logits.iter().map(|z| distortion * z).collect();
            let fit = fit_temperature(&distorted, &stable).unwrap();
            let expected = distortion * calibrated.temperature;
            assert!((fit.temperature / expected - 1.0).abs() < 1e-9, "{fit:?}");
            assert!((fit.log_loss_after - calibrated.log_loss_after).abs() < 1e-12);
            assert!(fit.log_loss_before > fit.log_loss_after && !fit.at_limit);
        }
    }

    #[test]
    fn fitted_temperature_is_a_minimum() {
        let (logits, stable) = calibrated(500, 2);
        let samples: Vec<_> = logits.iter().map(|z| 3.0 * z).zip(stable).collect();
        let (temperature, _) = best_temperature(&samples);
        let loss = |t: f64| log_loss(&samples, 1.0 / t);
        assert!(loss(temperature) < loss(temperature * 1.01));
        assert!(loss(temperature) < loss(temperature / 1.01));
    }

    #[test]
    fn fit_reports_limits() {
        let sure = fit_temperature(&[2.0, 1.0, -3.0], &[true, true, false]).unwrap();
        assert_eq!((sure.temperature, sure.at_limit), (0.05, true));
        let wrong = fit_temperature(&[2.0, 1.0, -3.0], &[false, false, true]).unwrap();
        assert_eq!((wrong.temperature, wrong.at_limit), (20.0, true));
        assert!(wrong.log_loss_after < wrong.log_loss_before);
    }

    #[test]
    fn single_class_has_no_temperature() {
        assert_eq!(fit_temperature(&[], &[]), None);
        assert_eq!(fit_temperature(&[1.0, 2.0], &[true, true]), None);
        assert_eq!(fit_temperature(&[0.0, 0.0], &[true, false]), None);
        assert_eq!(fit_temperature(&[f64::NAN, 2.0], &[true, false]), None);
    }

    #[test]
    fn nan_logits_are_ignored() {
        let fit = fit_temperature(&[1.0, -2.0, 0.5], &[true, true, false]);
        let more = [1.0, f64::NAN, -2.0, f64::INFINITY, 0.5];
        assert_eq!(
            fit_temperature(&more, &[true, false, true, false, false, true]),
            fit
        );
        assert!(fit.is_some());
    }

    #[test]
    fn temperature_flattens_probabilities() {
        assert_eq!(probability_of_logit(0.0, 3.0), 0.5);
        assert!(probability_of_logit(2.0, 3.0) < probability_of_logit(2.0, 1.0));
        assert_eq!(probability_of_logit(-800.0, 1.0), 0.0);
        assert_eq!(probability_of_logit(800.0, 1.0), 1.0);
    }
}
