//! Tactile depth as in the paper (§3.2): parallel rays from the sensor's image plane onto the
//! object, not onto the gel, clipped to the gel thickness.

use super::press_depth::{PressDepth, SensorGeometry};
use super::rasteriser::Rasteriser;
use super::scene::TactileScene;

/// z of the image plane, m: behind the gel, inside the sensor's housing. Surfaces behind it, such
/// as the far wall of a mug around the finger, are ignored.
pub(super) const IMAGE_PLANE_M: f64 = -0.01;

/// Renders the depth of the object in the gel per pixel, from 0 to the gel thickness.
pub fn object_depth(
    scene: &TactileScene<'_>,
    grid: &SensorGeometry,
    rasteriser: &mut Rasteriser,
) -> PressDepth {
    let touch = scene.face_m + scene.gap_m;
    let range = [IMAGE_PLANE_M, touch];
    let nearest = rasteriser.nearest(scene.object, &scene.t_sensor_object, grid, range);
    depth_below(nearest, touch, grid)
}

/// Renders the depth of the deformed gel face per pixel, from 0 to the gel thickness; `None` if the
/// scene has no deformed face.
///
/// The face also sinks around the object and its triangles are flat, so the deformed area is larger
/// than the contact and faceted.
pub fn gel_surface_depth(
    scene: &TactileScene<'_>,
    grid: &SensorGeometry,
    rasteriser: &mut Rasteriser,
) -> Option<PressDepth> {
    let face = scene.gel_face.as_ref()?;
    let range = [IMAGE_PLANE_M, scene.face_m];
    let nearest = rasteriser.nearest(face, &gripcast_geometry::Pose::IDENTITY, grid, range);
    Some(depth_below(nearest, scene.face_m, grid))
}

/// Converts surface heights to depths below a plane.
pub(super) fn depth_below(z_m: &[f32], plane_m: f64, grid: &SensorGeometry) -> PressDepth {
    let (plane, thickness) = (plane_m as f32, grid.gel_thickness_m as f32);
    PressDepth {
        geometry: *grid,
        depth_m: z_m
            .iter()
            .map(|z| (plane - z).max(0.0).min(thickness))
            .collect(),
    }
}

#[cfg(test)]
#[path = "depth_test.rs"]
mod tests;
