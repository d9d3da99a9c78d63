//! Conversion between the crate's vectors and poses and rapier's, which use another version of
//! glam.

use glam::{DQuat, DVec3};
use rapier3d_f64::math::{Pose as RapierPose, Rotation, Vector};

use gripcast_geometry::Pose;

pub(super) fn vector(v: DVec3) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

pub(super) fn from_vector(v: Vector) -> DVec3 {
    DVec3::new(v.x, v.y, v.z)
}

pub(super) fn pose(p: &Pose) -> RapierPose {
    let q = p.rotation;
    RapierPose::from_parts(
        vector(p.translation_m),
        Rotation::from_xyzw(q.x, q.y, q.z, q.w),
    )
}

pub(super) fn from_pose(p: &RapierPose) -> Pose {
    let q = p.rotation;
    Pose::new(
        DQuat::from_xyzw(q.x, q.y, q.z, q.w),
        from_vector(p.translation),
    )
}
