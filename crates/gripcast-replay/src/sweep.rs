//! Runs cases in parallel and stores their results.

use super::case::{Case, CaseRecord, CaseStore};
use gripcast_base::error::{Error, Result};
use gripcast_base::workers::par_map_single_threaded;

/// Progress of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SweepProgress {
    /// Number of cases with a result.
    pub done: usize,
    /// Number of cases that this sweep simulated.
    pub simulated: usize,
    /// Number of cases.
    pub total: usize,
}

/// Results of a sweep in the order of its cases.
#[derive(Clone, Debug)]
pub struct SweepResult {
    /// Result of each case.
    pub records: Vec<CaseRecord>,
    /// Number of cases that were simulated.
    pub simulated: usize,
}

/// Runs all unfinished cases, `jobs` in parallel, each in one thread. Every result is stored as
/// soon as it is finished, so an interrupted sweep can be resumed.
///
/// # Errors
/// Errors of storing a result. A case without an outcome is not an error.
pub fn sweep(
    cases: &[Case<'_>],
    store: &CaseStore,
    jobs: usize,
    on_progress: &(dyn Fn(SweepProgress) + Sync),
) -> Result<SweepResult> {
    let mut records = cases
        .iter()
        .map(|case| store.load(case))
        .collect::<Result<Vec<Option<CaseRecord>>>>()?;
    let open: Vec<usize> = (0..cases.len()).filter(|i| records[*i].is_none()).collect();
    let finished = cases.len() - open.len();
    let report = |simulated| {
        on_progress(SweepProgress {
            done: finished + simulated,
            simulated,
            total: cases.len(),
        });
    };
    report(0);
    let run = |index: &usize| {
        let case = &cases[*index];
        let (record, trace) = case.simulate()?;
        store.save(case, &record, trace).map(|()| record)
    };
    let new = par_map_single_threaded(jobs, &open, &run, &report)?;
    let simulated = new.len();
    for (index, record) in open.into_iter().zip(new) {
        records[index] = Some(record);
    }
    let all: Option<Vec<CaseRecord>> = records.into_iter().collect();
    let records = all.ok_or_else(|| Error::internal("a simulation ended early"))?;
    Ok(SweepResult { records, simulated })
}
