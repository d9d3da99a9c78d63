//! A grasp that the caller controls, one time step at a time.

use std::sync::atomic::AtomicBool;

use glam::DVec3;

use super::protocol::Protocol;
use super::run::{MIN_CONTACT_FORCE_N, Run, warm_start_slot};
use super::scene::{MAX_OPENING_M, Scene};
use super::trace::{GelForce, Snapshot, StageName};
use crate::solver::{SolverParameters, StepReport, StepStart};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::Pose;

/// A stepper is not cancelled: its caller just stops.
static NEVER: AtomicBool = AtomicBool::new(false);

/// Where the gripper goes, as fast as the limit of the speed allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepTarget {
    /// Distance between the undeformed gel faces, m.
    pub opening_m: f64,
    /// Displacement of the gripper since the start in the world, m; z is 0 or more.
    pub moved_m: DVec3,
}

/// State at the end of a step.
#[derive(Clone, Copy, Debug)]
pub struct StepState {
    /// Time since the start, s.
    pub t_s: f64,
    /// Force on the left and right gel.
    pub force: [GelForce; 2],
    /// Pose of the object in the world.
    pub t_world_object: Pose,
    /// Pose of the gripper in the world.
    pub t_world_gripper: Pose,
    /// Distance between the undeformed gel faces, m.
    pub opening_m: f64,
    /// Displacement of the gripper since the start in the world, m.
    pub moved_m: DVec3,
    /// Smallest distance between each gel and the object, m; `None` beyond `d_hat`.
    pub min_gap_m: [Option<f64>; 2],
    /// Height of the object's lowest point above the ground, m.
    pub object_height_m: f64,
    /// Work of the solver; `None` before the first step and for steps of free motion.
    pub solver: Option<StepReport>,
}

/// A grasp in progress. Gels and object are those of [`simulate`](super::simulate); the motion of the
/// gripper is the caller's.
///
/// Until a gel touches the object, the object rests.
pub struct Stepper {
    run: Run<'static>,
    max_speed_m_s: f64,
    moved_m: DVec3,
    solver: Option<StepReport>,
}

impl Stepper {
    /// Maximum speed of a finger and of the gripper unless another is given, m/s.
    pub const MAX_SPEED_M_S: f64 = 0.05;

    /// Builds the scene. A motion is spread over as many steps as `max_speed_m_s` needs.
    ///
    /// # Errors
    /// `Input` for an invalid scene or a gripper that starts inside the object or the ground, `Usage`
    /// for an invalid speed.
    pub fn new(scene: &Scene, parameters: &SolverParameters, max_speed_m_s: f64) -> Result<Self> {
        if !(max_speed_m_s.is_finite() && max_speed_m_s > 0.0) {
            return Err(Error::usage(format!(
                "`max_speed_m_s` must be a number above 0, found {max_speed_m_s}"
            )));
        }
        let built = scene.build(parameters)?;
        if let Some(detail) = &built.penetration {
            return Err(Error::input(detail.clone()).remedy("open the gripper wider, or move it"));
        }
        let protocol = Protocol::default();
        Ok(Self {
            run: Run::new(built, scene, protocol, parameters.dt_s, &NEVER),
            max_speed_m_s,
            moved_m: DVec3::ZERO,
            solver: None,
        })
    }

    /// Advances by one time step towards a target.
    ///
    /// # Errors
    /// `Usage` for a target that is not finite, below the start or wider than a gripper opens, with
    /// nothing changed.
    pub fn step(&mut self, target: &StepTarget) -> Result<()> {
        self.check(target)?;
        let run = &mut self.run;
        let reach = self.max_speed_m_s * run.dt;
        let by = (0.5 * (run.opening - target.opening_m)).clamp(-reach, reach);
        let by = run.close_by(by);
        let shift = (target.moved_m - self.moved_m).clamp_length_max(reach);
        self.moved_m += shift;
        run.lifted = self.moved_m.z;
        if run.is_out_of_range(by.abs() + shift.length()) {
            let closing = run.scene.closing;
            run.scene
                .system
                .translate_free(&closing.map(|c| c * by + shift));
            run.record(StageName::Closure, None);
            self.solver = None;
            return Ok(());
        }
        // As in `simulate`: fast closing, small corrections, motion of the gripper.
        let is_fast = by.abs() > run.adjustment_limit();
        let stage = match shift == DVec3::ZERO {
            true if is_fast => StageName::Closure,
            true => StageName::Adjustment,
            false => StageName::Lift,
        };
        run.move_targets(by, shift);
        let in_contact = |force: &GelForce| force.normal_n > MIN_CONTACT_FORCE_N;
        let is_held = run.forces().iter().all(in_contact);
        let start = StepStart {
            refactorize: stage == StageName::Closure,
            initial_translation: if is_held { shift } else { DVec3::ZERO },
            warm_start_slot: warm_start_slot(stage, by),
        };
        run.step(stage, &start);
        run.has_touched |= run.forces().iter().any(in_contact);
        self.solver = run.trace.steps.last().and_then(|step| step.solver);
        Ok(())
    }

    /// Current state.
    #[must_use]
    pub fn state(&self) -> StepState {
        let run = &self.run;
        let system = &run.scene.system;
        let gels = system.gels();
        StepState {
            t_s: run.trace.steps.last().map_or(0.0, |step| step.t_s),
            force: run.forces(),
            t_world_object: run.object_pose(),
            t_world_gripper: Pose::from_translation(self.moved_m) * run.t_world_gripper,
            opening_m: run.opening,
            moved_m: self.moved_m,
            min_gap_m: [gels[0].min_gap(), gels[1].min_gap()],
            object_height_m: system.object().lowest(system.collider()),
            solver: self.solver,
        }
    }

    /// Current state for renderers.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        self.run.current(StageName::Adjustment, self.moved_m)
    }

    fn check(&self, target: &StepTarget) -> Result<()> {
        let StepTarget { opening_m, moved_m } = *target;
        if !(0.0..=MAX_OPENING_M).contains(&opening_m) {
            return Err(Error::usage(format!(
                "`opening_m` must be from 0 to {MAX_OPENING_M} m, found {opening_m}"
            )));
        }
        if !(moved_m.is_finite() && moved_m.z >= 0.0) {
            return Err(Error::usage(format!(
                "`moved_m` must be finite with a z of 0 or more, found {moved_m}"
            ))
            .remedy("start lower: gels do not collide with the ground"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::GelResolution;
    use crate::grasp::{GraspSettings, Placement, resting_pose, simulate};
    use gripcast_geometry::{PrepareOptions, builtin, prepare};

    fn scene() -> (Scene, GraspSettings) {
        let mesh = prepare(&builtin("sphere").unwrap(), &PrepareOptions::default()).unwrap();
        let mesh = mesh.mesh;
        let (_, rest) = resting_pose(&mesh, None).unwrap();
        let placed = Placement::default()
            .place(&mesh, &rest.t_world_object)
            .unwrap();
        let mut settings = GraspSettings {
            resolution: GelResolution::Coarse,
            ..GraspSettings::default()
        };
        settings.protocol.stop_force_n = 5.0;
        let scene = Scene {
            mesh,
            mass_kg: 0.06,
            friction: 0.6,
            t_world_object: rest.t_world_object,
            t_world_gripper: placed.t_world_gripper,
            opening_m: placed.opening_m,
            gel: settings.gel().unwrap(),
        };
        (scene, settings)
    }

    #[test]
    fn closing_step_by_step_has_the_forces_of_simulate() {
        let (scene, settings) = scene();
        let whole = simulate(&scene, &settings.protocol, &settings.solver).unwrap();
        let mut stepper = Stepper::new(&scene, &settings.solver, 0.01).unwrap();
        for expected in whole.trace.stage(StageName::Closure) {
            let target = StepTarget {
                opening_m: expected.opening_m,
                moved_m: DVec3::ZERO,
            };
            stepper.step(&target).unwrap();
            let found = stepper.state();
            for (found, expected) in found.force.iter().zip(&expected.force) {
                assert!((found.normal_n - expected.normal_n).abs() < 1e-6);
            }
            assert_eq!(found.t_s, expected.t_s);
        }
        assert!(stepper.state().force[0].normal_n > 5.0);
    }

    #[test]
    fn held_object_follows_and_falls_when_released() {
        let (scene, settings) = scene();
        let mut stepper = Stepper::new(&scene, &settings.solver, 0.05).unwrap();
        let mut go = |opening_m: f64, moved_m: DVec3, steps: usize| {
            for _ in 0..steps {
                stepper.step(&StepTarget { opening_m, moved_m }).unwrap();
            }
            stepper.state()
        };
        let mut opening_m = scene.opening_m;
        while go(opening_m, DVec3::ZERO, 1).force[0].normal_n < 5.0 {
            opening_m -= 2e-4;
        }
        let before = go(opening_m, DVec3::ZERO, 1);
        let target = DVec3::new(0.004, 0.0, 0.01);
        let lifted = go(opening_m, target, 40);
        assert!((lifted.moved_m - target).length() < 1e-12);
        let rise = lifted.t_world_object.translation_m - before.t_world_object.translation_m;
        assert!((rise - target).length() < 1e-3, "{rise}");
        assert!(lifted.object_height_m > 0.008);
        let released = go(opening_m + 0.02, target, 60);
        assert!(released.object_height_m < 1e-3, "{released:?}");
        assert_eq!(released.min_gap_m, [None, None]);
    }

    #[test]
    fn invalid_targets_change_nothing() {
        let (scene, settings) = scene();
        let mut stepper = Stepper::new(&scene, &settings.solver, 0.05).unwrap();
        let target = StepTarget {
            opening_m: scene.opening_m,
            moved_m: DVec3::ZERO,
        };
        for wrong in [
            StepTarget {
                opening_m: f64::NAN,
                ..target
            },
            StepTarget {
                opening_m: -1e-9,
                ..target
            },
            StepTarget {
                moved_m: DVec3::NEG_Z,
                ..target
            },
            StepTarget {
                moved_m: DVec3::NAN,
                ..target
            },
        ] {
            assert!(stepper.step(&wrong).is_err(), "{wrong:?}");
        }
        assert_eq!(stepper.state().t_s, 0.0);
        assert!(Stepper::new(&scene, &settings.solver, 0.0).is_err());
    }
}
