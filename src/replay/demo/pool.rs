//! Work on many grasps, one a core.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::plan::{DemoProgress, DemoStage, DemoWatch};
use crate::error::{Error, ErrorKind, Result};

/// Does `work` for every item on `jobs` threads; results in the order of the items.
///
/// # Errors
/// The error of the first item that failed, after which none is begun; `Stopped`.
pub(super) fn for_each<T: Sync, R: Send>(
    jobs: usize,
    items: &[T],
    stage: DemoStage,
    watch: &DemoWatch<'_>,
    work: &(dyn Fn(&T) -> Result<R> + Sync),
) -> Result<Vec<R>> {
    let next = AtomicUsize::new(0);
    let done = AtomicUsize::new(0);
    let failed = AtomicBool::new(false);
    let results: Mutex<Vec<(usize, Result<R>)>> = Mutex::new(Vec::new());
    let keep = |at: usize, result: Result<R>| {
        failed.fetch_or(result.is_err(), Ordering::Relaxed);
        let mut results = results.lock().unwrap_or_else(|e| e.into_inner());
        results.push((at, result));
    };
    let worker = || {
        // The solver and the renderers share their work over the threads of the pool they run in.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let pool = pool
            .map_err(|e| Error::new(ErrorKind::Io, "cannot start a thread for a grasp").because(e));
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            if at >= items.len() || failed.load(Ordering::Relaxed) {
                return;
            }
            let result = match (&pool, watch.check()) {
                (_, Err(stopped)) => Err(stopped),
                (Err(error), _) => Err(Error::new(error.kind(), error.what())),
                (Ok(pool), _) => pool.install(|| work(&items[at])),
            };
            keep(at, result);
            (watch.progress)(DemoProgress {
                stage,
                done: 1 + done.fetch_add(1, Ordering::Relaxed),
                of: items.len(),
            });
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, items.len().max(1)) {
            scope.spawn(worker);
        }
    });
    let mut results = results.into_inner().unwrap_or_else(|e| e.into_inner());
    results.sort_by_key(|(at, _)| *at);
    results.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quiet(_: DemoProgress) {}

    #[test]
    fn results_keep_their_order_and_an_error_ends_the_work() {
        let watch = DemoWatch {
            progress: &quiet,
            cancel: None,
        };
        let items: Vec<u32> = (0..50).collect();
        let doubled = for_each(4, &items, DemoStage::Screening, &watch, &|n| Ok(2 * n));
        assert_eq!(doubled.unwrap(), (0..50).map(|n| 2 * n).collect::<Vec<_>>());
        let begun = AtomicUsize::new(0);
        let failing = for_each(1, &items, DemoStage::Screening, &watch, &|n| {
            begun.fetch_add(1, Ordering::Relaxed);
            match n {
                7 => Err(Error::new(ErrorKind::Input, "seven")),
                _ => Ok(()),
            }
        });
        assert_eq!(failing.unwrap_err().what(), "seven");
        assert_eq!(begun.into_inner(), 8);
    }

    #[test]
    fn a_stopped_watch_begins_nothing() {
        let stop = AtomicBool::new(true);
        let watch = DemoWatch {
            progress: &quiet,
            cancel: Some(&stop),
        };
        let nothing = for_each(2, &[1, 2, 3], DemoStage::Recording, &watch, &|_| {
            Err::<(), _>(Error::new(ErrorKind::Internal, "begun"))
        });
        assert_eq!(nothing.unwrap_err().kind(), ErrorKind::Stopped);
    }
}
