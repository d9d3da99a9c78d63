//! Medians, quantiles, and tests of proportions.

/// Two-sided 95 % quantile of the standard normal distribution.
const Z: f64 = 1.959_963_984_540_054;

/// Median; the upper of the two middle values of an even number; `None` without values.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Quantile of sorted numbers with linear interpolation (Hyndman & Fan 1996, type 7, as in NumPy).
pub fn quantile(sorted: &[f64], fraction: f64) -> Option<f64> {
    let position = fraction * (sorted.len().checked_sub(1)?) as f64;
    let (&below, &above) = (
        sorted.get(position.floor() as usize)?,
        sorted.get(position.ceil() as usize)?,
    );
    Some(below + (position - position.floor()) * (above - below))
}

/// 95 % interval of the fraction `successes / trials` (Wilson, *Probable Inference*, 1927); 0 to 1
/// without trials.
pub fn wilson_interval(successes: usize, trials: usize) -> [f64; 2] {
    if trials == 0 {
        return [0.0, 1.0];
    }
    let count = trials as f64;
    let fraction = successes as f64 / count;
    let shrink = 1.0 + Z * Z / count;
    let middle = (fraction + 0.5 * Z * Z / count) / shrink;
    let half = Z * (fraction * (1.0 - fraction) / count + 0.25 * Z * Z / (count * count)).sqrt();
    [
        (middle - half / shrink).max(0.0),
        (middle + half / shrink).min(1.0),
    ]
}

/// Two-sided p-value of McNemar's exact test for `a` and `b` discordant pairs; 1 without discordant
/// pairs.
pub fn mcnemar_p(a: usize, b: usize) -> f64 {
    let n = a + b;
    let mut term = 0.5f64.powi(i32::try_from(n).unwrap_or(i32::MAX));
    let mut tail = 0.0;
    for k in 0..=a.min(b) {
        tail += term;
        term *= (n - k) as f64 / (k + 1) as f64;
    }
    (2.0 * tail).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_of_even_count_is_the_upper_one() {
        assert_eq!(median([]), None);
        assert_eq!(median([3.0]), Some(3.0));
        assert_eq!(median([4.0, 1.0, 3.0, 2.0]), Some(3.0));
    }

    #[test]
    fn quantiles_match_numpy() {
        let sorted = [1.0, 2.0, 4.0, 8.0];
        // numpy.quantile([1, 2, 4, 8], q)
        assert_eq!(quantile(&sorted, 0.0), Some(1.0));
        assert_eq!(quantile(&sorted, 0.5), Some(3.0));
        assert_eq!(quantile(&sorted, 0.9), Some(6.800_000_000_000_001));
        assert_eq!(quantile(&sorted, 1.0), Some(8.0));
        assert_eq!(quantile(&[], 0.5), None);
    }

    /// Against SciPy's `binomtest(k, n).proportion_ci(method="wilson")`.
    #[test]
    fn wilson_intervals_match_scipy() {
        let check = |successes, trials, expected: [f64; 2]| {
            let found = wilson_interval(successes, trials);
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 5e-5, "{found} {expected}");
            }
        };
        check(94, 100, [0.875_23, 0.972_21]);
        check(73, 100, [0.635_68, 0.807_30]);
        check(20, 20, [0.838_88, 1.0]);
        check(0, 20, [0.0, 0.161_12]);
        assert_eq!(wilson_interval(0, 0), [0.0, 1.0]);
    }

    #[test]
    fn mcnemar_p_is_the_exact_binomial() {
        assert_eq!(mcnemar_p(0, 0), 1.0);
        assert_eq!(mcnemar_p(3, 3), 1.0);
        assert!((mcnemar_p(5, 0) - 2.0 / 32.0).abs() < 1e-15);
        // 2 (1 + 10) / 1024.
        assert!((mcnemar_p(9, 1) - 22.0 / 1024.0).abs() < 1e-15);
        assert_eq!(mcnemar_p(2, 12), mcnemar_p(12, 2));
    }
}
