//! What a simulation costs.

use rustix::time::{ClockId, clock_gettime};

/// CPU time of the calling thread, s. A simulation runs in one thread.
pub(super) fn thread_cpu_s() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}
