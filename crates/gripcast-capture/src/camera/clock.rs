//! Clocks: `CLOCK_MONOTONIC`, and a manual one for tests.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// `CLOCK_MONOTONIC`, the clock of V4L2 time stamps, ns.
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    u64::try_from(now.tv_sec).unwrap_or(0) * 1_000_000_000 + u64::try_from(now.tv_nsec).unwrap_or(0)
}

/// A source of time.
pub trait Clock: Send + Sync {
    /// Current time, ns.
    fn now_ns(&self) -> u64;

    /// Sleeps until `deadline_ns`.
    fn sleep_until(&self, deadline_ns: u64);

    /// Sleeps until `due_ns`, at most `timeout`; whether `due_ns` is reached.
    fn wait_for(&self, due_ns: u64, timeout: Duration) -> bool {
        let timeout_ns = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        let latest_ns = self.now_ns().saturating_add(timeout_ns);
        self.sleep_until(due_ns.min(latest_ns));
        due_ns <= latest_ns
    }
}

/// `CLOCK_MONOTONIC`.
#[derive(Clone, Copy, Debug, Default)]
pub struct MonotonicClock;

impl Clock for MonotonicClock {
    fn now_ns(&self) -> u64 {
        monotonic_ns()
    }

    fn sleep_until(&self, deadline_ns: u64) {
        while let Some(left_ns) = deadline_ns.checked_sub(monotonic_ns()) {
            if left_ns == 0 {
                break;
            }
            std::thread::sleep(Duration::from_nanos(left_ns));
        }
    }
}

/// A clock that only advances by sleeping and [`Self::advance`].
#[derive(Debug, Default)]
pub struct ManualClock(AtomicU64);

impl ManualClock {
    /// A clock at `now_ns`.
    pub fn new(now_ns: u64) -> Self {
        Self(AtomicU64::new(now_ns))
    }

    /// Advances the clock by `step_ns`.
    pub fn advance(&self, step_ns: u64) {
        self.0.fetch_add(step_ns, Ordering::SeqCst);
    }
}

impl Clock for ManualClock {
    fn now_ns(&self) -> u64 {
        self.0.load(Ordering::SeqCst)
    }

    fn sleep_until(&self, deadline_ns: u64) {
        self.0.fetch_max(deadline_ns, Ordering::SeqCst);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn monotonic_time_is_monotonic() {
        let first = monotonic_ns();
        assert!(first > 0);
        assert!(monotonic_ns() >= first);
        MonotonicClock.sleep_until(first);
    }

    #[test]
    fn sleeping_advances_the_manual_clock() {
        let clock = ManualClock::new(10);
        clock.sleep_until(5);
        assert_eq!(clock.now_ns(), 10);
        clock.sleep_until(25);
        clock.advance(5);
        assert_eq!(clock.now_ns(), 30);
    }
}
