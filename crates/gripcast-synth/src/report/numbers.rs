//! Quantiles, correlation and AUROC.

use super::facts::Quantiles;

impl Quantiles {
    /// Computes nearest-rank quantiles; zeros for an empty set.
    pub(super) fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_by(f64::total_cmp);
        let at = |fraction: f64| {
            let rank = (fraction * sorted.len() as f64).ceil() as usize;
            sorted.get(rank.max(1) - 1).copied().unwrap_or(0.0)
        };
        Self {
            p05: at(0.05),
            median: at(0.5),
            p95: at(0.95),
            max: at(1.0),
        }
    }
}

/// Pearson correlation of pairs; none if one of both does not vary.
pub(super) fn correlation(pairs: &[[f64; 2]]) -> Option<f64> {
    let count = pairs.len() as f64;
    let mean = |k: usize| pairs.iter().map(|pair| pair[k]).sum::<f64>() / count;
    let means = [mean(0), mean(1)];
    let [mut both, mut first, mut second] = [0.0; 3];
    for pair in pairs {
        let [a, b] = [pair[0] - means[0], pair[1] - means[1]];
        both += a * b;
        first += a * a;
        second += b * b;
    }
    // Rounded means leave a residual even for equal numbers.
    let varies = |squares: f64, mean: f64| squares > count * (1e-9 * mean).powi(2);
    (varies(first, means[0]) && varies(second, means[1])).then(|| both / (first * second).sqrt())
}

/// Probability that a value of the first group is above one of the second, with ties counted half
/// (area under the ROC curve); none if a group is empty.
pub(super) fn auroc(above: &[f64], below: &[f64]) -> Option<f64> {
    if above.is_empty() || below.is_empty() {
        return None;
    }
    let mut sorted = below.to_vec();
    sorted.sort_by(f64::total_cmp);
    let wins = above.iter().map(|value| {
        let less = sorted.partition_point(|other| other < value);
        let ties = sorted.partition_point(|other| other <= value) - less;
        less as f64 + 0.5 * ties as f64
    });
    Some(wins.sum::<f64>() / (above.len() * below.len()) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_nearest_ranks() {
        let of_hundred = Quantiles::of((1..=100).rev().map(f64::from));
        let expected = Quantiles {
            p05: 5.0,
            median: 50.0,
            p95: 95.0,
            max: 100.0,
        };
        assert_eq!(of_hundred, expected);
        assert_eq!(Quantiles::of([7.0].into_iter()).p05, 7.0);
        assert_eq!(Quantiles::of(std::iter::empty()), Quantiles::default());
    }

    #[test]
    fn correlation_needs_variation() {
        let found = correlation(&[[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]]).unwrap();
        assert!((found - 1.0).abs() < 1e-12);
        // By hand: sums of products 1.5, of squares 2 and 4.5.
        let found = correlation(&[[0.0, 0.5], [1.0, -1.0], [2.0, 2.0]]).unwrap();
        assert!((found - 1.5 / 9.0f64.sqrt()).abs() < 1e-12, "{found}");
        assert_eq!(correlation(&[[1.0, 2.0], [1.0, 3.0]]), None);
        let same: Vec<[f64; 2]> = (0..72).map(|k| [1.986, f64::from(k)]).collect();
        assert_eq!(correlation(&same), None);
        assert_eq!(correlation(&[]), None);
    }

    #[test]
    fn auroc_separates_groups() {
        assert_eq!(auroc(&[3.0, 4.0], &[1.0, 2.0]), Some(1.0));
        assert_eq!(auroc(&[1.0, 2.0], &[1.0, 2.0]), Some(0.5));
        assert_eq!(auroc(&[1.0, 3.0], &[2.0]), Some(0.5));
        assert_eq!(auroc(&[0.0], &[2.0, 3.0]), Some(0.0));
        assert_eq!(auroc(&[], &[1.0]), None);
    }
}
