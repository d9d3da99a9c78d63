//! Solved poses with covariance and quality.

use glam::{DMat3, DVec3};

use crate::Body;
use gripcast_base::linear::Cholesky;
use gripcast_base::statistics::median;
use gripcast_geometry::Pose;

/// Median residual of the markers above which board or intrinsics are doubtful, px.
const MAX_MEDIAN_RESIDUAL_PX: f64 = 0.3;

/// Residual of a detected marker.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerResidual {
    /// Id in the dictionary.
    pub id: u32,
    /// Root mean square reprojection error of its corners, px.
    pub rms_px: f64,
    /// False for an outlier.
    pub used: bool,
}

/// Pose of a rigid body in the camera frame.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyPose {
    /// The body; [`Body::Gripper`] for a gripper.
    pub body: Body,
    /// Pose of the body in the camera frame.
    pub t_camera_body: Pose,
    /// Covariance of [δt, δθ], m and rad, of t = t̂ + δt, R = exp(δθ) R̂ along the camera axes.
    /// It includes the errors of the corners, not those of the intrinsics or of the board.
    pub covariance: [[f64; 6]; 6],
    /// Root mean square reprojection error of the used markers, px.
    pub rms_px: f64,
    /// Standard deviation of a corner coordinate that the covariance assumes, px.
    pub corner_sigma_px: f64,
    /// Detected markers of the body, in the order of the detections.
    pub markers: Vec<MarkerResidual>,
    /// Ratio of the runner-up's reprojection error to that of the pose.
    pub ambiguity: Option<f64>,
    /// `t_camera_body` of the second best minimum.
    pub runner_up: Option<Pose>,
    /// Whether the runner-up is plausible as well: its error is similar, and all normals are
    /// within 30°.
    pub ambiguous: bool,
    /// Largest angle between the normals of two used markers, rad.
    pub normal_spread_rad: f64,
    /// Notes for the user, such as excluded markers.
    pub notes: Vec<String>,
}

impl BodyPose {
    /// Number of used markers.
    #[must_use]
    pub fn used_markers(&self) -> usize {
        self.markers.iter().filter(|marker| marker.used).count()
    }

    /// Note that the markers of `what` do not fit their board well: an error of the board or of the
    /// intrinsics shows in most markers, a partly covered marker in itself only.
    #[must_use]
    pub fn residual_note(&self, what: &str) -> Option<String> {
        let used = self.markers.iter().filter(|marker| marker.used);
        let median_px = median(used.map(|marker| marker.rms_px))?;
        (median_px > MAX_MEDIAN_RESIDUAL_PX).then(|| {
            format!(
                "the residual of the {what} is {median_px:.2} px: check board file, intrinsics, and \
                 that the print is flat"
            )
        })
    }
}

/// Pose and opening of the gripper.
#[derive(Clone, Debug, PartialEq)]
pub struct GripperPose {
    /// Pose of the gripper's frame.
    pub body: BodyPose,
    /// `None`: neither given nor determined by finger markers.
    pub opening: Option<Opening>,
}

/// Opening of the gripper, relative to the board file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opening {
    /// Opening, m.
    pub opening_m: f64,
    /// Standard deviation, m; 0 for a given opening.
    pub sigma_m: f64,
}

/// Pose of the gripper in the object frame.
#[derive(Clone, Debug, PartialEq)]
pub struct RelativePose {
    /// Pose of the gripper in the object frame.
    pub t_object_gripper: Pose,
    /// Covariance of [δt, δθ], m and rad, of t = t̂ + δt, R = exp(δθ) R̂ along the object axes.
    pub covariance: [[f64; 6]; 6],
}

impl RelativePose {
    /// eᵀ C⁻¹ e of an error [δt, δθ] (m, rad): 6 on average for a consistent covariance. `None`:
    /// the covariance is singular.
    #[must_use]
    pub fn squared_mahalanobis(&self, error: &[f64; 6]) -> Option<f64> {
        let inverse = Cholesky::beyond_rounding(&self.covariance)?.inverse();
        let products = (0..6).flat_map(|i| (0..6).map(move |k| (i, k)));
        Some(
            products
                .map(|(i, k)| error[i] * inverse[i][k] * error[k])
                .sum(),
        )
    }
}

/// Pose of the gripper relative to the object, both from one image. Covariances are propagated to
/// first order as independent. The corner deviation of the gripper is at least that of the board,
/// which is estimated from more corners.
#[must_use]
pub fn relative_pose(object: &BodyPose, gripper: &BodyPose) -> RelativePose {
    let t_object_camera = object.t_camera_body.inverse();
    let rotation = t_object_camera.rotation_matrix();
    let offset = gripper.t_camera_body.translation_m - object.t_camera_body.translation_m;
    let by_object = blocks(-rotation, rotation * cross(offset), -rotation);
    let by_gripper = blocks(rotation, DMat3::ZERO, rotation);
    let mut covariance = transformed(&by_object, &object.covariance);
    let other = transformed(&by_gripper, &gripper.covariance);
    let scale = (object.corner_sigma_px / gripper.corner_sigma_px)
        .max(1.0)
        .powi(2);
    for (row, other) in covariance.iter_mut().zip(other) {
        for (value, other) in row.iter_mut().zip(other) {
            *value += scale * other;
        }
    }
    RelativePose {
        t_object_gripper: t_object_camera * gripper.t_camera_body,
        covariance,
    }
}

/// The matrix of v ↦ a × v.
fn cross(a: DVec3) -> DMat3 {
    DMat3::from_cols(a.cross(DVec3::X), a.cross(DVec3::Y), a.cross(DVec3::Z))
}

/// [[tt, tr], [0, rr]].
fn blocks(tt: DMat3, tr: DMat3, rr: DMat3) -> [[f64; 6]; 6] {
    let mut matrix = [[0.0; 6]; 6];
    for i in 0..3 {
        for j in 0..3 {
            matrix[i][j] = tt.col(j)[i];
            matrix[i][j + 3] = tr.col(j)[i];
            matrix[i + 3][j + 3] = rr.col(j)[i];
        }
    }
    matrix
}

/// J C Jᵀ.
fn transformed(j: &[[f64; 6]; 6], c: &[[f64; 6]; 6]) -> [[f64; 6]; 6] {
    let mut jc = [[0.0; 6]; 6];
    let mut result = [[0.0; 6]; 6];
    for i in 0..6 {
        for k in 0..6 {
            jc[i][k] = (0..6).map(|l| j[i][l] * c[l][k]).sum();
        }
    }
    for i in 0..6 {
        for k in 0..6 {
            result[i][k] = (0..6).map(|l| jc[i][l] * j[k][l]).sum();
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn body(rotation: DVec3, translation: DVec3) -> BodyPose {
        BodyPose {
            body: Body::Object,
            t_camera_body: Pose::new(DQuat::from_scaled_axis(rotation), translation),
            covariance: [[0.0; 6]; 6],
            rms_px: 0.0,
            corner_sigma_px: 0.1,
            markers: Vec::new(),
            ambiguity: None,
            runner_up: None,
            ambiguous: false,
            normal_spread_rad: 0.0,
            notes: Vec::new(),
        }
    }

    fn moved(pose: &Pose, axis: usize, by: f64) -> Pose {
        let mut step = [DVec3::ZERO; 2];
        step[axis / 3][axis % 3] = by;
        Pose::new(
            DQuat::from_scaled_axis(step[1]) * pose.rotation,
            pose.translation_m + step[0],
        )
    }

    #[test]
    fn covariance_matches_finite_differences() {
        let object = body(DVec3::new(2.0, 0.5, -0.4), DVec3::new(0.1, 0.05, 0.6));
        let gripper = body(DVec3::new(-1.0, 0.8, 0.3), DVec3::new(0.07, -0.06, 0.52));
        let at = relative_pose(&object, &gripper).t_object_gripper;
        for moving in 0..2 {
            for axis in 0..6 {
                let h = 1e-6;
                let (mut o, mut g) = (object.clone(), gripper.clone());
                let changed = if moving == 0 { &mut o } else { &mut g };
                changed.covariance[axis][axis] = 1.0;
                let expected = relative_pose(&o, &g).covariance;
                let changed = if moving == 0 { &mut o } else { &mut g };
                changed.t_camera_body = moved(&changed.t_camera_body, axis, h);
                let after = relative_pose(&o, &g).t_object_gripper;
                let shift = (after.translation_m - at.translation_m) / h;
                let rotation = (after.rotation * at.rotation.conjugate()).to_scaled_axis() / h;
                let all = [shift.to_array(), rotation.to_array()].concat();
                for i in 0..6 {
                    for k in 0..6 {
                        let difference = expected[i][k] - all[i] * all[k];
                        assert!(difference.abs() < 1e-5, "{moving} {axis} {i} {k}");
                    }
                }
            }
        }
    }
}
