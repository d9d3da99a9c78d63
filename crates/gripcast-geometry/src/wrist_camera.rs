//! Nominal mount and lens of the RealSense D435 between the fingers.
//!
//! The colour camera is centred on the gripper, 78 mm off the finger plane (towards −y) and 165 mm
//! behind the centre of the gels; its optical axis is the approach direction pitched by 22° onto
//! the gels. Image columns run along the gripper's +x (left finger on the left), rows along +y.

use glam::{DQuat, DVec3};

use crate::Pose;

/// Position of the colour camera in the gripper frame, m.
const POSITION_M: [f64; 3] = [0.0, -0.078, -0.165];
/// Width and height of the images of an imager, px. A mode with another aspect ratio is a crop.
const IMAGER_SIZE: [f64; 2] = [1280.0, 800.0];
/// Focal length of an imager, px: 58° over 720 rows (D400 series data sheet, ± 1°).
const IMAGER_FOCAL_PX: f64 = 649.5;
/// Rotation of the optical axis from the approach direction towards the finger plane, rad.
const PITCH_RAD: f64 = 22.0 * std::f64::consts::PI / 180.0;

/// The camera between the fingers.
#[derive(Clone, Copy, Debug)]
pub struct WristCamera;

impl WristCamera {
    /// Width and height of the colour stream, px.
    pub const COLOUR_SIZE: [usize; 2] = [1280, 720];
    /// Focal length of the colour stream, px: 69.4° × 42.5° (D400 series data sheet).
    pub const COLOUR_FOCAL_PX: f64 = 925.0;

    /// Offset of the left imager to the right of the colour camera, m.
    pub const LEFT_IMAGER_M: f64 = 0.0147;

    /// Focal length of a depth image of `width` × `height` as the camera streams it, px.
    pub fn depth_focal_px(width: usize, height: usize) -> f64 {
        let [full_width, full_height] = IMAGER_SIZE;
        IMAGER_FOCAL_PX * (width as f64 / full_width).max(height as f64 / full_height)
    }

    /// Pose of the colour camera in the gripper frame.
    pub fn t_gripper_camera() -> Pose {
        let rotation = DQuat::from_rotation_x(-PITCH_RAD);
        Pose::new(rotation, DVec3::from_array(POSITION_M))
    }

    /// Returns the number of colour pixels per pixel of the centre crop with the aspect ratio of
    /// `width` × `height`, scaled to that size.
    pub fn crop_scale(width: usize, height: usize) -> f64 {
        let [full_width, full_height] = Self::COLOUR_SIZE.map(|n| n as f64);
        (full_width / width.max(1) as f64).min(full_height / height.max(1) as f64)
    }

    /// Focal length of that image, px.
    pub fn focal_px(width: usize, height: usize) -> f64 {
        Self::COLOUR_FOCAL_PX / Self::crop_scale(width, height)
    }

    /// Position of a point of the gripper frame in that image, px; none behind the camera.
    pub fn project(point_m: DVec3, width: usize, height: usize) -> Option<[f64; 2]> {
        let p = Self::t_gripper_camera().inverse().transform_point(point_m);
        let focal = Self::focal_px(width, height);
        let principal = [width, height].map(|side| 0.5 * (side as f64 - 1.0));
        (p.z > 0.0).then(|| {
            [
                principal[0] + focal * p.x / p.z,
                principal[1] + focal * p.y / p.z,
            ]
        })
    }
}
