//! Simulates grasps.

use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::case::{Case, GraspCase};
use super::failure::Outcome;
use super::mesh::Object;
use super::result::GraspResult;
use super::work::{interruptible, pool, thread_count};
use gripcast_base::workers::par_map_single_threaded;

/// Simulates one grasp: the gripper closes, adjusts its force and lifts.
///
/// `placement` is a `Placement`, a `GraspPose`, or None for a grasp from above. The result does not
/// depend on `threads` (None: all cores).
///
/// Settings:
///   engine         "fem" (finite-element gels, default) or "rigid", which takes `stop_force_n` only
///   stop_force_n   stopping force per finger, N (40)
///   gel            gel mesh: "coarse", "default" or "fine"
///   preset         gel parameters: "paper" or "feats"
///   profile        sensor whose pad and elastic law the gels have, instead of a preset
///   fields         record tractions: "stages", "all" or "every:N"
///   rule           force controller: "bang-bang" or "proportional" with `gain_m_per_n`
///   drive          boundary drive: "area" or "taccel"
///   adjust_s       duration of the force adjustment, s (1.5)
///   lift_m         lift height, m (0.05)
///   dt_s           time step, s (0.01)
///   eps_v_m_s      sliding speed below which friction is regularised, m/s (1e-3)
///   tolerance_m_s  Newton tolerance, m/s (1e-4)
///   max_iterations Newton iterations per step at most (200)
#[pyfunction]
#[pyo3(signature = (object, placement = None, *, threads = None, **settings))]
pub(crate) fn simulate(
    py: Python<'_>,
    object: &Object,
    placement: Option<&Bound<'_, PyAny>>,
    threads: Option<usize>,
    settings: Option<&Bound<'_, PyDict>>,
) -> Outcome<GraspResult> {
    let case = GraspCase::build(py, object, placement, settings)?.0;
    let pool = pool(threads)?;
    let run = Arc::clone(&case);
    let result = interruptible(py, move |cancel| pool.install(|| run.run(cancel)))?;
    Ok(GraspResult::new(case, result))
}

/// Simulates many grasps, `threads` at a time (None: all cores), each on one thread. Results are in the
/// order of the cases and the same as those of `simulate`.
#[pyfunction]
#[pyo3(signature = (cases, *, threads = None))]
pub(crate) fn simulate_batch(
    py: Python<'_>,
    cases: Vec<Bound<'_, GraspCase>>,
    threads: Option<usize>,
) -> Outcome<Vec<GraspResult>> {
    let cases: Vec<Arc<Case>> = cases.iter().map(|case| Arc::clone(&case.get().0)).collect();
    let jobs = thread_count(threads)?;
    let work = cases.clone();
    let results = interruptible(py, move |cancel| {
        let indexed: Vec<(usize, Arc<Case>)> = work.into_iter().enumerate().collect();
        let run = |(index, case): &(usize, Arc<Case>)| {
            case.run(cancel).map_err(|e| e.at(format!("case {index}")))
        };
        par_map_single_threaded(jobs, &indexed, &run, &|_| ())
    })?;
    let pairs = cases.into_iter().zip(results);
    Ok(pairs
        .map(|(case, result)| GraspResult::new(case, result))
        .collect())
}
