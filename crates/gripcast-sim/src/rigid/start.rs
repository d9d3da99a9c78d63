//! Where the fingers can start.

use glam::DVec3;
use rapier3d_f64::geometry::SharedShape;
use rapier3d_f64::parry::query::intersection_test;

use super::convert;
use super::decomposition::Decomposition;
use super::world::{FINGER_HALF_M, finger_x};
use crate::GraspSetup;
use crate::grasp::Finger;
use gripcast_geometry::Pose;

/// The opening to start from: the wanted one where the set-up's own is narrower and there is room
/// for the fingers, else the set-up's own.
///
/// # Errors
/// What the fingers are inside of.
pub(super) fn opening(
    setup: &GraspSetup,
    pieces: &Decomposition,
    wanted_m: f64,
) -> Result<f64, String> {
    if wanted_m > setup.opening_m && penetration(setup, pieces, wanted_m).is_none() {
        return Ok(wanted_m);
    }
    match penetration(setup, pieces, setup.opening_m) {
        None => Ok(setup.opening_m),
        Some(what) => Err(what),
    }
}

/// What a finger is inside of at an opening, if anything.
fn penetration(setup: &GraspSetup, pieces: &Decomposition, opening_m: f64) -> Option<String> {
    let t_object = convert::pose(&setup.t_world_object);
    let half = FINGER_HALF_M;
    let shape = SharedShape::cuboid(half.x, half.y, half.z);
    for (finger, side) in Finger::BOTH.into_iter().zip(["left", "right"]) {
        let middle = Pose::from_translation(DVec3::X * finger_x(finger, opening_m));
        let t_finger = setup.t_world_gripper * middle;
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
        // A pair of shapes that cannot be tested does not occur; it would count as free.
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
