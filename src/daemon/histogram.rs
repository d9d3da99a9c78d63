//! Latency quantiles in bounded memory.

/// Width of a bin, ms.
const BIN_MS: f64 = 0.25;
/// Number of bins; the last one holds all latencies above 1 s.
const BINS: usize = 4000;

/// Histogram of latencies from 0 to 1 s with a resolution of 0.25 ms.
#[derive(Clone, Debug, Default)]
pub(super) struct LatencyHistogram {
    bins: Vec<u32>,
    count: u64,
    max_ms: f64,
}

impl LatencyHistogram {
    /// Adds a latency, ms.
    pub(super) fn add(&mut self, ms: f64) {
        self.bins.resize(BINS, 0);
        let bin = ((ms / BIN_MS).max(0.0) as usize).min(BINS - 1);
        self.bins[bin] = self.bins[bin].saturating_add(1);
        self.count += 1;
        self.max_ms = self.max_ms.max(ms);
    }

    /// Returns the quantile (0..1) of the latencies, ms, rounded up to the bin; `None` if empty.
    pub(super) fn quantile_ms(&self, quantile: f64) -> Option<f64> {
        let rank = (quantile * self.count as f64).ceil().max(1.0) as u64;
        let mut below = 0;
        for (bin, n) in self.bins.iter().enumerate() {
            below += u64::from(*n);
            if below >= rank {
                let upper = (bin + 1) as f64 * BIN_MS;
                return Some(upper.min(self.max_ms));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_match_known_latencies() {
        let mut histogram = LatencyHistogram::default();
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
    fn out_of_range_latencies_are_clamped() {
        let mut histogram = LatencyHistogram::default();
        histogram.add(1e9);
        histogram.add(-1.0);
        assert!(histogram.quantile_ms(1.0).unwrap() <= 1e9);
    }
}
