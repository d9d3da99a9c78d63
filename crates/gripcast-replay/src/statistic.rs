//! Intervals and tests of shares.

use super::report::Proportion;

/// Two-sided 95 % quantile of the standard normal distribution.
const Z: f64 = 1.959_963_984_540_054;

impl Proportion {
    /// A share with its 95 % interval (Wilson, *Probable Inference*, 1927). Without grasps the
    /// interval is 0 to 1.
    pub fn of(agree: usize, n: usize) -> Self {
        if n == 0 {
            return Self {
                agree,
                n,
                share: 0.0,
                low: 0.0,
                high: 1.0,
            };
        }
        let count = n as f64;
        let share = agree as f64 / count;
        let shrink = 1.0 + Z * Z / count;
        let middle = (share + 0.5 * Z * Z / count) / shrink;
        let half = Z * (share * (1.0 - share) / count + 0.25 * Z * Z / (count * count)).sqrt();
        Self {
            agree,
            n,
            share,
            low: (middle - half / shrink).max(0.0),
            high: (middle + half / shrink).min(1.0),
        }
    }
}

/// Two-sided p of McNemar's exact test: how likely discordant pairs split as unevenly as `a` to
/// `b`, or more, if both are equally good. 1 without discordant pairs.
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

    /// Against SciPy's `binomtest(k, n).proportion_ci(method="wilson")`.
    #[test]
    fn wilson_intervals_are_those_of_the_books() {
        let check = |agree, n, low: f64, high: f64| {
            let found = Proportion::of(agree, n);
            assert!((found.low - low).abs() < 5e-5, "{found:?}");
            assert!((found.high - high).abs() < 5e-5, "{found:?}");
        };
        check(94, 100, 0.875_23, 0.972_21);
        check(73, 100, 0.635_68, 0.807_30);
        check(20, 20, 0.838_88, 1.0);
        check(0, 20, 0.0, 0.161_12);
        assert_eq!(
            (Proportion::of(0, 0).low, Proportion::of(0, 0).high),
            (0.0, 1.0)
        );
    }

    #[test]
    fn mcnemar_is_the_exact_binomial() {
        assert_eq!(mcnemar_p(0, 0), 1.0);
        assert_eq!(mcnemar_p(3, 3), 1.0);
        assert!((mcnemar_p(5, 0) - 2.0 / 32.0).abs() < 1e-15);
        // 2 (1 + 10) / 1024.
        assert!((mcnemar_p(9, 1) - 22.0 / 1024.0).abs() < 1e-15);
        assert_eq!(mcnemar_p(2, 12), mcnemar_p(12, 2));
    }
}
