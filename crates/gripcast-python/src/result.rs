//! Results of simulated grasps.

use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyDict;

use super::arrays::{array, column};
use super::case::{Case, GraspCase};
use super::fields::FaceFields;
use super::pose::{Pose, trajectory};
use gripcast_sim::EngineKind;
use gripcast_sim::grasp::{self, GraspSummary, StageName, Trace, TraceStep};
use gripcast_tactile::TraceStart;

/// Result of a simulated grasp. Arrays have one row per time step (n) and one column per finger: left,
/// right.
#[pyclass(frozen, module = "gripcast")]
pub(crate) struct GraspResult(Arc<Simulated>);

pub(crate) struct Simulated {
    case: Arc<Case>,
    result: grasp::GraspResult,
    summary: GraspSummary,
    fields: PyOnceLock<Option<Py<FaceFields>>>,
}

impl GraspResult {
    pub(crate) fn new(case: Arc<Case>, result: grasp::GraspResult) -> Self {
        let fem = &case.settings.fem;
        let summary = GraspSummary::new(&result, &fem.protocol, fem.solver.dt_s);
        Self(Arc::new(Simulated {
            case,
            result,
            summary,
            fields: PyOnceLock::new(),
        }))
    }

    pub(crate) fn simulated(&self) -> Arc<Simulated> {
        Arc::clone(&self.0)
    }

    /// What only the finite-element simulator has.
    fn of_fem<T>(&self, value: T) -> Option<T> {
        (self.0.case.settings.engine == EngineKind::Fem).then_some(value)
    }

    fn steps(&self) -> &[TraceStep] {
        &self.0.result.trace.steps
    }
}

impl Simulated {
    pub(crate) fn trace(&self) -> &Trace {
        &self.result.trace
    }

    pub(crate) fn case(&self) -> &Case {
        &self.case
    }

    pub(crate) fn start(&self) -> TraceStart {
        let start = &self.case.start;
        TraceStart {
            t_world_object: start.t_world_object,
            t_object_gripper: start.t_world_object.inverse() * start.gripper.t_world_gripper,
            opening_m: start.gripper.opening_m,
        }
    }
}

#[pymethods]
impl GraspResult {
    /// What was simulated.
    #[getter]
    fn case(&self) -> GraspCase {
        GraspCase(Arc::clone(&self.0.case))
    }

    /// success, slip, eject, miss, gels_met, penetrating_start or not_converged.
    #[getter]
    fn outcome(&self) -> &'static str {
        self.0.result.outcome.name()
    }

    /// Further explanation of the outcome.
    #[getter]
    fn detail(&self) -> Option<&str> {
        self.0.result.detail.as_deref()
    }

    /// Reasons to doubt the result, one sentence each, without those of the case.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.of_fem(self.0.summary.warnings.clone())
            .unwrap_or_default()
    }

    /// Rise of the object's centre of mass, m.
    #[getter]
    fn lifted_m(&self) -> f64 {
        self.0.result.lifted_m
    }

    /// Normal force of the left and the right gel before the lift (else at the end), N.
    #[getter]
    fn force_n(&self) -> (f64, f64) {
        (self.0.summary.force_n.left, self.0.summary.force_n.right)
    }

    /// Whether the mean force reached the stopping force before the lift; None for rigid bodies.
    #[getter]
    fn reached_stop_force(&self) -> Option<bool> {
        self.of_fem(self.0.summary.reached_stop_force)
    }

    /// Whether the force was steady at the end of the adjustment; None without one.
    #[getter]
    fn steady(&self) -> Option<bool> {
        self.of_fem(self.0.summary.steady)?
    }

    /// Load of the grip's friction in the lift as a fraction of its limit; None where it is not known.
    #[getter]
    fn friction_use(&self) -> Option<f64> {
        self.0.result.friction_use
    }

    /// Steps that did not converge.
    #[getter]
    fn unconverged_steps(&self) -> usize {
        self.0.result.unconverged_steps
    }

    /// n: closure, adjustment or lift.
    #[getter]
    fn stage(&self) -> Vec<&'static str> {
        self.steps().iter().map(|step| step.stage.name()).collect()
    }

    /// n, float64, s: time since the start.
    #[getter]
    fn t_s(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        column(py, self.steps().iter().map(|step| Some(step.t_s)))
    }

    /// n × 2, float64, N: contact force against the closing direction.
    #[getter]
    fn normal_force_n(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let forces = self.steps().iter().flat_map(|step| step.force);
        let values = forces.map(|force| force.normal_n).collect();
        array::<f64>(py, values, &[self.steps().len(), 2])
    }

    /// n × 2 × 2, float64, N: force on each gel along the gripper's y and z axes.
    #[getter]
    fn shear_force_n(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let forces = self.steps().iter().flat_map(|step| step.force);
        let values = forces.flat_map(|force| force.shear_n).collect();
        array::<f64>(py, values, &[self.steps().len(), 2, 2])
    }

    /// n × 2, float64, N m: torque on each gel about its closing direction.
    #[getter]
    fn torque_n_m(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let forces = self.steps().iter().flat_map(|step| step.force);
        let values = forces.map(|force| force.torque_n_m).collect();
        array::<f64>(py, values, &[self.steps().len(), 2])
    }

    /// n × 4 × 4, float64: pose of the object in the world.
    #[getter]
    fn t_world_object(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        trajectory(py, self.steps().iter().map(|step| step.t_world_object))
    }

    /// n, float64, m: distance between the undeformed gel faces.
    #[getter]
    fn opening_m(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        column(py, self.steps().iter().map(|step| Some(step.opening_m)))
    }

    /// n, float64, m: lift of the gripper so far.
    #[getter]
    fn gripper_lift_m(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        column(py, self.steps().iter().map(|step| Some(step.lifted_m)))
    }

    /// n × 2, float64, m: smallest distance of each gel and the object; NaN out of range of contact.
    #[getter]
    fn min_gap_m(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let gaps = self.steps().iter().flat_map(|step| step.min_gap_m);
        let values = gaps.map(|gap| gap.unwrap_or(f64::NAN)).collect();
        array::<f64>(py, values, &[self.steps().len(), 2])
    }

    /// States at the ends of the stages that were reached, by name.
    #[getter]
    fn snapshots<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let found = PyDict::new(py);
        for snapshot in &self.0.result.trace.snapshots {
            found.set_item(snapshot.stage.name(), Snapshot::new(py, snapshot)?)?;
        }
        Ok(found)
    }

    /// Tractions and displacements; None unless `fields` was given.
    #[getter]
    fn fields(&self, py: Python<'_>) -> PyResult<Option<Py<FaceFields>>> {
        let series = self.0.result.trace.fields.as_ref();
        let make = || -> PyResult<_> {
            let fields = series
                .map(|series| FaceFields::new(py, series))
                .transpose()?;
            fields.map(|fields| Py::new(py, fields)).transpose()
        };
        let fields = self.0.fields.get_or_try_init(py, make)?;
        Ok(fields.as_ref().map(|fields| fields.clone_ref(py)))
    }

    fn __repr__(&self) -> String {
        let (left, right) = self.force_n();
        format!(
            "<GraspResult {}: lifted {:.1} mm, force {left:.2} N left, {right:.2} N right, {} steps>",
            self.outcome(),
            1e3 * self.lifted_m(),
            self.steps().len()
        )
    }
}

/// State at the end of a stage.
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct Snapshot {
    /// closure, adjustment or lift.
    stage: &'static str,
    /// Time since the start, s.
    t_s: f64,
    /// Pose of the object in the world.
    t_world_object: Pose,
    /// Pose of the gripper in the world.
    t_world_gripper: Pose,
    /// Distance between the undeformed gel faces, m.
    opening_m: f64,
    /// Nodes of the left and the right gel in the world: n × 3, float64, m.
    gel_nodes_m: (Py<PyAny>, Py<PyAny>),
}

impl Snapshot {
    fn new(py: Python<'_>, snapshot: &grasp::Snapshot) -> PyResult<Self> {
        let nodes = |gel: &Vec<[f64; 3]>| array(py, gel.concat(), &[gel.len(), 3]);
        let [left, right] = &snapshot.gels;
        Ok(Self {
            stage: StageName::name(snapshot.stage),
            t_s: snapshot.t_s,
            t_world_object: Pose(snapshot.t_world_object),
            t_world_gripper: Pose(snapshot.t_world_gripper),
            opening_m: snapshot.opening_m,
            gel_nodes_m: (nodes(left)?, nodes(right)?),
        })
    }
}

#[pymethods]
impl Snapshot {
    fn __repr__(&self) -> String {
        format!(
            "<Snapshot {} at {:.2} s: opening {:.2} mm>",
            self.stage,
            self.t_s,
            1e3 * self.opening_m
        )
    }
}
