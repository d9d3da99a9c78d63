//! Runs a grasp through its stages.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::protocol::Protocol;
use super::scene::{Scene, Stage};
use super::trace::{GelForce, Snapshot, StageName, Trace, TraceStep, pose_of};
use crate::solver::{Gel, PhaseTimes, SolverParameters, StepReport, StepStart};
use gripcast_base::error::Result;
use gripcast_geometry::Pose;

/// The gels fly freely while they are further from the object than `d_hat` and this, m.
const FLIGHT_MARGIN: f64 = 2e-4;
/// Forces below this are no contact, N.
const NO_FORCE: f64 = 1e-3;
/// Steps of a grasp that may fail to converge before it is given up.
const MAX_UNCONVERGED: usize = 5;

/// How a grasp ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GraspOutcome {
    /// Every point of the object was above the success height at the end.
    Success,
    /// It was held before the lift and did not follow, or not to the end.
    Slip,
    /// It was squeezed out before the lift.
    Eject,
    /// The fingers closed without touching it.
    Miss,
    /// The gels met each other before the force was reached.
    Closed,
    /// The gripper started inside the object or the ground.
    PenetratingStart,
    /// Steps did not converge; there is no outcome.
    NotConverged,
}

impl GraspOutcome {
    /// Its name in results and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Slip => "slip",
            Self::Eject => "eject",
            Self::Miss => "miss",
            Self::Closed => "closed",
            Self::PenetratingStart => "penetrating_start",
            Self::NotConverged => "not_converged",
        }
    }
}

/// Result of a grasp.
#[derive(Clone, Debug, Serialize)]
pub struct GraspResult {
    /// How it ended.
    pub outcome: GraspOutcome,
    /// Why, where there is more to say.
    pub detail: Option<String>,
    /// Rise of the object's centre of mass, m.
    pub lifted_m: f64,
    /// Steps that did not converge.
    pub unconverged_steps: usize,
    /// Where the solver's time went.
    pub times: PhaseTimes,
    /// All steps.
    pub trace: Trace,
}

impl GraspResult {
    /// A grasp that ended before its first step, because the gripper was inside something.
    pub(crate) fn penetrating_start(detail: String) -> Self {
        Self {
            outcome: GraspOutcome::PenetratingStart,
            detail: Some(detail),
            lifted_m: 0.0,
            unconverged_steps: 0,
            times: PhaseTimes::default(),
            trace: Trace::default(),
        }
    }
}

/// Simulates a grasp.
///
/// # Errors
/// Where the scene, the protocol or a parameter cannot be simulated. A grasp that starts inside
/// something or does not converge is no error but an outcome.
pub fn simulate(
    scene: &Scene,
    protocol: &Protocol,
    parameters: &SolverParameters,
) -> Result<GraspResult> {
    protocol.validate()?;
    let stage = scene.build(parameters)?;
    if let Some(detail) = stage.starts_penetrating {
        return Ok(GraspResult::penetrating_start(detail));
    }
    Ok(Run::new(stage, scene, protocol, parameters.dt_s).finish())
}

/// A grasp under way.
struct Run<'a> {
    stage: Stage,
    protocol: &'a Protocol,
    t_world_gripper: Pose,
    dt: f64,
    time: f64,
    opening: f64,
    lifted: f64,
    start_height: f64,
    is_closed: bool,
    has_touched: bool,
    has_reached_force: bool,
    unconverged: usize,
    iterations: u64,
    trace: Trace,
}

impl<'a> Run<'a> {
    fn new(stage: Stage, scene: &Scene, protocol: &'a Protocol, dt: f64) -> Self {
        let raise = Pose::from_translation(DVec3::Z * stage.raised_m);
        Self {
            t_world_gripper: raise * scene.t_world_gripper,
            start_height: stage.system.object().state().p.z,
            opening: scene.opening_m,
            stage,
            protocol,
            dt,
            time: 0.0,
            lifted: 0.0,
            is_closed: false,
            has_touched: false,
            has_reached_force: false,
            unconverged: 0,
            iterations: 0,
            trace: Trace::default(),
        }
    }

    fn finish(mut self) -> GraspResult {
        self.close();
        self.snapshot(StageName::Closure);
        let touched = self.has_touched;
        if touched {
            self.adjust();
            self.snapshot(StageName::Adjustment);
        }
        let was_held = self.mean_force() > NO_FORCE;
        if touched {
            self.lift();
            self.snapshot(StageName::Lift);
        }
        let object = self.stage.system.object();
        let lowest = object.lowest(self.stage.system.collider());
        let (outcome, detail) = if let Some(reason) = self.given_up() {
            (GraspOutcome::NotConverged, Some(reason))
        } else if !touched {
            (GraspOutcome::Miss, None)
        } else if lowest > self.protocol.success_height_m {
            (GraspOutcome::Success, None)
        } else if !was_held {
            (GraspOutcome::Eject, None)
        } else if self.is_closed && !self.has_reached_force {
            let detail = "the gels met each other before the force was reached".to_owned();
            (GraspOutcome::Closed, Some(detail))
        } else {
            (GraspOutcome::Slip, None)
        };
        GraspResult {
            outcome,
            detail,
            lifted_m: object.state().p.z - self.start_height,
            unconverged_steps: self.unconverged,
            times: *self.stage.system.phase_times(),
            trace: self.trace,
        }
    }

    /// Why the grasp is not simulated any further, if so.
    fn given_up(&self) -> Option<String> {
        let most = self.stage.system.parameters().max_grasp_iterations;
        if self.unconverged > MAX_UNCONVERGED {
            return Some(format!("{} steps did not converge", self.unconverged));
        }
        (self.iterations > most).then(|| format!("given up after {most} iterations"))
    }

    fn forces(&self) -> [GelForce; 2] {
        let gels = self.stage.system.gels();
        [0, 1].map(|i| gel_force(&gels[i], self.stage.closing[i], &self.stage.gripper_axes))
    }

    fn mean_force(&self) -> f64 {
        let [left, right] = self.forces();
        0.5 * (left.normal_n + right.normal_n)
    }

    /// Moves each finger by `by` (m) towards the other, as long as the gels do not meet; what was
    /// moved.
    fn squeeze(&mut self, by: f64) -> f64 {
        let room = 0.5 * (self.opening - self.stage.system.parameters().d_hat_m);
        let by = if by > 0.0 && self.stage.gels_meet() {
            self.is_closed = true;
            0.0
        } else if by >= room {
            self.is_closed = true;
            room.max(0.0)
        } else {
            by
        };
        self.opening -= 2.0 * by;
        by
    }

    fn move_targets(&mut self, squeeze: f64, lift: f64) {
        let closing = self.stage.closing;
        for (gel, closing) in self.stage.system.gels_mut().iter_mut().zip(closing) {
            gel.move_target(closing * squeeze + DVec3::Z * lift);
        }
    }

    fn may_fly(&mut self, by: f64) -> bool {
        let d_hat = self.stage.system.parameters().d_hat_m;
        let near = d_hat + FLIGHT_MARGIN + by;
        !self.has_touched && self.stage.system.clearance().iter().all(|c| *c > near)
    }

    fn close(&mut self) {
        let step = self.protocol.closing_speed_m_s * self.dt;
        while !self.is_closed && self.given_up().is_none() {
            let by = self.squeeze(step);
            if self.may_fly(by) {
                let closing = self.stage.closing;
                self.stage.system.fly(&closing.map(|c| c * by));
                self.record(StageName::Closure, None);
                continue;
            }
            self.move_targets(by, 0.0);
            let start = StepStart {
                renew: true,
                kind: kind(StageName::Closure, by),
                ..Default::default()
            };
            self.step(StageName::Closure, &start);
            let [left, right] = self.forces().map(|force| force.normal_n);
            self.has_touched |= left > NO_FORCE || right > NO_FORCE;
            if left > self.protocol.stop_force_n && right > self.protocol.stop_force_n {
                self.has_reached_force = true;
                return;
            }
        }
    }

    fn adjust(&mut self) {
        let steps = (self.protocol.adjust_s / self.dt).round() as usize;
        for _ in 0..steps {
            if self.given_up().is_some() {
                return;
            }
            let by = self.protocol.adjustment(self.mean_force(), self.dt);
            let by = self.squeeze(by);
            self.move_targets(by, 0.0);
            let start = StepStart {
                kind: kind(StageName::Adjustment, by),
                ..Default::default()
            };
            self.step(StageName::Adjustment, &start);
            self.has_reached_force |= self.mean_force() >= self.protocol.stop_force_n;
        }
    }

    fn lift(&mut self) {
        let rise = self.protocol.lift_speed_m_s * self.dt;
        let steps = (self.protocol.lift_m / rise).round() as usize;
        let mut follows = true;
        for _ in 0..steps {
            if self.given_up().is_some() {
                return;
            }
            let mean = self.mean_force();
            let by = self.protocol.adjustment(mean, self.dt);
            let by = self.squeeze(by);
            self.move_targets(by, rise);
            self.lifted += rise;
            let is_held = self.forces().iter().all(|f| f.normal_n > NO_FORCE);
            let start = StepStart {
                together: if follows && is_held {
                    DVec3::Z * rise
                } else {
                    DVec3::ZERO
                },
                kind: kind(StageName::Lift, by),
                ..Default::default()
            };
            let before = self.stage.system.object().state().p.z;
            self.step(StageName::Lift, &start);
            let risen = self.stage.system.object().state().p.z - before;
            follows = risen > 0.5 * rise;
        }
    }

    fn step(&mut self, stage: StageName, start: &StepStart) {
        let report = self.stage.system.step(start);
        self.unconverged += usize::from(!report.converged);
        self.iterations += u64::from(report.iterations);
        self.record(stage, Some(report));
    }

    fn object_pose(&self) -> Pose {
        let state = self.stage.system.object().state();
        let rotation = state.nearest_rotation();
        pose_of(rotation, state.p - rotation * self.stage.center_of_mass)
    }

    fn record(&mut self, stage: StageName, solver: Option<StepReport>) {
        self.time += self.dt;
        let gels = self.stage.system.gels();
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
    }

    fn snapshot(&mut self, stage: StageName) {
        let lift = Pose::from_translation(DVec3::Z * self.lifted);
        let gels = self.stage.system.gels();
        let positions = |i: usize| gels[i].positions().iter().map(|x| x.to_array()).collect();
        let snapshot = Snapshot {
            stage,
            t_s: self.time,
            t_world_object: self.object_pose(),
            t_world_gripper: lift * self.t_world_gripper,
            opening_m: self.opening,
            gels: [positions(0), positions(1)],
        };
        self.trace.snapshots.push(snapshot);
    }
}

/// Steps that move the fingers alike, numbered for [`StepStart::kind`].
fn kind(stage: StageName, squeeze: f64) -> usize {
    2 * stage as usize + usize::from(squeeze > 0.0)
}

/// What a gel feels on its passive nodes.
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
