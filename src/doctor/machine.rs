//! The computer: processor and clock.

use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use super::{Finding, Verdict};
use gripcast_nn::vector_bits;

/// No clock that is right shows an earlier time: 2026-11-01, s since 1970.
const RELEASED_S: u64 = 1_793_491_200;
/// Difference of the two clocks over a measurement that counts as a step.
const STEP: Duration = Duration::from_millis(50);
/// Cores that the live path and its screen need.
const CORES: usize = 2;

/// What is known before any device is touched.
pub(super) fn findings() -> Vec<Finding> {
    vec![processor(), date(SystemTime::now())]
}

fn processor() -> Finding {
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let bits = vector_bits();
    let found = match bits {
        0 => format!("{cores} cores, no AVX2"),
        bits => format!("{cores} cores, vectors of {bits} bits"),
    };
    let finding = Finding::new("machine", "processor", Verdict::Ok, found)
        .figure("cores", cores as f64)
        .figure("vector_bits", f64::from(bits));
    if bits == 0 {
        Finding {
            verdict: Verdict::Warn,
            ..finding
        }
        .remedy("predictions take several times longer; use a processor with AVX2 and FMA")
    } else if cores < CORES {
        Finding {
            verdict: Verdict::Warn,
            ..finding
        }
        .remedy("frames may be shown late, though none that is saved is lost; give it two cores")
    } else {
        finding
    }
}

fn date(now: SystemTime) -> Finding {
    let since = now.duration_since(UNIX_EPOCH).unwrap_or_default();
    let text = jiff::Timestamp::try_from(now).map_or("no date".to_owned(), |t| format!("{t:.0}"));
    if since.as_secs() < RELEASED_S {
        let found = format!("the clock says {text}, before this program was made");
        return Finding::new("machine", "clock", Verdict::Fail, found)
            .remedy("set it (`timedatectl set-ntp true`): grasps are named by their time");
    }
    Finding::new("machine", "clock", Verdict::Ok, text)
}

/// Both clocks at a moment.
pub(super) struct Clocks {
    monotonic: Instant,
    system: SystemTime,
}

impl Clocks {
    pub(super) fn now() -> Self {
        Self {
            monotonic: Instant::now(),
            system: SystemTime::now(),
        }
    }

    /// Whether the system's clock was set since then.
    pub(super) fn finding_since(&self) -> Finding {
        let system = match SystemTime::now().duration_since(self.system) {
            Ok(forward) => forward.as_secs_f64(),
            Err(back) => -back.duration().as_secs_f64(),
        };
        steadiness(self.monotonic.elapsed().as_secs_f64(), system)
    }
}

fn steadiness(monotonic_s: f64, system_s: f64) -> Finding {
    let step_s = system_s - monotonic_s;
    let finding = Finding::new("machine", "clock's pace", Verdict::Ok, "steady")
        .figure("step_ms", 1e3 * step_s);
    if step_s.abs() <= STEP.as_secs_f64() {
        return finding;
    }
    Finding {
        verdict: Verdict::Warn,
        found: format!("the clock was set by {step_s:.3} s while cameras were measured"),
        ..finding
    }
    .remedy("wait until the time service has settled (`timedatectl`)")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_was_never_set_is_a_failure() {
        let early = date(UNIX_EPOCH + Duration::from_secs(1000));
        assert_eq!(early.verdict, Verdict::Fail);
        assert!(early.found.contains("1970-01-01"), "{}", early.found);
        let later = UNIX_EPOCH + Duration::from_secs(RELEASED_S + 1);
        assert_eq!(date(later).verdict, Verdict::Ok);
    }

    #[test]
    fn a_step_of_the_clock_is_seen_in_both_directions() {
        assert_eq!(steadiness(2.0, 2.01).verdict, Verdict::Ok);
        for system_s in [2.2, 1.7, -3000.0] {
            let finding = steadiness(2.0, system_s);
            assert_eq!(finding.verdict, Verdict::Warn, "{system_s}");
            assert!((finding.figures["step_ms"] - 1e3 * (system_s - 2.0)).abs() < 1e-6);
        }
    }
}
