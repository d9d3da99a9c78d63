//! Eye-in-hand RealSense D435: sensor models of the camera of [`WristCamera`].

mod colour;
mod depth;

pub use colour::{ColourSettings, develop};
pub use depth::{DepthSettings, measure_depth};

use super::camera::Camera;
use gripcast_geometry::{Pose, WristCamera};

/// Stereo baseline, m.
pub(super) const BASELINE_M: f64 = 0.050;
/// Offset of the left imager to the right of the colour camera, m.
pub(super) const LEFT_IMAGER_M: f64 = WristCamera::LEFT_IMAGER_M;

/// Returns the colour camera for a centre crop with the aspect ratio of `width` × `height`, scaled
/// to that size.
pub fn colour_camera(width: usize, height: usize, t_world_camera: Pose) -> Camera {
    let focal = WristCamera::focal_px(width, height);
    Camera {
        width,
        height,
        focal_px: [focal; 2],
        principal_px: [0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0)],
        t_world_camera,
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn camera_looks_at_gels_with_left_finger_on_left() {
        let camera = colour_camera(1280, 720, WristCamera::t_gripper_camera());
        let at = |p: [f64; 3]| camera.project(DVec3::from_array(p)).unwrap();
        let [column, row, depth] = at([0.0, 0.0, 0.0]);
        assert!(
            (column - 639.5).abs() < 1e-9 && (300.0..520.0).contains(&row),
            "{row}"
        );
        assert!((0.15..0.2).contains(&depth));
        assert!(at([-0.03, 0.0, 0.0])[0] < column && at([0.03, 0.0, 0.0])[0] > column);
        assert!(at([0.0, 0.01, 0.0])[1] > row);
        let point = DVec3::new(0.01, -0.02, 0.03);
        let projected = WristCamera::project(point, 1280, 720).unwrap();
        assert!((projected[0] - at(point.to_array())[0]).abs() < 1e-9);
        assert!((projected[1] - at(point.to_array())[1]).abs() < 1e-9);
    }

    #[test]
    fn crop_keeps_aspect_and_scale() {
        let full = colour_camera(1280, 720, Pose::IDENTITY);
        assert_eq!(full.focal_px, [925.0; 2]);
        let fov = 2.0 * (640.0 / full.focal_px[0]).atan().to_degrees();
        assert!((fov - 69.4).abs() < 0.1, "{fov}");
        let crop = colour_camera(320, 240, Pose::IDENTITY);
        assert_eq!(WristCamera::crop_scale(320, 240), 3.0);
        assert!((crop.focal_px[0] - 925.0 / 3.0).abs() < 1e-9);
    }
}
