//! Pinhole camera.

use glam::{DVec3, Vec3};

use gripcast_base::error::{Error, Result};
use gripcast_geometry::Pose;

/// Ray of light: `origin + t * direction`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    pub(super) origin: Vec3,
    pub(super) direction: Vec3,
}

/// Pinhole camera without distortion. Optical frame: x to the right, y down, z forward; pixel
/// (0, 0) is the centre of the top-left pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal length along x and y, px.
    pub focal_px: [f64; 2],
    /// Where the optical axis meets the image: column, row.
    pub principal_px: [f64; 2],
    /// Maps the optical frame into the world.
    pub t_world_camera: Pose,
}

impl Camera {
    /// Camera with square pixels, its axis through the middle of the image and the field of view
    /// `fov_x_rad` across the width.
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

    /// Pose of a camera at `eye` whose axis goes through `target`, upright with respect to the
    /// world's z; m. `None` if the two are the same point or above one another.
    pub fn look_at(eye: DVec3, target: DVec3) -> Option<Pose> {
        let forward = (target - eye).try_normalize()?;
        let right = forward.cross(DVec3::Z).try_normalize()?;
        let axes = glam::DMat3::from_cols(right, forward.cross(right), forward);
        Some(Pose::new(glam::DQuat::from_mat3(&axes), eye))
    }

    /// World position of the pinhole, m, and unit direction of what a place in the image sees;
    /// whole numbers are the centres of pixels.
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

    /// Column, row and depth along the optical axis (m) of a world point; `None` if it is not in
    /// front of the camera.
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

    pub(super) fn validate(&self) -> Result<()> {
        let bad = |what: String| Err(Error::input(what));
        let (width, height) = (self.width, self.height);
        // More rows or columns would not fit the seeds of the pixels.
        if !(1..=1 << 15).contains(&width) || !(1..=1 << 15).contains(&height) {
            return bad(format!(
                "the image must have 1 to 32768 columns and rows, found {width}×{height}"
            ));
        }
        if !self.focal_px.iter().all(|f| f.is_finite() && *f > 0.0) {
            let found = self.focal_px;
            return bad(format!(
                "the focal lengths must be positive, found {found:?}"
            ));
        }
        if !self.principal_px.iter().all(|c| c.is_finite()) {
            let found = self.principal_px;
            return bad(format!(
                "the principal point must be finite, found {found:?}"
            ));
        }
        if !self.t_world_camera.translation_m.is_finite() {
            let found = self.t_world_camera.translation_m;
            return bad(format!(
                "the camera must be at a finite place, found {found}"
            ));
        }
        Ok(())
    }
}
