//! Pinhole camera.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::material::ensure;
use gripcast_base::error::Result;
use gripcast_geometry::Pose;

/// Ray `origin + t * direction`, world frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    pub(super) origin: Vec3,
    pub(super) direction: Vec3,
}

/// Pinhole camera without distortion. Optical frame: x to the right, y down, z forward; pixel
/// (0, 0) is the centre of the top-left pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Width of the image, px.
    pub width: usize,
    /// Height of the image, px.
    pub height: usize,
    /// Focal length along x and y, px.
    pub focal_px: [f64; 2],
    /// Principal point: column, row, px.
    pub principal_px: [f64; 2],
    /// Pose of the optical frame in the world.
    pub t_world_camera: Pose,
}

impl Camera {
    /// Camera with square pixels and its principal point at the image centre; `fov_x_rad` is the
    /// horizontal field of view.
    pub fn centred(width: usize, height: usize, fov_x_rad: f64, t_world_camera: Pose) -> Self {
        let focal = 0.5 * width as f64 / (0.5 * fov_x_rad).tan();
        Self {
            width,
            height,
            focal_px: [focal; 2],
            principal_px: [0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0)],
            t_world_camera,
        }
    }

    /// Returns the pose of a camera at `eye` (m) that points at `target` with the world's z axis
    /// up; `None` if the two coincide or one is straight above the other.
    pub fn look_at(eye: DVec3, target: DVec3) -> Option<Pose> {
        let forward = (target - eye).try_normalize()?;
        let right = forward.cross(DVec3::Z).try_normalize()?;
        let axes = glam::DMat3::from_cols(right, forward.cross(right), forward);
        Some(Pose::new(glam::DQuat::from_mat3(&axes), eye))
    }

    /// Returns the origin (m) and unit direction, world frame, of the ray through an image
    /// position; integers are pixel centres.
    pub fn ray(&self, column: f64, row: f64) -> [DVec3; 2] {
        let direction = DVec3::new(
            (column - self.principal_px[0]) / self.focal_px[0],
            (row - self.principal_px[1]) / self.focal_px[1],
            1.0,
        );
        let pose = &self.t_world_camera;
        let world = pose.transform_vector(direction).normalize();
        [pose.translation_m, world]
    }

    /// Projects a world point (m) to column, row (px) and depth along the optical axis (m); `None`
    /// if the point is not in front of the camera.
    pub fn project(&self, point: DVec3) -> Option<[f64; 3]> {
        let p = self.t_world_camera.inverse().transform_point(point);
        (p.z > 0.0).then(|| {
            [
                self.focal_px[0] * p.x / p.z + self.principal_px[0],
                self.focal_px[1] * p.y / p.z + self.principal_px[1],
                p.z,
            ]
        })
    }

    /// The camera of a part of the image: its columns and rows.
    #[must_use]
    pub fn cropped(&self, columns: Range<usize>, rows: Range<usize>) -> Self {
        let [column, row] = self.principal_px;
        Self {
            width: columns.len(),
            height: rows.len(),
            principal_px: [column - columns.start as f64, row - rows.start as f64],
            ..*self
        }
    }

    pub(super) fn validate(&self) -> Result<()> {
        let (width, height) = (self.width, self.height);
        // Columns and rows must fit the pixel seeds.
        let fits = |side| (1..=1 << 15).contains(&side);
        ensure(fits(width) && fits(height), || {
            format!("the image must have 1 to 32768 columns and rows, found {width}×{height}")
        })?;
        let focal = self.focal_px;
        ensure(focal.iter().all(|f| f.is_finite() && *f > 0.0), || {
            format!("the focal lengths must be positive, found {focal:?}")
        })?;
        let principal = self.principal_px;
        ensure(principal.iter().all(|c| c.is_finite()), || {
            format!("the principal point must be finite, found {principal:?}")
        })?;
        let eye = self.t_world_camera.translation_m;
        ensure(eye.is_finite(), || {
            format!("the camera position must be finite, found {eye}")
        })
    }
}
