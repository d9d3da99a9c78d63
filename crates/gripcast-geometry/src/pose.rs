//! Rigid transform between two frames.

use std::ops::Mul;

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Largest deviation of a quaternion's norm from 1 accepted as rounding in files.
const UNIT_TOLERANCE: f64 = 1e-3;

/// Deviation of the norm that normalisation may leave.
const UNIT_ROUNDING: f64 = 4.0 * f64::EPSILON;

/// Rigid transform `t_a_b`: maps coordinates of frame b into frame a.
///
/// Serialised as `{"t_m":[x,y,z],"q_wxyz":[w,x,y,z]}` with a unit quaternion and w ≥ 0.
///
/// ```
/// use gripcast_geometry::Pose;
/// use glam::{DQuat, DVec3};
/// let t_world_object = Pose::new(DQuat::from_rotation_z(1.0), DVec3::new(0.0, 0.0, 0.1));
/// let back = t_world_object.inverse() * t_world_object;
/// assert!(back.transform_point(DVec3::X).distance(DVec3::X) < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "PoseRecord", try_from = "PoseRecord")]
pub struct Pose {
    /// Rotation from b to a; unit length, w ≥ 0.
    pub rotation: DQuat,
    /// Origin of b in coordinates of a, m.
    pub translation_m: DVec3,
}

impl Pose {
    /// The identity transform.
    pub const IDENTITY: Self = Self {
        rotation: DQuat::IDENTITY,
        translation_m: DVec3::ZERO,
    };

    /// Pose from a rotation, which is normalised with w ≥ 0, and a translation in metres. A zero or
    /// non-finite quaternion becomes the identity.
    pub fn new(rotation: DQuat, translation_m: DVec3) -> Self {
        Self {
            rotation: canonical(rotation),
            translation_m,
        }
    }

    /// Pure translation, m.
    pub fn from_translation(translation_m: DVec3) -> Self {
        Self::new(DQuat::IDENTITY, translation_m)
    }

    /// Pure rotation about the origin.
    pub fn from_rotation(rotation: DQuat) -> Self {
        Self::new(rotation, DVec3::ZERO)
    }

    /// `t_b_a` of a `t_a_b`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self::new(rotation, -(rotation * self.translation_m))
    }

    /// Transforms a point from b into a, m.
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation_m
    }

    /// Rotates a free vector (direction, force) from b into a.
    pub fn transform_vector(&self, vector: DVec3) -> DVec3 {
        self.rotation * vector
    }

    /// Rotation vector (rad, in frame a) of the shortest rotation from the orientation of `other`
    /// to this one.
    pub fn rotation_from(&self, other: &Self) -> DVec3 {
        let rotation = self.rotation * other.rotation.conjugate();
        let shortest = if rotation.w < 0.0 {
            -rotation
        } else {
            rotation
        };
        shortest.to_scaled_axis()
    }

    /// Rotation matrix; its columns are the axes of b in a.
    pub fn rotation_matrix(&self) -> DMat3 {
        DMat3::from_quat(self.rotation)
    }
}

impl Default for Pose {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Mul for Pose {
    type Output = Self;

    /// `t_a_b * t_b_c = t_a_c`.
    fn mul(self, t_b_c: Self) -> Self {
        Self::new(
            self.rotation * t_b_c.rotation,
            self.transform_point(t_b_c.translation_m),
        )
    }
}

/// Canonical unit quaternion: w ≥ 0, and at w = 0 the first non-zero component positive. A
/// canonical quaternion keeps its bits, so that poses round-trip through files.
fn canonical(rotation: DQuat) -> DQuat {
    let norm = rotation.length();
    if !norm.is_finite() || norm == 0.0 {
        return DQuat::IDENTITY;
    }
    let is_unit = (norm - 1.0).abs() <= UNIT_ROUNDING;
    let unit = if is_unit { rotation } else { rotation / norm };
    let leading = [unit.w, unit.x, unit.y, unit.z]
        .into_iter()
        .find(|component| *component != 0.0);
    let signed = if leading < Some(0.0) { -unit } else { unit };
    // Adding zero maps −0 to 0.
    DQuat::from_xyzw(
        signed.x + 0.0,
        signed.y + 0.0,
        signed.z + 0.0,
        signed.w + 0.0,
    )
}

/// Serialised form of a pose.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseRecord {
    t_m: [f64; 3],
    q_wxyz: [f64; 4],
}

impl From<Pose> for PoseRecord {
    fn from(pose: Pose) -> Self {
        let q = canonical(pose.rotation);
        Self {
            t_m: pose.translation_m.to_array(),
            q_wxyz: [q.w, q.x, q.y, q.z],
        }
    }
}

impl TryFrom<PoseRecord> for Pose {
    type Error = String;

    fn try_from(PoseRecord { t_m, q_wxyz }: PoseRecord) -> Result<Self, String> {
        if !t_m.iter().all(|v| v.is_finite()) {
            return Err(format!(
                "t_m must be three finite numbers in metres, found {t_m:?}"
            ));
        }
        let [w, x, y, z] = q_wxyz;
        let rotation = DQuat::from_xyzw(x, y, z, w);
        let norm = rotation.length();
        // Also rejects NaN.
        let is_unit = (norm - 1.0).abs() <= UNIT_TOLERANCE;
        if !is_unit {
            return Err(format!(
                "q_wxyz must be a unit quaternion [w, x, y, z], found {q_wxyz:?} with norm \
                 {norm}; divide it by its norm"
            ));
        }
        Ok(Self::new(rotation, DVec3::from_array(t_m)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_pose() -> impl Strategy<Value = Pose> {
        let part = -1.0..1.0f64;
        (
            [part.clone(), part.clone(), part.clone(), part.clone()],
            [part.clone(), part.clone(), part],
        )
            .prop_filter("needs a direction", |(q, _)| {
                q.iter().map(|v| v * v).sum::<f64>() > 1e-2
            })
            .prop_map(|(q, t)| Pose::new(DQuat::from_array(q), DVec3::from_array(t)))
    }

    proptest! {
        #[test]
        fn inverse_and_composition_agree_with_points(
            t_a_b in any_pose(), t_b_c in any_pose(), p in [-1.0..1.0f64, -1.0..1.0, -1.0..1.0]
        ) {
            let p = DVec3::from_array(p);
            let there = (t_a_b * t_b_c).transform_point(p);
            prop_assert!(there.distance(t_a_b.transform_point(t_b_c.transform_point(p))) < 1e-12);
            prop_assert!((t_a_b * t_b_c).inverse().transform_point(there).distance(p) < 1e-12);
            let matrix = t_a_b.rotation_matrix() * p;
            prop_assert!(matrix.distance(t_a_b.transform_vector(p)) < 1e-12);
        }

        #[test]
        fn pose_round_trips_through_json(pose in any_pose()) {
            let text = serde_json::to_string(&pose).unwrap();
            let back: Pose = serde_json::from_str(&text).unwrap();
            prop_assert!(back.rotation.w >= 0.0);
            prop_assert_eq!(back, pose);
            prop_assert_eq!(Pose::new(pose.rotation, pose.translation_m), pose);
        }
    }

    #[test]
    fn serialised_form_is_stable() {
        let pose = Pose {
            rotation: DQuat::from_xyzw(0.0, 0.0, 0.6, -0.8),
            translation_m: DVec3::new(0.5, 0.0, -1.0),
        };
        assert_eq!(
            serde_json::to_string(&pose).unwrap(),
            r#"{"t_m":[0.5,0.0,-1.0],"q_wxyz":[0.8,0.0,0.0,-0.6]}"#
        );
    }

    #[test]
    fn half_turn_has_a_unique_quaternion() {
        let a = Pose::from_rotation(DQuat::from_xyzw(0.0, -1.0, 0.0, 0.0));
        let b = Pose::from_rotation(DQuat::from_xyzw(0.0, 1.0, 0.0, -0.0));
        assert_eq!(a, b);
        assert!(a.rotation.w.is_sign_positive());
    }

    #[test]
    fn invalid_poses_are_rejected() {
        let refused = |text: &str| serde_json::from_str::<Pose>(text).unwrap_err().to_string();
        let long = refused(r#"{"t_m":[0,0,0],"q_wxyz":[1,1,0,0]}"#);
        assert!(long.contains("unit quaternion"), "{long}");
        assert!(long.contains("1.414"), "{long}");
        let zero = refused(r#"{"t_m":[0,0,0],"q_wxyz":[0,0,0,0]}"#);
        assert!(zero.contains("unit quaternion"), "{zero}");
        let huge = refused(r#"{"t_m":[1e999,0,0],"q_wxyz":[1,0,0,0]}"#);
        assert!(huge.contains("number out of range"), "{huge}");
        let unknown = refused(r#"{"t_m":[0,0,0],"q_wxyz":[1,0,0,0],"frame":"world"}"#);
        assert!(unknown.contains("frame"), "{unknown}");
    }

    #[test]
    fn nan_values_are_rejected() {
        let read = |t_m: [f64; 3], q_wxyz: [f64; 4]| Pose::try_from(PoseRecord { t_m, q_wxyz });
        assert!(read([0.0; 3], [1.0, 0.0, 0.0, 0.0]).is_ok());
        let q = read([0.0; 3], [f64::NAN, 0.0, 0.0, 1.0]).unwrap_err();
        assert!(q.contains("unit quaternion"), "{q}");
        let t = read([0.0, f64::NAN, 0.0], [1.0, 0.0, 0.0, 0.0]).unwrap_err();
        assert!(t.contains("finite"), "{t}");
    }
}
