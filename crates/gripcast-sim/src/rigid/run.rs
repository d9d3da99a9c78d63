//! Simulates a grasp of rigid bodies through its stages.

use glam::DVec3;

use super::settings::RigidSettings;
use super::world::World;
use crate::grasp::{
    GraspOutcome, GraspResult, MIN_CONTACT_FORCE_N, Snapshot, StageName, Trace, TraceStep,
};
use crate::solver::PhaseTimes;
use gripcast_geometry::Pose;

/// A grasp in progress.
pub(super) struct Run<'a> {
    world: World,
    settings: &'a RigidSettings,
    t_world_gripper: Pose,
    start_height: f64,
    ticks: u64,
    lifted: f64,
    has_touched: bool,
    trace: Trace,
}

impl<'a> Run<'a> {
    pub(super) fn new(world: World, settings: &'a RigidSettings, t_world_gripper: Pose) -> Self {
        Self {
            start_height: world.object_height_m(),
            world,
            settings,
            t_world_gripper,
            ticks: 0,
            lifted: 0.0,
            has_touched: false,
            trace: Trace::default(),
        }
    }

    /// Runs all stages and determines the outcome.
    pub(super) fn finish(mut self) -> GraspResult {
        let is_finite = self.close();
        let before = self.world.object_height_m();
        let was_held = self.last_force() > MIN_CONTACT_FORCE_N;
        let is_finite = is_finite && (!self.has_touched || self.lift());
        let height = self.world.object_height_m();
        let min_rise = self.settings.success_rise_m();
        let (outcome, detail) = if !is_finite {
            let detail = "the simulation diverged".to_owned();
            (GraspOutcome::NotConverged, Some(detail))
        } else if !self.has_touched {
            (GraspOutcome::Miss, None)
        } else if height - before >= min_rise {
            (GraspOutcome::Success, None)
        } else if was_held {
            (GraspOutcome::Slip, None)
        } else {
            (GraspOutcome::Eject, None)
        };
        GraspResult {
            outcome,
            detail,
            lifted_m: if is_finite {
                height - self.start_height
            } else {
                0.0
            },
            friction_use: None,
            unconverged_steps: 0,
            times: PhaseTimes::default(),
            trace: self.trace,
        }
    }

    /// Mean of both fingers' forces in the last step, N.
    fn last_force(&self) -> f64 {
        self.trace.steps.last().map_or(0.0, TraceStep::mean_force_n)
    }

    fn close(&mut self) -> bool {
        let settle = self.settings.settle_steps;
        let stages = [
            (StageName::Closure, self.settings.closing_steps - settle),
            (StageName::Adjustment, settle),
        ];
        for (stage, steps) in stages {
            for _ in 0..steps {
                if !self.step(stage, 1, 0.0) {
                    return false;
                }
                let forces = self.trace.steps.last().map(|step| step.force);
                self.has_touched |= forces
                    .iter()
                    .flatten()
                    .any(|f| f.normal_n > MIN_CONTACT_FORCE_N);
            }
            if steps > 0 && (stage == StageName::Closure || self.has_touched) {
                self.snapshot(stage);
            }
        }
        true
    }

    fn lift(&mut self) -> bool {
        let speed = self.settings.lift_speed_m_s();
        for _ in 0..self.settings.lift_steps {
            self.lifted += self.settings.lift_step_m;
            if !self.step(StageName::Lift, self.settings.lift_ticks, speed) {
                return false;
            }
        }
        self.snapshot(StageName::Lift);
        true
    }

    /// One control step; whether the state is finite.
    fn step(&mut self, stage: StageName, ticks: u32, lift_speed_m_s: f64) -> bool {
        for _ in 0..ticks {
            self.world.tick(lift_speed_m_s);
        }
        self.ticks += u64::from(ticks);
        if !self.world.is_finite() {
            return false;
        }
        self.trace.steps.push(TraceStep {
            stage,
            t_s: self.time_s(),
            force: self.world.forces(),
            t_world_object: self.world.t_world_object(),
            opening_m: self.world.opening_m(),
            lifted_m: self.lifted,
            min_gap_m: self.world.gaps_m(),
            solver: None,
        });
        true
    }

    fn time_s(&self) -> f64 {
        self.ticks as f64 * self.settings.dt_s
    }

    fn snapshot(&mut self, stage: StageName) {
        let lift = Pose::from_translation(DVec3::Z * self.lifted);
        self.trace.snapshots.push(Snapshot {
            stage,
            t_s: self.time_s(),
            t_world_object: self.world.t_world_object(),
            t_world_gripper: lift * self.t_world_gripper,
            opening_m: self.world.opening_m(),
            gels: [vec![], vec![]],
        });
    }
}
