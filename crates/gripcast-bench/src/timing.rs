//! Wall times of repeated work, and thread pools.

use std::time::Instant;

use gripcast_base::error::{Error, Result};
use gripcast_base::statistics::median;
use rayon::ThreadPool;
use serde::Serialize;

/// Minimum and median wall time, ms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Timing {
    pub(crate) min: f64,
    pub(crate) median: f64,
}

/// Times `work`, at least one run.
pub(crate) fn timed<T>(runs: usize, mut work: impl FnMut() -> T) -> Timing {
    let times = (0..runs.max(1)).map(|_| {
        let start = Instant::now();
        std::hint::black_box(work());
        ms_since(start)
    });
    let times: Vec<f64> = times.collect();
    Timing {
        min: times.iter().copied().fold(f64::INFINITY, f64::min),
        median: median(times).unwrap_or(f64::NAN),
    }
}

pub(crate) fn ms_since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

/// Starts a thread pool.
pub(crate) fn pool(threads: usize) -> Result<ThreadPool> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Error::internal("cannot start threads").because(e))
}
