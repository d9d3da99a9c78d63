//! What a solved pose is, with how far to trust it.

use glam::{DMat3, DVec3};

use crate::Part;
use gripcast_base::linear::Cholesky;
use gripcast_geometry::Pose;

/// How well one detected marker fits.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerResidual {
    /// Its number in the dictionary.
    pub id: u32,
    /// Root mean square distance of its corners from where the pose puts them, px.
    pub rms_px: f64,
    /// False for an outlier that was left out of the solution.
    pub used: bool,
}

/// Pose of a rigid part in the camera's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct PartPose {
    /// The part that was asked for; the gripper's body for a gripper.
    pub part: Part,
    /// Maps the part's frame into the camera's.
    pub t_camera_part: Pose,
    /// Covariance of [δt, δθ], m and rad, of t = t̂ + δt, R = exp(δθ) R̂ along the camera's axes.
    /// It has the corners' errors, not those of the intrinsics or of the board's dimensions.
    pub covariance: [[f64; 6]; 6],
    /// Root mean square reprojection error over the corners of all used markers, px.
    pub rms_px: f64,
    /// Standard deviation of one coordinate of a corner that the covariance assumes, px.
    pub corner_sigma_px: f64,
    /// The part's markers that were seen, in the order of the detections.
    pub markers: Vec<MarkerResidual>,
    /// Reprojection error of the runner-up over that of the pose; none without a runner-up.
    pub ambiguity: Option<f64>,
    /// The second best minimum, `t_camera_part`.
    pub runner_up: Option<Pose>,
    /// The runner-up may be the truth: the image does not decide, and no two markers face in
    /// directions 30° apart.
    pub ambiguous: bool,
    /// Largest angle between the normals of two used markers, rad.
    pub normals_apart_rad: f64,
    /// What a person should know, such as markers that were left out.
    pub notes: Vec<String>,
}

impl PartPose {
    /// Markers that the pose is made of: those that were seen without the outliers.
    #[must_use]
    pub fn used_markers(&self) -> usize {
        self.markers.iter().filter(|marker| marker.used).count()
    }
}

/// Pose of the gripper, with how far it is open.
#[derive(Clone, Debug, PartialEq)]
pub struct GripperPose {
    /// Pose of the gripper's frame.
    pub body: PartPose,
    /// Opening; none if it was not given and no finger's marker was seen.
    pub opening: Option<Opening>,
}

/// Distance between the fingers, beyond that of the board's description.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opening {
    /// Opening, m.
    pub opening_m: f64,
    /// Its standard deviation, m; 0 if the opening was given.
    pub sigma_m: f64,
}

/// Pose of the gripper in the object's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct RelativePose {
    /// Maps the gripper's frame into the object's.
    pub t_object_gripper: Pose,
    /// Covariance of [δt, δθ], m and rad, of t = t̂ + δt, R = exp(δθ) R̂ along the object's axes.
    pub covariance: [[f64; 6]; 6],
}

impl RelativePose {
    /// eᵀ C⁻¹ e of an error [δt, δθ] (m, rad): 6 on average for an honest covariance. None if the
    /// covariance is singular.
    #[must_use]
    pub fn normalised_square(&self, error: &[f64; 6]) -> Option<f64> {
        let inverse = Cholesky::beyond_rounding(&self.covariance)?.inverse();
        let products = (0..6).flat_map(|i| (0..6).map(move |k| (i, k)));
        Some(
            products
                .map(|(i, k)| error[i] * inverse[i][k] * error[k])
                .sum(),
        )
    }
}

/// The gripper's pose in the object's frame from both poses in one image. Covariances are
/// propagated to first order as independent of each other. The gripper's corners are taken to be
/// no better than the board's, whose deviation is known from more of them.
#[must_use]
pub fn relative(object: &PartPose, gripper: &PartPose) -> RelativePose {
    let t_object_camera = object.t_camera_part.inverse();
    let turn = t_object_camera.rotation_matrix();
    let apart = gripper.t_camera_part.translation_m - object.t_camera_part.translation_m;
    let by_object = blocks(-turn, turn * cross(apart), -turn);
    let by_gripper = blocks(turn, DMat3::ZERO, turn);
    let mut covariance = transformed(&by_object, &object.covariance);
    let other = transformed(&by_gripper, &gripper.covariance);
    let worse = (object.corner_sigma_px / gripper.corner_sigma_px)
        .max(1.0)
        .powi(2);
    for (row, other) in covariance.iter_mut().zip(other) {
        for (value, other) in row.iter_mut().zip(other) {
            *value += worse * other;
        }
    }
    RelativePose {
        t_object_gripper: t_object_camera * gripper.t_camera_part,
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

    fn part(rotation: DVec3, translation: DVec3) -> PartPose {
        PartPose {
            part: Part::Object,
            t_camera_part: Pose::new(DQuat::from_scaled_axis(rotation), translation),
            covariance: [[0.0; 6]; 6],
            rms_px: 0.0,
            corner_sigma_px: 0.1,
            markers: Vec::new(),
            ambiguity: None,
            runner_up: None,
            ambiguous: false,
            normals_apart_rad: 0.0,
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
    fn covariance_propagates_as_finite_differences_do() {
        let object = part(DVec3::new(2.0, 0.5, -0.4), DVec3::new(0.1, 0.05, 0.6));
        let gripper = part(DVec3::new(-1.0, 0.8, 0.3), DVec3::new(0.07, -0.06, 0.52));
        let at = relative(&object, &gripper).t_object_gripper;
        for moving in 0..2 {
            for axis in 0..6 {
                let h = 1e-6;
                let (mut o, mut g) = (object.clone(), gripper.clone());
                let which = if moving == 0 { &mut o } else { &mut g };
                which.covariance[axis][axis] = 1.0;
                let expected = relative(&o, &g).covariance;
                let which = if moving == 0 { &mut o } else { &mut g };
                which.t_camera_part = moved(&which.t_camera_part, axis, h);
                let after = relative(&o, &g).t_object_gripper;
                let shift = (after.translation_m - at.translation_m) / h;
                let turn = (after.rotation * at.rotation.conjugate()).to_scaled_axis() / h;
                let all = [shift.to_array(), turn.to_array()].concat();
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
