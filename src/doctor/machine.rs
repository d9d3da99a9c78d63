//! Processor and clock of the computer.

use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use super::{CheckStatus, Finding};
use gripcast_nn::vector_bits;

/// Earliest plausible clock time: 2026-11-01, s since 1970.
const RELEASED_S: u64 = 1_793_491_200;
/// Maximum difference of the two clocks over a measurement.
const MAX_CLOCK_STEP: Duration = Duration::from_millis(50);
/// Minimum number of cores for the live path and the screen.
const MIN_CORES: usize = 2;

/// Checks processor and clock.
pub(super) fn findings() -> Vec<Finding> {
    vec![processor(), date(SystemTime::now())]
}

fn processor() -> Finding {
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let bits = vector_bits();
    let found = match bits {
        0 => format!("{cores} cores, no AVX2"),
        bits => format!("{cores} cores, {bits}-bit vectors"),
    };
    let finding = Finding::new("machine", "processor", CheckStatus::Ok, found)
        .measurement("cores", cores as f64)
        .measurement("vector_bits", f64::from(bits));
    if bits == 0 {
        finding.warn("predictions take several times longer; use a processor with AVX2 and FMA")
    } else if cores < MIN_CORES {
        finding.warn("previews may be delayed, but no saved frame is lost; provide two cores")
    } else {
        finding
    }
}

fn date(now: SystemTime) -> Finding {
    let since = now.duration_since(UNIX_EPOCH).unwrap_or_default();
    let text = jiff::Timestamp::try_from(now).map_or("no date".to_owned(), |t| format!("{t:.0}"));
    if since.as_secs() < RELEASED_S {
        let found = format!("the clock shows {text}, before the release of this program");
        return Finding::new("machine", "clock", CheckStatus::Fail, found)
            .remedy("set the clock (`timedatectl set-ntp true`): grasp ids contain the time");
    }
    Finding::new("machine", "clock", CheckStatus::Ok, text)
}

/// Readings of the monotonic and the system clock.
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

    /// Checks whether the system clock was set since these readings.
    pub(super) fn finding_since(&self) -> Finding {
        let system = match SystemTime::now().duration_since(self.system) {
            Ok(forward) => forward.as_secs_f64(),
            Err(back) => -back.duration().as_secs_f64(),
        };
        clock_step(self.monotonic.elapsed().as_secs_f64(), system)
    }
}

fn clock_step(monotonic_s: f64, system_s: f64) -> Finding {
    let step_s = system_s - monotonic_s;
    let finding = Finding::new("machine", "clock step", CheckStatus::Ok, "steady")
        .measurement("step_ms", 1e3 * step_s);
    if step_s.abs() <= MAX_CLOCK_STEP.as_secs_f64() {
        return finding;
    }
    Finding {
        message: format!("the clock was set by {step_s:.3} s during the camera measurement"),
        ..finding
    }
    .warn("wait until the time service has settled (`timedatectl`)")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unset_clock_fails() {
        let early = date(UNIX_EPOCH + Duration::from_secs(1000));
        assert_eq!(early.status, CheckStatus::Fail);
        assert!(early.message.contains("1970-01-01"), "{}", early.message);
        let later = UNIX_EPOCH + Duration::from_secs(RELEASED_S + 1);
        assert_eq!(date(later).status, CheckStatus::Ok);
    }

    #[test]
    fn clock_steps_are_detected_in_both_directions() {
        assert_eq!(clock_step(2.0, 2.01).status, CheckStatus::Ok);
        for system_s in [2.2, 1.7, -3000.0] {
            let finding = clock_step(2.0, system_s);
            assert_eq!(finding.status, CheckStatus::Warn, "{system_s}");
            assert!((finding.measurements["step_ms"] - 1e3 * (system_s - 2.0)).abs() < 1e-6);
        }
    }
}
