//! Ridge logistic regression, both labels with the same weight.

use gripcast_base::linear::Symmetric;

/// Ridge penalty of a weight in units of its feature's standard deviation, relative to the loss of
/// one sample.
const RIDGE: f64 = 3.0;
/// Maximum Newton steps.
const STEPS: usize = 30;
/// Newton decrement below which the fit has converged.
const CONVERGED: f64 = 1e-9;

/// Weights of the features, then the bias, of a ridge logistic regression by Newton's method
/// (Hastie, Tibshirani and Friedman, *The Elements of Statistical Learning*, 4.4.1); none without
/// samples of both labels.
pub(super) fn logistic_regression(samples: &[(Vec<f64>, bool)]) -> Option<Vec<f64>> {
    let count = samples.first()?.0.len();
    let n = samples.len() as f64;
    let stable = samples.iter().filter(|(_, stable)| *stable).count() as f64;
    if stable == 0.0 || stable == n {
        return None;
    }
    let mean: Vec<f64> = (0..count)
        .map(|i| samples.iter().map(|(x, _)| x[i]).sum::<f64>() / n)
        .collect();
    let std: Vec<f64> = (0..count)
        .map(|i| {
            let squares = samples.iter().map(|(x, _)| (x[i] - mean[i]).powi(2));
            (squares.sum::<f64>() / n).sqrt()
        })
        .collect();
    // A feature that is constant says nothing.
    let scaled = |x: &[f64]| -> Vec<f64> {
        let scaled = (0..count).map(|i| {
            if std[i] > 1e-9 {
                (x[i] - mean[i]) / std[i]
            } else {
                0.0
            }
        });
        scaled.chain([1.0]).collect()
    };
    let rows: Vec<(Vec<f64>, bool)> = samples.iter().map(|(x, y)| (scaled(x), *y)).collect();
    let mut weights = vec![0.0; count + 1];
    for _ in 0..STEPS {
        let mut hessian = Symmetric::zero(count + 1);
        let mut gradient = vec![0.0; count + 1];
        for i in 0..count {
            hessian.add(i, i, RIDGE);
            gradient[i] += RIDGE * weights[i];
        }
        // The bias is not penalised; this only keeps the system regular.
        hessian.add(count, count, 1e-9);
        for (x, is_stable) in &rows {
            let label = f64::from(u8::from(*is_stable));
            let weight = 0.5 * n / if *is_stable { stable } else { n - stable };
            let logit: f64 = x.iter().zip(&weights).map(|(x, w)| x * w).sum();
            let p = 1.0 / (1.0 + (-logit).exp());
            for (i, a) in x.iter().enumerate() {
                gradient[i] += weight * (p - label) * a;
                for (j, b) in x.iter().enumerate() {
                    hessian.add(i, j, weight * p * (1.0 - p) * a * b);
                }
            }
        }
        let step = hessian.factor()?.solve(&gradient);
        for (weight, step) in weights.iter_mut().zip(&step) {
            *weight -= step;
        }
        let decrement: f64 = step.iter().zip(&gradient).map(|(a, b)| a * b).sum();
        if decrement < CONVERGED {
            break;
        }
    }
    let mut bias = weights[count];
    for i in 0..count {
        weights[i] = if std[i] > 1e-9 {
            weights[i] / std[i]
        } else {
            0.0
        };
        bias -= weights[i] * mean[i];
    }
    weights[count] = bias;
    Some(weights)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use gripcast_base::random::SeedStream;

    /// Samples whose log-odds are 2·x0 − 1·x1 + 0.5; x2 is noise, x3 constant.
    pub(crate) fn samples(count: usize) -> Vec<(Vec<f64>, bool)> {
        let mut draw = SeedStream::named(4, "samples");
        let sample = |_| {
            let x: Vec<f64> = (0..3).map(|_| draw.between(-2.0, 2.0)).collect();
            let p = 1.0 / (1.0 + (-(2.0 * x[0] - x[1] + 0.5)).exp());
            let is_stable = draw.uniform() < p;
            (vec![x[0], x[1], x[2], 7.0], is_stable)
        };
        (0..count).map(sample).collect()
    }

    #[test]
    fn regression_finds_the_weights() {
        let weights = logistic_regression(&samples(20_000)).unwrap();
        for (found, expected) in weights.iter().zip([2.0, -1.0, 0.0, 0.0]) {
            assert!((found - expected).abs() < 0.1, "{weights:?}");
        }
    }

    #[test]
    fn both_labels_weigh_the_same() {
        let noise: Vec<(Vec<f64>, bool)> = samples(3000)
            .into_iter()
            .enumerate()
            .map(|(i, (x, _))| (x, i % 10 != 0))
            .collect();
        let weights = logistic_regression(&noise).unwrap();
        assert!(
            weights[4].abs() < 0.1,
            "as likely stable as slip: {weights:?}"
        );
    }

    #[test]
    fn one_label_gives_no_weights() {
        let one: Vec<(Vec<f64>, bool)> = vec![(vec![1.0], true), (vec![2.0], true)];
        assert_eq!(logistic_regression(&one), None);
        assert_eq!(logistic_regression(&[]), None);
    }

    #[test]
    fn separable_labels_give_finite_weights() {
        let rows = (0..20).map(|i| (vec![f64::from(i)], i >= 10));
        let weights = logistic_regression(&rows.collect::<Vec<_>>()).unwrap();
        assert!(
            weights.iter().all(|w| w.is_finite()) && weights[0] > 0.1,
            "{weights:?}"
        );
    }
}
