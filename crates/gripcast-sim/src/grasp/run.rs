//! Simulates a grasp through the stages of the protocol.

use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::early_end::LiftMonitor;
use super::friction_use::friction_use;
use super::protocol::Protocol;
use super::scene::{BuiltScene, Finger, Scene};
use super::trace::{GelForce, Snapshot, StageName, Trace, TraceStep};
use crate::fields::{FaceField, FieldSampling, FieldSeries, FieldStep};
use crate::solver::{Gel, PhaseTimes, SolverParameters, StepReport, StepStart};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::statistics::median;
use gripcast_geometry::Pose;

/// Distance beyond `d_hat` above which the gels move freely, m.
const FREE_MOTION_MARGIN_M: f64 = 2e-4;
/// Smallest force that counts as contact, N.
pub(crate) const MIN_CONTACT_FORCE_N: f64 = 1e-3;
/// Time between the states of the lift that are kept, s: a sensor of 25 frames per second.
const FRAME_S: f64 = 0.04;
/// Rise of the gripper up to which states of the lift are kept, m.
const RECORDED_LIFT_M: f64 = 20e-3;
/// Unconverged steps after which the simulation stops.
const MAX_UNCONVERGED: usize = 5;

/// Outcome of a simulated grasp.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GraspOutcome {
    /// Every point of the object is above the success height at the end.
    Success,
    /// The object was held before the lift but did not follow it to the end.
    Slip,
    /// The object was squeezed out before the lift.
    Eject,
    /// The fingers closed without touching the object.
    Miss,
    /// The gels met each other before the stopping force was reached.
    GelsMet,
    /// The gripper started inside the object or the ground.
    PenetratingStart,
    /// Steps did not converge: there is no physical outcome.
    NotConverged,
}

impl GraspOutcome {
    /// Name in results and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Slip => "slip",
            Self::Eject => "eject",
            Self::Miss => "miss",
            Self::GelsMet => "gels_met",
            Self::PenetratingStart => "penetrating_start",
            Self::NotConverged => "not_converged",
        }
    }
}

/// Result of a simulated grasp.
#[derive(Clone, Debug, Serialize)]
pub struct GraspResult {
    /// Outcome.
    pub outcome: GraspOutcome,
    /// Further explanation of the outcome.
    pub detail: Option<String>,
    /// Rise of the object's centre of mass, m; until the simulation ended.
    pub lifted_m: f64,
    /// Load of the grip's friction in the lift as a fraction of its limit, of shear and torsion
    /// together; the median of the steps in which both gels touch and the object is clear of the
    /// ground, which would carry a part. `None` without such a step, and of rigid bodies.
    pub friction_use: Option<f64>,
    /// Steps that did not converge.
    pub unconverged_steps: usize,
    /// Wall time of the solver phases.
    pub times: PhaseTimes,
    /// Trace of all steps.
    pub trace: Trace,
}

impl GraspResult {
    /// Result of a grasp whose gripper starts inside the object or the ground.
    pub(crate) fn penetrating_start(detail: String) -> Self {
        Self {
            outcome: GraspOutcome::PenetratingStart,
            detail: Some(detail),
            lifted_m: 0.0,
            friction_use: None,
            unconverged_steps: 0,
            times: PhaseTimes::default(),
            trace: Trace::default(),
        }
    }
}

/// Simulates a grasp.
///
/// # Errors
/// `Input` or `Config` for an invalid scene, protocol or parameter. An initial penetration and a
/// grasp that does not converge are outcomes, not errors.
pub fn simulate(
    scene: &Scene,
    protocol: &Protocol,
    parameters: &SolverParameters,
) -> Result<GraspResult> {
    simulate_with_fields(scene, protocol, parameters, None)
}

/// Simulates a grasp as [`simulate`] does, with the same result, and records the fields of the gels'
/// faces in the trace.
///
/// # Errors
/// As [`simulate`].
pub fn simulate_with_fields(
    scene: &Scene,
    protocol: &Protocol,
    parameters: &SolverParameters,
    sampling: Option<FieldSampling>,
) -> Result<GraspResult> {
    simulate_until(
        scene,
        protocol,
        parameters,
        sampling,
        &AtomicBool::new(false),
    )
}

/// Simulates a grasp as [`simulate_with_fields`] does until `is_cancelled` is set: it is read before
/// each step.
///
/// # Errors
/// As [`simulate`]; `Interrupted` once it is cancelled.
pub fn simulate_until(
    scene: &Scene,
    protocol: &Protocol,
    parameters: &SolverParameters,
    sampling: Option<FieldSampling>,
    is_cancelled: &AtomicBool,
) -> Result<GraspResult> {
    protocol.validate()?;
    let built = scene.build(parameters)?;
    if let Some(detail) = built.penetration {
        return Ok(GraspResult::penetrating_start(detail));
    }
    let mut run = Run::new(built, scene, *protocol, parameters.dt_s, is_cancelled);
    run.sampling = sampling;
    run.trace.fields = sampling.map(|_| FieldSeries::new(&scene.gel.grid, 2, parameters.eps_v_m_s));
    let result = run.finish();
    match is_cancelled.load(Ordering::Relaxed) {
        true => Err(Error::new(
            ErrorKind::Interrupted,
            "the grasp was interrupted",
        )),
        false => Ok(result),
    }
}

/// A grasp in progress.
pub(super) struct Run<'a> {
    pub(super) scene: BuiltScene,
    protocol: Protocol,
    is_cancelled: &'a AtomicBool,
    pub(super) t_world_gripper: Pose,
    pub(super) dt: f64,
    time: f64,
    pub(super) opening: f64,
    /// Mean force per motion of each finger, N/m, from the last steps.
    stiffness: f64,
    pub(super) lifted: f64,
    start_height: f64,
    gels_have_met: bool,
    pub(super) has_touched: bool,
    has_reached_force: bool,
    unconverged: usize,
    iterations: u64,
    /// Outcome that became certain in the lift.
    certain: Option<GraspOutcome>,
    /// Load of the friction in each step of the lift.
    friction_uses: Vec<f64>,
    friction: f64,
    sampling: Option<FieldSampling>,
    pub(super) trace: Trace,
}

impl<'a> Run<'a> {
    pub(super) fn new(
        built: BuiltScene,
        scene: &Scene,
        protocol: Protocol,
        dt: f64,
        is_cancelled: &'a AtomicBool,
    ) -> Self {
        let raise = Pose::from_translation(DVec3::Z * built.raised_m);
        Self {
            t_world_gripper: raise * scene.t_world_gripper,
            start_height: built.system.object().state().p.z,
            opening: scene.opening_m,
            scene: built,
            protocol,
            is_cancelled,
            dt,
            time: 0.0,
            stiffness: 0.0,
            lifted: 0.0,
            gels_have_met: false,
            has_touched: false,
            has_reached_force: false,
            unconverged: 0,
            iterations: 0,
            certain: None,
            friction_uses: Vec::new(),
            friction: scene.friction,
            sampling: None,
            trace: Trace::default(),
        }
    }

    /// Runs all stages and determines the outcome.
    fn finish(mut self) -> GraspResult {
        self.close();
        self.snapshot(StageName::Closure);
        let touched = self.has_touched;
        if touched {
            self.adjust();
            self.snapshot(StageName::Adjustment);
        }
        let was_held = self.mean_force() > MIN_CONTACT_FORCE_N;
        if touched {
            self.lift();
            self.snapshot(StageName::Lift);
        }
        let object = self.scene.system.object();
        let lowest = object.lowest(self.scene.system.collider());
        let (outcome, detail) = if let Some(reason) = self.stop_reason() {
            (GraspOutcome::NotConverged, Some(reason))
        } else if !touched {
            (GraspOutcome::Miss, None)
        } else if self.certain == Some(GraspOutcome::Success)
            || lowest > self.protocol.success_height_m
        {
            (GraspOutcome::Success, None)
        } else if !was_held {
            (GraspOutcome::Eject, None)
        } else if self.gels_have_met && !self.has_reached_force {
            let detail = "the gels met before the stopping force was reached".to_owned();
            (GraspOutcome::GelsMet, Some(detail))
        } else {
            (GraspOutcome::Slip, None)
        };
        GraspResult {
            outcome,
            detail,
            lifted_m: object.state().p.z - self.start_height,
            friction_use: median(self.friction_uses),
            unconverged_steps: self.unconverged,
            times: *self.scene.system.phase_times(),
            trace: self.trace,
        }
    }

    /// Reason to stop the simulation early.
    fn stop_reason(&self) -> Option<String> {
        if self.is_cancelled.load(Ordering::Relaxed) {
            return Some("cancelled".to_owned());
        }
        let limit = self.scene.system.parameters().max_grasp_iterations;
        if self.unconverged > MAX_UNCONVERGED {
            return Some(format!("{} steps did not converge", self.unconverged));
        }
        (self.iterations > limit).then(|| format!("stopped after {limit} iterations"))
    }

    pub(super) fn forces(&self) -> [GelForce; 2] {
        let gels = self.scene.system.gels();
        [0, 1].map(|i| gel_force(&gels[i], self.scene.closing[i], &self.scene.gripper_axes))
    }

    fn mean_force(&self) -> f64 {
        let [left, right] = self.forces();
        0.5 * (left.normal_n + right.normal_n)
    }

    /// Closes the opening by up to `by` (m) per finger, until the gels meet. Returns the actual
    /// motion per finger.
    pub(super) fn close_by(&mut self, by: f64) -> f64 {
        let room = 0.5 * (self.opening - self.scene.system.parameters().d_hat_m);
        let by = if by > 0.0 && self.scene.gels_meet() {
            self.gels_have_met = true;
            0.0
        } else if by >= room {
            self.gels_have_met = true;
            room.max(0.0)
        } else {
            by
        };
        self.opening -= 2.0 * by;
        by
    }

    pub(super) fn move_targets(&mut self, closing_by: f64, shift: DVec3) {
        let closing = self.scene.closing;
        for (gel, closing) in self.scene.system.gels_mut().iter_mut().zip(closing) {
            gel.move_target(closing * closing_by + shift);
        }
    }

    /// Whether the gels are out of contact range, also after each has moved by `by` (m).
    pub(super) fn is_out_of_range(&mut self, by: f64) -> bool {
        let d_hat = self.scene.system.parameters().d_hat_m;
        let near = d_hat + FREE_MOTION_MARGIN_M + by;
        !self.has_touched && self.scene.system.clearance().iter().all(|c| *c > near)
    }

    fn close(&mut self) {
        let step = self.protocol.closing_speed_m_s * self.dt;
        while !self.gels_have_met && self.stop_reason().is_none() {
            let by = self.close_by(step);
            if self.is_out_of_range(by) {
                let closing = self.scene.closing;
                self.scene.system.translate_free(&closing.map(|c| c * by));
                self.record(StageName::Closure, None);
                continue;
            }
            self.move_targets(by, DVec3::ZERO);
            let start = StepStart {
                refactorize: true,
                warm_start_slot: warm_start_slot(StageName::Closure, by),
                ..Default::default()
            };
            let before = self.mean_force();
            self.step(StageName::Closure, &start);
            self.measure_stiffness(before, by);
            let [left, right] = self.forces().map(|force| force.normal_n);
            self.has_touched |= left > MIN_CONTACT_FORCE_N || right > MIN_CONTACT_FORCE_N;
            if left > self.protocol.stop_force_n && right > self.protocol.stop_force_n {
                self.has_reached_force = true;
                return;
            }
        }
    }

    fn adjust(&mut self) {
        let steps = (self.protocol.adjust_s / self.dt).round() as usize;
        for _ in 0..steps {
            if self.stop_reason().is_some() {
                return;
            }
            self.control_step(StageName::Adjustment, 0.0, DVec3::ZERO);
            self.has_reached_force |= self.mean_force() >= self.protocol.stop_force_n;
        }
    }

    fn lift(&mut self) {
        let rise = self.protocol.lift_speed_m_s * self.dt;
        let steps = (self.protocol.lift_m / rise).round() as usize;
        let frame_steps = ((FRAME_S / self.dt).round() as usize).max(1);
        let mut monitor = LiftMonitor::default();
        let mut follows = true;
        for step in 0..steps {
            if self.stop_reason().is_some() {
                return;
            }
            self.lifted += rise;
            let is_in_contact = self
                .forces()
                .iter()
                .all(|f| f.normal_n > MIN_CONTACT_FORCE_N);
            let translation = if follows && is_in_contact { rise } else { 0.0 };
            let before = self.scene.system.object().state().p.z;
            self.control_step(StageName::Lift, rise, DVec3::Z * translation);
            self.friction_uses.extend(self.friction_use());
            let risen = self.scene.system.object().state().p.z - before;
            follows = risen > 0.5 * rise;
            if (step + 1).is_multiple_of(frame_steps) && self.lifted < RECORDED_LIFT_M + 0.5 * rise
            {
                let snapshot = self.current(StageName::Lift, DVec3::Z * self.lifted);
                self.trace.lift_snapshots.push(snapshot);
            }
            if self.protocol.early_end {
                self.certain = self.outcome_so_far(&mut monitor);
                if self.certain.is_some() {
                    return;
                }
            }
        }
    }

    /// The outcome after the last step of the lift, if it is certain.
    fn outcome_so_far(&self, monitor: &mut LiftMonitor) -> Option<GraspOutcome> {
        let lift = Pose::from_translation(DVec3::Z * self.lifted);
        let t_gripper_object = (lift * self.t_world_gripper).inverse() * self.object_pose();
        let object = self.scene.system.object();
        monitor.add(
            self.lifted,
            self.forces().map(|force| force.normal_n),
            t_gripper_object,
            self.scene.center_of_mass,
            object.lowest(self.scene.system.collider()),
        )
    }

    /// Mean load of both gels' friction, if both touch and carry the object alone.
    fn friction_use(&self) -> Option<f64> {
        let object = self.scene.system.object();
        let clearance = object.lowest(self.scene.system.collider());
        if clearance < self.scene.system.parameters().d_hat_m {
            return None;
        }
        let gels = self.scene.system.gels();
        let [left, right] =
            [0, 1].map(|i| friction_use(&gels[i], self.scene.closing[i], self.friction));
        Some(0.5 * (left? + right?))
    }

    /// One step of the force controller, with the gripper rising by `rise` (m).
    fn control_step(&mut self, stage: StageName, rise: f64, initial_translation: DVec3) {
        let before = self.mean_force();
        let by = self.protocol.adjustment(before, self.stiffness, self.dt);
        let by = self.close_by(by);
        self.move_targets(by, DVec3::Z * rise);
        let start = StepStart {
            initial_translation,
            warm_start_slot: warm_start_slot(stage, by),
            ..Default::default()
        };
        self.step(stage, &start);
        self.measure_stiffness(before, by);
    }

    /// Updates the stiffness by a step that closed each finger by `by` (m) from a mean force of
    /// `before` (N). Other causes also change the force, so a step changes the estimate by at most
    /// a factor of 2.
    fn measure_stiffness(&mut self, before: f64, by: f64) {
        let measured = (self.mean_force() - before) / by;
        if measured.is_finite() && measured > 0.0 {
            self.stiffness = if self.stiffness > 0.0 {
                measured.clamp(0.5 * self.stiffness, 2.0 * self.stiffness)
            } else {
                measured
            };
        }
    }

    /// Largest motion of a finger in one step of the force adjustment, m.
    pub(super) fn adjustment_limit(&self) -> f64 {
        self.protocol.adjust_speed_m_s * self.dt
    }

    pub(super) fn step(&mut self, stage: StageName, start: &StepStart) {
        let report = self.scene.system.step(start);
        self.unconverged += usize::from(!report.converged);
        self.iterations += u64::from(report.iterations);
        self.record(stage, Some(report));
    }

    pub(super) fn object_pose(&self) -> Pose {
        let state = self.scene.system.object().state();
        let rotation = state.nearest_rotation();
        let origin = state.p - rotation * self.scene.center_of_mass;
        Pose::new(DQuat::from_mat3(&rotation), origin)
    }

    pub(super) fn record(&mut self, stage: StageName, solver: Option<StepReport>) {
        self.time += self.dt;
        let gels = self.scene.system.gels();
        self.trace.steps.push(TraceStep {
            stage,
            t_s: self.time,
            force: self.forces(),
            t_world_object: self.object_pose(),
            opening_m: self.opening,
            lifted_m: self.lifted,
            min_gap_m: [gels[0].min_gap(), gels[1].min_gap()],
            solver,
        });
        let index = self.trace.steps.len() - 1;
        if self.sampling.is_some_and(|sampling| sampling.takes(index)) {
            self.record_fields(stage);
        }
    }

    /// Records the fields at the end of the last step.
    fn record_fields(&mut self, stage: StageName) {
        let Some(series) = &mut self.trace.fields else {
            return;
        };
        let system = &self.scene.system;
        let contacts = system.node_contacts();
        let fields = (0..2).map(|i| {
            let rotation = self.scene.gripper_axes * Finger::BOTH[i].rotation();
            FaceField::new(&system.gels()[i], &series.mesh, &contacts[i], &rotation)
        });
        let step = FieldStep {
            step: self.trace.steps.len().saturating_sub(1) as u32,
            stage: Some(stage),
            t_s: self.time,
            gels: fields.collect(),
        };
        series.steps.push(step);
    }

    fn snapshot(&mut self, stage: StageName) {
        if self.sampling == Some(FieldSampling::Stages) && !self.trace.steps.is_empty() {
            self.record_fields(stage);
        }
        let snapshot = self.current(stage, DVec3::Z * self.lifted);
        self.trace.snapshots.push(snapshot);
    }

    /// Current state, with the gripper displaced by `moved_m` since the start.
    pub(super) fn current(&self, stage: StageName, moved_m: DVec3) -> Snapshot {
        let gels = self.scene.system.gels();
        let positions = |i: usize| gels[i].positions().iter().map(|x| x.to_array()).collect();
        Snapshot {
            stage,
            t_s: self.time,
            t_world_object: self.object_pose(),
            t_world_gripper: Pose::from_translation(moved_m) * self.t_world_gripper,
            opening_m: self.opening,
            gels: [positions(0), positions(1)],
        }
    }
}

/// Warm-start slot: one per stage and direction of finger motion.
pub(super) fn warm_start_slot(stage: StageName, closing_by: f64) -> usize {
    2 * stage as usize + usize::from(closing_by > 0.0)
}

/// Contact force on the passive nodes of a gel.
fn gel_force(gel: &Gel, closing: DVec3, gripper_axes: &glam::DMat3) -> GelForce {
    let mut is_driven = vec![false; gel.positions().len()];
    let mut center = DVec3::ZERO;
    for &node in gel.driven() {
        is_driven[node as usize] = true;
        center += gel.positions()[node as usize];
    }
    center /= gel.driven().len().max(1) as f64;
    let (mut force, mut moment) = (DVec3::ZERO, DVec3::ZERO);
    for ((f, x), driven) in gel.contact_forces().zip(gel.positions()).zip(&is_driven) {
        if !driven {
            force += f;
            moment += (*x - center).cross(f);
        }
    }
    GelForce {
        normal_n: -force.dot(closing),
        shear_n: [
            force.dot(gripper_axes.y_axis),
            force.dot(gripper_axes.z_axis),
        ],
        torque_n_m: moment.dot(closing),
    }
}
