//! Initial opening of the fingers.

use glam::DVec3;
use rapier3d_f64::geometry::SharedShape;
use rapier3d_f64::parry::query::intersection_test;

use super::convert;
use super::decomposition::Decomposition;
use super::settings::RigidSettings;
use super::world::finger_x;
use crate::GraspSetup;
use crate::fem::GelPad;
use crate::grasp::Finger;
use gripcast_geometry::Pose;

/// Initial opening (m): that of the settings if it is wider than the setup's own and collision-free,
/// else the setup's own.
///
/// # Errors
/// A description of the collision if the fingers start inside object or ground.
pub(super) fn opening(
    setup: &GraspSetup,
    pieces: &Decomposition,
    settings: &RigidSettings,
) -> Result<f64, String> {
    let preferred_m = settings.opening_m;
    let penetration = |opening_m: f64| penetration(setup, pieces, &settings.pad, opening_m);
    if preferred_m > setup.opening_m && penetration(preferred_m).is_none() {
        return Ok(preferred_m);
    }
    penetration(setup.opening_m).map_or(Ok(setup.opening_m), Err)
}

/// Describes a collision of a finger with object or ground at an opening, if there is one.
fn penetration(
    setup: &GraspSetup,
    pieces: &Decomposition,
    pad: &GelPad,
    opening_m: f64,
) -> Option<String> {
    let t_object = convert::pose(&setup.t_world_object);
    let half = pad.half_in_gripper_m();
    let shape = SharedShape::cuboid(half.x, half.y, half.z);
    for (finger, side) in Finger::BOTH.into_iter().zip(["left", "right"]) {
        let x = finger_x(finger, opening_m, pad.thickness_m);
        let t_gripper_finger = Pose::from_translation(DVec3::X * x);
        let t_finger = setup.t_world_gripper * t_gripper_finger;
        let reach = t_finger
            .rotation_matrix()
            .transpose()
            .z_axis
            .abs()
            .dot(half);
        let lowest = t_finger.translation_m.z - reach;
        if lowest < 0.0 {
            return Some(format!(
                "the {side} finger reaches {:.1} mm below the ground",
                -1e3 * lowest
            ));
        }
        let t_finger = convert::pose(&t_finger);
        // Unsupported pairs of shapes do not occur; they would count as collision-free.
        let meets = pieces.shapes().iter().any(|piece| {
            intersection_test(&t_finger, &*shape.0, &t_object, &*piece.0)
                .is_ok_and(|found| found.intersecting)
        });
        if meets {
            return Some(format!("the {side} finger is inside the object"));
        }
    }
    None
}
