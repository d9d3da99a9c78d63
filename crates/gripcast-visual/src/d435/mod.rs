//! Eye-in-hand RealSense D435: pose, intrinsics and sensor models.
//!
//! The colour camera is centred on the gripper, 78 mm off the finger plane (towards −y) and 165 mm
//! behind the centre of the gels; its optical axis is the approach direction pitched by 22° onto
//! the gels. Image columns run along the gripper's +x (left finger on the left), rows along +y.

mod colour;
mod depth;

pub use colour::{ColourSettings, develop};
pub use depth::{DepthSettings, measure_depth};

use glam::{DQuat, DVec3};

use super::camera::Camera;
use gripcast_geometry::Pose;

/// Position of the colour camera in the gripper frame, m.
const POSITION_M: [f64; 3] = [0.0, -0.078, -0.165];
/// Rotation of the optical axis from the approach direction towards the finger plane, rad.
const PITCH_RAD: f64 = 22.0 * std::f64::consts::PI / 180.0;
/// Width and height of the colour stream, px.
pub const COLOUR_SIZE: [usize; 2] = [1280, 720];
/// Focal length of the colour stream, px: 69.4° × 42.5° (D400 series data sheet).
pub const COLOUR_FOCAL_PX: f64 = 925.0;
/// Stereo baseline, m.
pub(super) const BASELINE_M: f64 = 0.050;
/// Offset of the left imager to the right of the colour camera, m.
pub(super) const LEFT_IMAGER_M: f64 = 0.0147;

/// Pose of the colour camera in the gripper frame.
pub fn t_gripper_camera() -> Pose {
    let rotation = DQuat::from_rotation_x(-PITCH_RAD);
    Pose::new(rotation, DVec3::from_array(POSITION_M))
}

/// Returns the colour camera for a centre crop with the aspect ratio of `width` × `height`, scaled
/// to that size.
pub fn colour_camera(width: usize, height: usize, t_world_camera: Pose) -> Camera {
    let focal = COLOUR_FOCAL_PX / crop_scale(width, height);
    Camera {
        width,
        height,
        focal_px: [focal; 2],
        principal_px: [0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0)],
        t_world_camera,
    }
}

/// Returns the number of colour pixels per pixel of the cropped and scaled image.
pub fn crop_scale(width: usize, height: usize) -> f64 {
    let [full_width, full_height] = COLOUR_SIZE.map(|n| n as f64);
    (full_width / width.max(1) as f64).min(full_height / height.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camera_looks_at_gels_with_left_finger_on_left() {
        let camera = colour_camera(1280, 720, t_gripper_camera());
        let at = |p: [f64; 3]| camera.project(DVec3::from_array(p)).unwrap();
        let [column, row, depth] = at([0.0, 0.0, 0.0]);
        assert!(
            (column - 639.5).abs() < 1e-9 && (300.0..520.0).contains(&row),
            "{row}"
        );
        assert!((0.15..0.2).contains(&depth));
        assert!(at([-0.03, 0.0, 0.0])[0] < column && at([0.03, 0.0, 0.0])[0] > column);
        assert!(at([0.0, 0.01, 0.0])[1] > row);
    }

    #[test]
    fn crop_keeps_aspect_and_scale() {
        let full = colour_camera(1280, 720, Pose::IDENTITY);
        assert_eq!(full.focal_px, [925.0; 2]);
        let fov = 2.0 * (640.0 / full.focal_px[0]).atan().to_degrees();
        assert!((fov - 69.4).abs() < 0.1, "{fov}");
        let crop = colour_camera(320, 240, Pose::IDENTITY);
        assert_eq!(crop_scale(320, 240), 3.0);
        assert!((crop.focal_px[0] - 925.0 / 3.0).abs() < 1e-9);
    }
}
