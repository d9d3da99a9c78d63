//! A grasp under the caller's control.

use std::sync::{Arc, Mutex, PoisonError};

use glam::DVec3;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::array;
use super::case::{Case, GraspCase};
use super::failure::Outcome;
use super::mesh::Object;
use super::pose::Pose;
use super::work::{ProcessPool, detached};
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_sim::grasp::{Snapshot, StepState, StepTarget, Stepper};

/// Settings of a grasp that a simulation has; the others are of the protocol of `simulate`.
const SETTINGS: [&str; 8] = [
    "drive",
    "dt_s",
    "eps_v_m_s",
    "gel",
    "max_iterations",
    "preset",
    "profile",
    "tolerance_m_s",
];

/// A grasp that is simulated step by step, for control loops.
///
/// Gels and object are those of `simulate`; the gripper goes where `step` says. Until a gel touches
/// the object, the object rests. Settings are `gel`, `preset`, `profile`, `drive`, `dt_s`,
/// `eps_v_m_s`, `tolerance_m_s` and `max_iterations` of `simulate`. A finger and the gripper move at
/// most with `max_speed_m_s`.
#[pyclass(frozen, module = "gripcast")]
pub(crate) struct Simulation {
    case: Arc<Case>,
    stepper: Mutex<Stepper>,
    threads: Option<usize>,
    pool: ProcessPool,
}

impl Simulation {
    fn lock(&self) -> std::sync::MutexGuard<'_, Stepper> {
        // A step that panicked is reported; the next one may fail again.
        self.stepper.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn simulated(&self) -> &Case {
        &self.case
    }

    pub(crate) fn snapshot(&self) -> Snapshot {
        self.lock().snapshot()
    }
}

#[pymethods]
impl Simulation {
    #[new]
    #[pyo3(signature = (object, placement = None, *, max_speed_m_s = Stepper::MAX_SPEED_M_S, threads = None, **settings))]
    #[pyo3(
        text_signature = "(object, placement=None, *, max_speed_m_s=0.05, threads=None, **settings)"
    )]
    fn new(
        py: Python<'_>,
        object: &Object,
        placement: Option<&Bound<'_, PyAny>>,
        max_speed_m_s: f64,
        threads: Option<usize>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> Outcome<Self> {
        for key in settings.into_iter().flat_map(|given| given.keys()) {
            let key: String = key.extract()?;
            if !SETTINGS.contains(&key.as_str()) {
                return Err(unknown_name("argument", &key, &SETTINGS).into());
            }
        }
        let case = GraspCase::build(py, object, placement, settings)?.0;
        let pool = ProcessPool::default();
        let started = pool.get(threads)?;
        let stepper = detached(py, || {
            let scene = case.scene()?;
            let solver = &case.settings.fem.solver;
            started.install(|| Stepper::new(&scene, solver, max_speed_m_s))
        })?;
        Ok(Self {
            case,
            stepper: Mutex::new(stepper),
            threads,
            pool,
        })
    }

    /// What is simulated.
    #[getter]
    fn case(&self) -> GraspCase {
        GraspCase(Arc::clone(&self.case))
    }

    /// State at the end of the last step.
    #[getter]
    fn state(&self, py: Python<'_>) -> Outcome<SimulationState> {
        let state = detached(py, || Ok(self.lock().state()))?;
        Ok(SimulationState::new(py, &state)?)
    }

    /// Advances by `steps` time steps towards a target and returns the state after them.
    ///
    /// `opening_m` is the distance between the undeformed gel faces, `moved_m` the displacement (x, y, z)
    /// of the gripper since the start in the world, with z of 0 or more; None keeps what it is. Ctrl-C
    /// ends the call after the current step.
    #[pyo3(signature = (opening_m = None, moved_m = None, *, steps = 1))]
    fn step(
        &self,
        py: Python<'_>,
        opening_m: Option<f64>,
        moved_m: Option<(f64, f64, f64)>,
        steps: usize,
    ) -> Outcome<SimulationState> {
        if steps == 0 {
            return Err(Error::usage("`steps` must be above 0, found 0").into());
        }
        let pool = self.pool.get(self.threads)?;
        let before = detached(py, || Ok(self.lock().state()))?;
        let target = StepTarget {
            opening_m: opening_m.unwrap_or(before.opening_m),
            moved_m: moved_m.map_or(before.moved_m, DVec3::from),
        };
        for _ in 0..steps {
            detached(py, || -> Result<()> {
                let mut stepper = self.lock();
                let stepper = &mut *stepper;
                pool.install(|| stepper.step(&target))
            })?;
            py.check_signals()?;
        }
        self.state(py)
    }

    fn __repr__(&self, py: Python<'_>) -> Outcome<String> {
        let state = detached(py, || Ok(self.lock().state()))?;
        let [left, right] = state.force.map(|force| force.normal_n);
        Ok(format!(
            "<Simulation at {:.2} s: opening {:.1} mm, force {left:.2} N left, {right:.2} N right>",
            state.t_s,
            1e3 * state.opening_m
        ))
    }
}

/// State of a `Simulation` at the end of a step. Arrays have one row per finger: left, right.
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct SimulationState {
    /// Time since the start, s.
    t_s: f64,
    /// 2, float64, N: contact force against the closing direction.
    normal_force_n: Py<PyAny>,
    /// 2 × 2, float64, N: force on each gel along the gripper's y and z axes.
    shear_force_n: Py<PyAny>,
    /// 2, float64, N m: torque on each gel about its closing direction.
    torque_n_m: Py<PyAny>,
    /// 2, float64, m: smallest distance of each gel and the object; NaN out of range of contact.
    min_gap_m: Py<PyAny>,
    /// Pose of the object in the world.
    t_world_object: Pose,
    /// Pose of the gripper in the world.
    t_world_gripper: Pose,
    /// Distance between the undeformed gel faces, m.
    opening_m: f64,
    /// 3, float64, m: displacement of the gripper since the start in the world.
    moved_m: Py<PyAny>,
    /// Height of the object's lowest point above the ground, m.
    object_height_m: f64,
    /// Whether the solver converged in the last step.
    converged: bool,
}

impl SimulationState {
    fn new(py: Python<'_>, state: &StepState) -> PyResult<Self> {
        let force = &state.force;
        let shear = force.iter().flat_map(|force| force.shear_n).collect();
        let gaps = state.min_gap_m.map(|gap| gap.unwrap_or(f64::NAN));
        Ok(Self {
            t_s: state.t_s,
            normal_force_n: array(py, force.iter().map(|f| f.normal_n).collect(), &[2])?,
            shear_force_n: array::<f64>(py, shear, &[2, 2])?,
            torque_n_m: array(py, force.iter().map(|f| f.torque_n_m).collect(), &[2])?,
            min_gap_m: array(py, gaps.to_vec(), &[2])?,
            t_world_object: Pose(state.t_world_object),
            t_world_gripper: Pose(state.t_world_gripper),
            opening_m: state.opening_m,
            moved_m: array(py, state.moved_m.to_array().to_vec(), &[3])?,
            object_height_m: state.object_height_m,
            converged: state.solver.is_none_or(|solver| solver.converged),
        })
    }
}

#[pymethods]
impl SimulationState {
    fn __repr__(&self) -> String {
        format!(
            "<SimulationState at {:.2} s: opening {:.1} mm, object {:.1} mm above the ground>",
            self.t_s,
            1e3 * self.opening_m,
            1e3 * self.object_height_m
        )
    }
}
