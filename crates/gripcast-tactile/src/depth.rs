//! Tactile depth of the paper (§3.2): parallel rays from the sensor's image plane onto the object
//! itself, not onto the gel, clipped at the thickness of the gel.

use super::press_depth::{PressDepth, SensorGeometry};
use super::rasteriser::Rasteriser;
use super::scene::TactileScene;

/// z of the image plane, m: behind the gel's back, inside the sensor's housing, where no object
/// can be. What lies behind it, as the far wall of a mug around the finger, is not seen.
pub(super) const IMAGE_PLANE_M: f64 = -0.01;

/// Depth of the object in the gel under each pixel, from 0 to the gel's thickness.
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

/// Depth of the deformed gel's own face under each pixel, from 0 to the gel's thickness; none
/// where the scene has no deformed face.
///
/// Away from the object the face sinks as well, and each triangle of its mesh is flat: the
/// deformed area is larger than the contact, and checkered.
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

/// Depths of surface heights below a plane.
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
