//! Latencies in bounded memory.

/// Width of a bin, ms.
const BIN_MS: f64 = 0.25;
/// Bins; the last one takes all that is longer (1 s).
const BINS: usize = 4000;

/// A histogram of times from 0 to 1 s, exact to 0.25 ms.
#[derive(Clone, Debug)]
pub(super) struct Histogram {
    bins: Vec<u32>,
    count: u64,
    longest_ms: f64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            bins: vec![0; BINS],
            count: 0,
            longest_ms: 0.0,
        }
    }
}

impl Histogram {
    /// Counts a time.
    pub(super) fn add(&mut self, ms: f64) {
        let bin = ((ms / BIN_MS).max(0.0) as usize).min(BINS - 1);
        self.bins[bin] = self.bins[bin].saturating_add(1);
        self.count += 1;
        self.longest_ms = self.longest_ms.max(ms);
    }

    /// The time that a fraction `quantile` (0..1) of the counted ones do not exceed, ms, rounded
    /// up to the bin; `None` when nothing was counted.
    #[must_use]
    pub(super) fn quantile_ms(&self, quantile: f64) -> Option<f64> {
        let rank = (quantile * self.count as f64).ceil().max(1.0) as u64;
        let mut below = 0;
        for (bin, n) in self.bins.iter().enumerate() {
            below += u64::from(*n);
            if below >= rank {
                let upper = (bin + 1) as f64 * BIN_MS;
                return Some(upper.min(self.longest_ms));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_a_known_set() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.quantile_ms(0.5), None);
        for i in 1..=100 {
            histogram.add(f64::from(i));
        }
        let p50 = histogram.quantile_ms(0.5).unwrap();
        let p99 = histogram.quantile_ms(0.99).unwrap();
        assert!(
            (50.0..=50.25).contains(&p50) && (99.0..=99.25).contains(&p99),
            "{p50} {p99}"
        );
        assert!((histogram.quantile_ms(1.0).unwrap() - 100.0).abs() < 1e-12);
    }

    #[test]
    fn absurd_times_are_kept_in_the_last_bin() {
        let mut histogram = Histogram::default();
        histogram.add(1e9);
        histogram.add(-1.0);
        assert!(histogram.quantile_ms(1.0).unwrap() <= 1e9);
    }
}
