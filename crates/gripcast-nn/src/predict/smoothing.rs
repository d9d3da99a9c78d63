//! A steady number on the screen that still follows every change.
//!
//! Log-odds of frame after frame tremble with the sensor's noise. A low-pass filter alone would
//! calm them and hide for half a second that a grasp slips. So the median of three frames drops
//! what a single frame says, a low-pass filter steadies what stays, and a median that is further
//! from it than the trembling explains is believed at once.

/// Time constant of the low-pass filter, s.
const TAU_S: f64 = 0.25;
/// Time constant of the estimate of the trembling, s.
const TREMBLING_TAU_S: f64 = 2.0;
/// A median further away than this many mean deviations is a change.
const CHANGE: f64 = 4.0;
/// Least trembling, log-odds: below it a change would not be seen on the screen.
const MIN_TREMBLING: f64 = 0.05;
/// After a pause as long as this what was before does not count, s.
const PAUSE_S: f64 = 0.5;
/// Probabilities nearer to 0 and 1 than this are as sure as can be shown.
const SUREST: f64 = 1e-4;

/// Smooths the probabilities of one grasp.
#[derive(Clone, Debug, Default)]
pub struct Smoothing {
    state: Option<State>,
}

#[derive(Clone, Debug)]
struct State {
    time_ns: u64,
    /// Newest log-odds, the newest last.
    recent: Vec<f64>,
    smooth: f64,
    trembling: f64,
}

impl Smoothing {
    /// Forgets everything: another grasp.
    pub fn clear(&mut self) {
        self.state = None;
    }

    /// The steady probability after a prediction from a frame of this time.
    pub fn add(&mut self, p: f64, time_ns: u64) -> f64 {
        let p = p.clamp(SUREST, 1.0 - SUREST);
        let logit = (p / (1.0 - p)).ln();
        let known = self.state.take().filter(|state| {
            // A clock that runs backwards is a pause as well.
            let passed = time_ns.checked_sub(state.time_ns);
            passed.is_some_and(|ns| ns as f64 * 1e-9 <= PAUSE_S)
        });
        let state = match known {
            Some(state) => state.after(logit, time_ns),
            None => State {
                time_ns,
                recent: vec![logit],
                smooth: logit,
                trembling: MIN_TREMBLING,
            },
        };
        let smooth = state.smooth;
        self.state = Some(state);
        1.0 / (1.0 + (-smooth).exp())
    }
}

impl State {
    fn after(mut self, logit: f64, time_ns: u64) -> Self {
        let passed_s = time_ns.saturating_sub(self.time_ns) as f64 * 1e-9;
        self.time_ns = time_ns;
        self.recent.push(logit);
        let first = self.recent.len().saturating_sub(3);
        self.recent.drain(..first);
        let median = median(&self.recent);
        let off = (median - self.smooth).abs();
        if off > CHANGE * self.trembling {
            self.smooth = median;
        } else {
            self.smooth += fraction(passed_s, TAU_S) * (median - self.smooth);
        }
        // A change is no trembling: it counts as the most that is none.
        let trembling = off.min(CHANGE * self.trembling);
        self.trembling += fraction(passed_s, TREMBLING_TAU_S) * (trembling - self.trembling);
        self.trembling = self.trembling.max(MIN_TREMBLING);
        self
    }
}

/// What a low-pass filter takes over after a time.
fn fraction(passed_s: f64, tau_s: f64) -> f64 {
    1.0 - (-passed_s / tau_s).exp()
}

/// Of two the mean.
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
    fn trembling_is_calmed() {
        // Multiples of the golden ratio are as good as chance here.
        let chance = |at: u32| (f64::from(at * at) * 0.618_033_988_749_895).fract();
        let raw: Vec<f64> = (0..400).map(|at| 0.62 + 0.16 * chance(at)).collect();
        let smooth = run(&mut Smoothing::default(), raw.iter().copied(), 0);
        let (before, after) = (deviation(&raw[100..]), deviation(&smooth[100..]));
        assert!(after < 0.45 * before, "{before} {after}");
        let mean = smooth[100..].iter().sum::<f64>() / 300.0;
        assert!((mean - 0.7).abs() < 0.02, "{mean}");
    }

    #[test]
    fn a_change_is_shown_after_two_frames() {
        let mut smoothing = Smoothing::default();
        run(&mut smoothing, [0.9; 50], 0);
        let after = run(&mut smoothing, [0.1; 3], 50);
        assert!(after[0] > 0.85, "one frame may be wrong: {after:?}");
        assert!(after[1] < 0.15 && after[2] < 0.15, "{after:?}");
    }

    #[test]
    fn a_single_odd_frame_is_not_shown() {
        let mut smoothing = Smoothing::default();
        run(&mut smoothing, [0.8; 20], 0);
        let shown = run(&mut smoothing, [0.02, 0.8, 0.8], 20);
        assert!(shown.iter().all(|p| (p - 0.8).abs() < 0.01), "{shown:?}");
    }

    #[test]
    fn pauses_other_grasps_and_odd_clocks_begin_anew() {
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
