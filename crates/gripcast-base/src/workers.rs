//! Long work on many items, one item on each core.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use rustix::time::{ClockId, clock_gettime};

use crate::error::{Error, ErrorKind, Result};

/// Cores that this process may use; 1 where the system does not tell.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Does `work` for every item, `jobs` at a time; results in the order of the items.
///
/// What `work` fractions over rayon's threads stays in the thread of its item, so that many items keep
/// all cores busy and each takes the same time and gives the same bytes on any number of them.
/// `told` gets the number of finished items after each, from any thread.
///
/// # Errors
/// The error of the first item that failed, after which none is begun.
pub fn one_per_core<T: Sync, R: Send>(
    jobs: usize,
    items: &[T],
    work: &(dyn Fn(&T) -> Result<R> + Sync),
    on_progress: &(dyn Fn(usize) + Sync),
) -> Result<Vec<R>> {
    let next = AtomicUsize::new(0);
    let done = AtomicUsize::new(0);
    let failed = AtomicBool::new(false);
    let results: Mutex<Vec<(usize, Result<R>)>> = Mutex::new(Vec::with_capacity(items.len()));
    let keep = |at: usize, result: Result<R>| {
        failed.fetch_or(result.is_err(), Ordering::Relaxed);
        let mut results = results.lock().unwrap_or_else(PoisonError::into_inner);
        results.push((at, result));
    };
    let worker = || {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let pool = pool.map_err(|e| e.to_string());
        while !failed.load(Ordering::Relaxed) {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(at) else { return };
            let result = match &pool {
                Ok(pool) => pool.install(|| work(item)),
                Err(why) => Err(Error::new(
                    ErrorKind::Io,
                    format!("cannot start a thread: {why}"),
                )),
            };
            let is_done = result.is_ok();
            keep(at, result);
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
    results.sort_by_key(|(at, _)| *at);
    results.into_iter().map(|(_, result)| result).collect()
}

/// CPU time of the calling thread, s: what an item costs, as its work stays in one thread.
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
    fn results_keep_their_order_and_all_are_told() {
        let items: Vec<u32> = (0..50).collect();
        let told = Mutex::new(Vec::new());
        let tell = |done| told.lock().unwrap().push(done);
        let doubled = one_per_core(4, &items, &|n| Ok(2 * n), &tell).unwrap();
        assert_eq!(doubled, (0..50).map(|n| 2 * n).collect::<Vec<_>>());
        let mut told = told.into_inner().unwrap();
        told.sort_unstable();
        assert_eq!(told, (1..=50).collect::<Vec<_>>());
        assert!(
            one_per_core(2, &[(); 0], &|()| Ok(()), &|_| ())
                .unwrap()
                .is_empty()
        );
    }

    #[test]
    fn an_error_ends_the_work() {
        let begun = AtomicUsize::new(0);
        let items: Vec<u32> = (0..50).collect();
        let work = |n: &u32| {
            begun.fetch_add(1, Ordering::Relaxed);
            match n {
                7 => Err(Error::input("seven")),
                _ => Ok(()),
            }
        };
        let error = one_per_core(1, &items, &work, &|_| ()).unwrap_err();
        assert_eq!(error.what(), "seven");
        assert_eq!(begun.into_inner(), 8);
    }

    #[test]
    fn an_item_has_one_thread() {
        let threads = |_: &u32| Ok(rayon::current_num_threads());
        assert_eq!(
            one_per_core(2, &[1, 2, 3], &threads, &|_| ()).unwrap(),
            [1; 3]
        );
    }
}
