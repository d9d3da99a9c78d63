//! Parallel processing of many long-running items, and CPU time.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use rustix::time::{ClockId, clock_gettime};

use crate::error::{Error, ErrorKind, Result};

/// Number of cores available to this process; 1 if unknown.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Maps `work` over the items, `jobs` at a time; results are in the order of the items.
///
/// Rayon calls inside `work` run on the item's own thread, so the cost and the result of an item
/// do not depend on the number of cores. `on_progress` gets the number of finished items after
/// each, from any thread.
///
/// # Errors
/// The error of the first failed item; no item is started after it.
pub fn par_map_single_threaded<T: Sync, R: Send>(
    jobs: usize,
    items: &[T],
    work: &(dyn Fn(&T) -> Result<R> + Sync),
    on_progress: &(dyn Fn(usize) + Sync),
) -> Result<Vec<R>> {
    let next = AtomicUsize::new(0);
    let done = AtomicUsize::new(0);
    let failed = AtomicBool::new(false);
    let results: Mutex<Vec<(usize, Result<R>)>> = Mutex::new(Vec::with_capacity(items.len()));
    let keep = |index: usize, result: Result<R>| {
        failed.fetch_or(result.is_err(), Ordering::Relaxed);
        let mut results = results.lock().unwrap_or_else(PoisonError::into_inner);
        results.push((index, result));
    };
    let worker = || {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let pool = pool.map_err(|e| e.to_string());
        while !failed.load(Ordering::Relaxed) {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(index) else { return };
            let result = match &pool {
                Ok(pool) => pool.install(|| work(item)),
                Err(e) => Err(Error::new(
                    ErrorKind::Io,
                    format!("cannot start a thread: {e}"),
                )),
            };
            let is_done = result.is_ok();
            keep(index, result);
            if is_done {
                on_progress(1 + done.fetch_add(1, Ordering::Relaxed));
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, items.len().max(1)) {
            scope.spawn(worker);
        }
    });
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}

/// CPU time of the calling thread, s: the cost of an item, whose work stays on one thread.
pub fn thread_cpu_s() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

/// CPU time of this process with all its threads, s.
pub fn process_cpu_s() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_and_progress_is_complete() {
        let items: Vec<u32> = (0..50).collect();
        let reported = Mutex::new(Vec::new());
        let report = |done| reported.lock().unwrap().push(done);
        let doubled = par_map_single_threaded(4, &items, &|n| Ok(2 * n), &report).unwrap();
        assert_eq!(doubled, (0..50).map(|n| 2 * n).collect::<Vec<_>>());
        let mut reported = reported.into_inner().unwrap();
        reported.sort_unstable();
        assert_eq!(reported, (1..=50).collect::<Vec<_>>());
        assert!(
            par_map_single_threaded(2, &[(); 0], &|()| Ok(()), &|_| ())
                .unwrap()
                .is_empty()
        );
    }

    #[test]
    fn error_stops_the_remaining_items() {
        let started = AtomicUsize::new(0);
        let items: Vec<u32> = (0..50).collect();
        let work = |n: &u32| {
            started.fetch_add(1, Ordering::Relaxed);
            match n {
                7 => Err(Error::input("seven")),
                _ => Ok(()),
            }
        };
        let error = par_map_single_threaded(1, &items, &work, &|_| ()).unwrap_err();
        assert_eq!(error.what(), "seven");
        assert_eq!(started.into_inner(), 8);
    }

    #[test]
    fn each_item_has_one_rayon_thread() {
        let threads = |_: &u32| Ok(rayon::current_num_threads());
        assert_eq!(
            par_map_single_threaded(2, &[1, 2, 3], &threads, &|_| ()).unwrap(),
            [1; 3]
        );
    }
}
