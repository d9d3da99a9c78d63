//! Runs cases, one on each core, and keeps what is finished.

use super::case::{Case, CaseRecord, CaseStore};
use gripcast_base::error::{Error, Result};
use gripcast_base::workers::par_map_single_threaded;

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
    let run = |index: &usize| {
        let case = &cases[*index];
        let (record, trace) = case.simulate()?;
        store.keep(case, &record, trace).map(|()| record)
    };
    let new = par_map_single_threaded(jobs, &open, &run, &told)?;
    let simulated = new.len();
    for (index, record) in open.into_iter().zip(new) {
        records[index] = Some(record);
    }
    let all: Option<Vec<CaseRecord>> = records.into_iter().collect();
    let records = all.ok_or_else(|| Error::internal("a simulation ended early"))?;
    Ok(Swept { records, simulated })
}
