//! Smooths predictions for display without delaying changes.
//!
//! The log-odds of consecutive frames fluctuate with sensor noise. A low-pass filter alone would
//! delay a slip by half a second. Therefore the median of three frames removes outliers, a low-pass
//! filter smooths the rest, and a median that deviates more than the estimated jitter is adopted
//! immediately.

/// Time constant of the low-pass filter, s.
const TAU_S: f64 = 0.25;
/// Time constant of the jitter estimate, s.
const JITTER_TAU_S: f64 = 2.0;
/// A deviation of more than this many mean deviations is a change.
const CHANGE: f64 = 4.0;
/// Minimum jitter, log-odds; smaller changes are not visible.
const MIN_JITTER: f64 = 0.05;
/// Pause after which the filter restarts, s.
const PAUSE_S: f64 = 0.5;
/// Probabilities are clamped to this distance from 0 and 1.
const MIN_P: f64 = 1e-4;

/// Smooths the probabilities of one grasp.
#[derive(Clone, Debug, Default)]
pub struct Smoothing {
    state: Option<State>,
}

#[derive(Clone, Debug)]
struct State {
    time_ns: u64,
    /// Most recent log-odds, the newest last.
    recent: Vec<f64>,
    smooth: f64,
    jitter: f64,
}

impl Smoothing {
    /// Resets the filter for another grasp.
    pub fn clear(&mut self) {
        self.state = None;
    }

    /// Adds the prediction of a frame; returns the smoothed probability.
    pub fn add(&mut self, p: f64, time_ns: u64) -> f64 {
        let p = p.clamp(MIN_P, 1.0 - MIN_P);
        let logit = (p / (1.0 - p)).ln();
        let previous = self.state.take().filter(|state| {
            // A clock that runs backwards restarts the filter as well.
            let passed = time_ns.checked_sub(state.time_ns);
            passed.is_some_and(|ns| ns as f64 * 1e-9 <= PAUSE_S)
        });
        let state = match previous {
            Some(state) => state.update(logit, time_ns),
            None => State {
                time_ns,
                recent: vec![logit],
                smooth: logit,
                jitter: MIN_JITTER,
            },
        };
        let smooth = state.smooth;
        self.state = Some(state);
        1.0 / (1.0 + (-smooth).exp())
    }
}

impl State {
    fn update(mut self, logit: f64, time_ns: u64) -> Self {
        let passed_s = time_ns.saturating_sub(self.time_ns) as f64 * 1e-9;
        self.time_ns = time_ns;
        self.recent.push(logit);
        let first = self.recent.len().saturating_sub(3);
        self.recent.drain(..first);
        let median = median(&self.recent);
        let deviation = (median - self.smooth).abs();
        if deviation > CHANGE * self.jitter {
            self.smooth = median;
        } else {
            self.smooth += gain(passed_s, TAU_S) * (median - self.smooth);
        }
        // A change is limited to the threshold in the jitter estimate.
        let jitter = deviation.min(CHANGE * self.jitter);
        self.jitter += gain(passed_s, JITTER_TAU_S) * (jitter - self.jitter);
        self.jitter = self.jitter.max(MIN_JITTER);
        self
    }
}

/// Gain of a first-order low-pass filter after a time.
fn gain(passed_s: f64, tau_s: f64) -> f64 {
    1.0 - (-passed_s / tau_s).exp()
}

/// Median; of two values their mean.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    match sorted[..] {
        [] => 0.0,
        [a] => a,
        [a, b] => 0.5 * (a + b),
        [_, b, ..] => b,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME_NS: u64 = 40_000_000;

    fn run(
        smoothing: &mut Smoothing,
        values: impl IntoIterator<Item = f64>,
        from: u64,
    ) -> Vec<f64> {
        let frames = values.into_iter().zip(from..);
        frames
            .map(|(p, at)| smoothing.add(p, at * FRAME_NS))
            .collect()
    }

    fn deviation(values: &[f64]) -> f64 {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        (square / values.len() as f64).sqrt()
    }

    #[test]
    fn jitter_is_smoothed() {
        // A low-discrepancy sequence instead of random numbers.
        let noise = |at: u32| (f64::from(at * at) * 0.618_033_988_749_895).fract();
        let raw: Vec<f64> = (0..400).map(|at| 0.62 + 0.16 * noise(at)).collect();
        let smooth = run(&mut Smoothing::default(), raw.iter().copied(), 0);
        let (before, after) = (deviation(&raw[100..]), deviation(&smooth[100..]));
        assert!(after < 0.45 * before, "{before} {after}");
        let mean = smooth[100..].iter().sum::<f64>() / 300.0;
        assert!((mean - 0.7).abs() < 0.02, "{mean}");
    }

    #[test]
    fn change_is_shown_after_two_frames() {
        let mut smoothing = Smoothing::default();
        run(&mut smoothing, [0.9; 50], 0);
        let after = run(&mut smoothing, [0.1; 3], 50);
        assert!(after[0] > 0.85, "one frame may be an outlier: {after:?}");
        assert!(after[1] < 0.15 && after[2] < 0.15, "{after:?}");
    }

    #[test]
    fn single_outlier_is_not_shown() {
        let mut smoothing = Smoothing::default();
        run(&mut smoothing, [0.8; 20], 0);
        let shown = run(&mut smoothing, [0.02, 0.8, 0.8], 20);
        assert!(shown.iter().all(|p| (p - 0.8).abs() < 0.01), "{shown:?}");
    }

    #[test]
    fn pause_new_grasp_or_clock_jump_restarts_filter() {
        let mut smoothing = Smoothing::default();
        run(&mut smoothing, [0.9; 20], 0);
        assert!((smoothing.add(0.2, 100 * FRAME_NS) - 0.2).abs() < 1e-9);
        assert!((smoothing.add(0.6, 3) - 0.6).abs() < 1e-9);
        smoothing.clear();
        assert!((smoothing.add(0.3, 4) - 0.3).abs() < 1e-9);
        for sure in [0.0, 1.0] {
            smoothing.clear();
            assert!((smoothing.add(sure, 5) - sure).abs() < 1e-3);
        }
    }
}
