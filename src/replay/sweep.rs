//! Runs cases, one on each core, and keeps what is finished.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::case::{Case, CaseRecord, CaseStore};
use crate::error::{Error, ErrorKind, Result};

/// How far a sweep is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SweepProgress {
    /// Cases with a result.
    pub done: usize,
    /// Of those, simulated by this sweep.
    pub simulated: usize,
    /// All cases.
    pub all: usize,
}

/// Results of a sweep in the order of its cases.
#[derive(Clone, Debug)]
pub struct Swept {
    /// A result for each case.
    pub records: Vec<CaseRecord>,
    /// Cases that were simulated and not found finished.
    pub simulated: usize,
}

/// Runs all cases that are not finished yet, `jobs` at a time, each in one thread.
///
/// Every finished case is a file at once: a sweep that is cut off goes on where it was.
///
/// # Errors
/// Those of storing a result. A case without outcome is no error.
pub fn sweep(
    cases: &[Case<'_>],
    store: &CaseStore,
    jobs: usize,
    progress: &(dyn Fn(SweepProgress) + Sync),
) -> Result<Swept> {
    let mut records = cases
        .iter()
        .map(|case| store.find(case))
        .collect::<Result<Vec<Option<CaseRecord>>>>()?;
    let open: Vec<usize> = (0..cases.len()).filter(|i| records[*i].is_none()).collect();
    let found = cases.len() - open.len();
    let told = |simulated| {
        progress(SweepProgress {
            done: found + simulated,
            simulated,
            all: cases.len(),
        });
    };
    told(0);
    let next = AtomicUsize::new(0);
    let state = Mutex::new((0, Vec::with_capacity(open.len()), None::<Error>));
    let worker = || -> Result<()> {
        // The engines' own parallel parts stay in this thread: one grasp per core.
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .map_err(|e| Error::new(ErrorKind::Internal, "cannot start a thread").because(e))?;
        while let Some(&index) = open.get(next.fetch_add(1, Ordering::Relaxed)) {
            let case = &cases[index];
            let record = pool.install(|| {
                let (record, trace) = case.simulate()?;
                store.keep(case, &record, trace).map(|()| record)
            })?;
            if let Ok(mut state) = state.lock() {
                state.1.push((index, record));
                state.0 += 1;
                told(state.0);
            }
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, open.len().max(1)) {
            scope.spawn(|| {
                if let Err(error) = worker() {
                    // The others end after the case they are at.
                    next.store(open.len(), Ordering::Relaxed);
                    if let Ok(mut state) = state.lock() {
                        state.2.get_or_insert(error);
                    }
                }
            });
        }
    });
    let state = state.into_inner();
    let (simulated, new, error) =
        state.map_err(|_| Error::new(ErrorKind::Internal, "a simulation ended early"))?;
    if let Some(error) = error {
        return Err(error);
    }
    for (index, record) in new {
        records[index] = Some(record);
    }
    let all: Option<Vec<CaseRecord>> = records.into_iter().collect();
    let records = all.ok_or_else(|| Error::new(ErrorKind::Internal, "a simulation ended early"))?;
    Ok(Swept { records, simulated })
}
