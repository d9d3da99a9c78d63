//! Tells during the lift whether the outcome of a grasp is certain.

use glam::DVec3;

use super::run::{GraspOutcome, MIN_CONTACT_FORCE_N};
use gripcast_geometry::Pose;

/// Consecutive steps without contact on a finger after which the object is lost.
const LOST_STEPS: usize = 5;
/// Rise of the gripper up to which nothing is certain, m: a jerk at the start may free a finger.
const MIN_LIFT_M: f64 = 0.005;
/// Rise of the gripper from which an object may count as held, m.
const MIN_HELD_LIFT_M: f64 = 0.01;
/// Rise of the gripper over which a held object rests in the grip, m.
const REST_LIFT_M: f64 = 0.004;
/// Maximum motion of a resting object in the grip, as a fraction of the gripper's rise.
const MAX_CREEP: f64 = 0.003;
/// Maximum rotation of a resting object in the grip, rad per metre of the gripper's rise.
const MAX_TURN_RAD_M: f64 = 0.2;
/// Minimum height of a held object above the ground, m.
const MIN_CLEARANCE_M: f64 = 0.002;

/// Follows a lift step by step.
///
/// Nothing is certain in the first 5 mm. Then an object is lost once a finger has not touched it for
/// five steps. It is held once the gripper has risen by 10 mm and the object is clear of the ground
/// and rests in the grip: it neither creeps nor turns. How often the full protocol ends otherwise is
/// in docs/how-to/synth.md (`gripcast-bench early-end`).
#[derive(Clone, Debug, Default)]
pub struct LiftMonitor {
    steps_without_contact: usize,
    /// Rise of the gripper and pose of the object in it, step by step.
    states: Vec<(f64, Pose)>,
}

impl LiftMonitor {
    /// Adds a step: the rise of the gripper, the normal force on both gels, the object's pose in the
    /// gripper, its centre of mass in its own frame, and the height of its lowest point above the
    /// ground (m, N). Returns the outcome once it is certain.
    pub fn add(
        &mut self,
        lifted_m: f64,
        normal_n: [f64; 2],
        t_gripper_object: Pose,
        center_m: DVec3,
        lowest_m: f64,
    ) -> Option<GraspOutcome> {
        let is_loose = normal_n.iter().any(|n| *n < MIN_CONTACT_FORCE_N);
        self.steps_without_contact = if is_loose {
            self.steps_without_contact + 1
        } else {
            0
        };
        self.states.push((lifted_m, t_gripper_object));
        if lifted_m < MIN_LIFT_M {
            return None;
        }
        if self.steps_without_contact >= LOST_STEPS {
            return Some(GraspOutcome::Slip);
        }
        if lifted_m < MIN_HELD_LIFT_M || lowest_m < MIN_CLEARANCE_M {
            return None;
        }
        let is_old = |state: &&(f64, Pose)| state.0 <= lifted_m - REST_LIFT_M;
        let (then_m, before) = self.states.iter().rev().find(is_old)?;
        let risen_m = lifted_m - then_m;
        let center = |pose: &Pose| pose.transform_point(center_m);
        let creep_m = center(&t_gripper_object).distance(center(before));
        let turn_rad = t_gripper_object.rotation_from(before).length();
        let rests = creep_m < MAX_CREEP * risen_m && turn_rad < MAX_TURN_RAD_M * risen_m;
        rests.then_some(GraspOutcome::Success)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Feeds a lift in which the object creeps by a fraction of the gripper's rise.
    fn lift(creep: f64, forces: impl Fn(usize) -> [f64; 2]) -> Option<(GraspOutcome, f64)> {
        let mut monitor = LiftMonitor::default();
        (1..=250).find_map(|step| {
            let lifted = 2e-4 * step as f64;
            let pose = Pose::from_translation(DVec3::Z * -creep * lifted);
            let outcome = monitor.add(lifted, forces(step), pose, DVec3::ZERO, lifted - 1e-3);
            outcome.map(|outcome| (outcome, lifted))
        })
    }

    #[test]
    fn resting_object_is_held_after_a_centimetre() {
        let (outcome, lifted) = lift(0.0, |_| [10.0; 2]).unwrap();
        assert_eq!(outcome, GraspOutcome::Success);
        assert!((lifted - 0.01).abs() < 1e-9, "{lifted}");
        assert_eq!(lift(0.01, |_| [10.0; 2]), None, "it creeps");
    }

    #[test]
    fn object_is_lost_after_some_steps_without_a_finger() {
        let (outcome, lifted) =
            lift(0.5, |step| [10.0, if step < 30 { 10.0 } else { 0.0 }]).unwrap();
        assert_eq!(outcome, GraspOutcome::Slip);
        assert!((lifted - 34.0 * 2e-4).abs() < 1e-9, "{lifted}");
        assert_eq!(
            lift(0.5, |step| [10.0, (step % 3) as f64]),
            None,
            "it touches again"
        );
    }
}
