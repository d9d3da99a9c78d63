//! Gap between a pressed gel and the object in the simulator.
//!
//! Contact forces act at a distance: the barrier of incremental potential contact starts at `d_hat`
//! and grows without bound towards 0, so the gel is pressed by a surface at a gap g in front of the
//! object, smaller at higher pressure. A real gel touches the object. The tactile image is
//! therefore rendered with the object moved towards the gel by g. To keep the object's shape, one g
//! is used for the whole image: the mean gap between the deformed face and the object, weighted by
//! the barrier force.

use super::press_depth::SensorGeometry;
use super::rasteriser::Rasteriser;
use gripcast_geometry::{Pose, TriangleMesh};
use gripcast_sim::contact::barrier::Barrier;

/// Spacing of the samples on the face, m.
const SAMPLE_M: f64 = 1e-4;

/// Returns the mean gap (m) between a deformed face (sensor frame) and the object, weighted by the
/// force of a barrier with support `d_hat_m`; `None` without contact.
pub fn contact_gap(
    object: &TriangleMesh,
    t_sensor_object: &Pose,
    face: &TriangleMesh,
    d_hat_m: f64,
) -> Option<f64> {
    let bounds = face.bounds();
    let samples = |from: f64, to: f64| (2.0 * from.abs().max(to.abs()) / SAMPLE_M).ceil() as usize;
    let grid = SensorGeometry {
        width: samples(bounds.min.x, bounds.max.x),
        height: samples(bounds.min.y, bounds.max.y),
        pixel_m: SAMPLE_M,
        gel_thickness_m: bounds.max.z,
    };
    // Along z, the gap on a slope exceeds its distance.
    let reach = bounds.max.z + 4.0 * d_hat_m;
    let range = [f64::NEG_INFINITY, reach];
    let (mut over, mut under) = (Rasteriser::new(), Rasteriser::new());
    let object_z = over.nearest(object, t_sensor_object, &grid, range);
    let (face_z, triangles) = under.nearest_with_triangles(face, &Pose::IDENTITY, &grid, range);
    let steepness: Vec<f64> = face
        .all_corners()
        .map(|[a, b, c]| (b - a).cross(c - a).normalize_or_zero().z)
        .collect();
    let barrier = Barrier {
        kappa: 1.0,
        d_hat: d_hat_m,
    };
    let (mut force, mut moment) = (0.0, 0.0);
    for ((object_z, face_z), triangle) in object_z.iter().zip(face_z).zip(triangles) {
        let Some(steepness) = steepness.get(*triangle as usize) else {
            continue;
        };
        let gap = f64::from(object_z - face_z) * steepness;
        if gap > 0.0 && gap < d_hat_m {
            let squared = gap * gap;
            let weight = -barrier.squared(squared).to_linear(squared).first;
            force += weight;
            moment += weight * gap;
        }
    }
    (force > 0.0).then(|| moment / force)
}

#[cfg(test)]
#[path = "contact_gap_test.rs"]
mod tests;
