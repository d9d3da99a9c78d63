//! Indentation depth of an unsimulated press from its force.

use super::press_depth::SensorGeometry;
use super::rasteriser::Rasteriser;
use gripcast_geometry::{Pose, TriangleMesh};

/// Bisection steps for the depth: finer than a nanometre.
const BISECTION_STEPS: u32 = 24;

/// Stiffness (Pa/m) of a thin gel on a rigid backing: an elastic foundation of laterally
/// constrained material, E (1 − ν) / ((1 + ν)(1 − 2ν)) over its thickness (Johnson, *Contact
/// Mechanics*, §4.3).
pub fn foundation_pa_m(young_pa: f64, poisson: f64, thickness_m: f64) -> f64 {
    let constrained = young_pa * (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson));
    constrained / thickness_m
}

/// Returns the maximum depth (m) at which a foundation of `stiffness_pa_m` carries `force_n`, at
/// most the gel thickness; `None` if the object is not over the image. The z of `t_sensor_object`
/// is ignored.
pub fn depth_under_force(
    object: &TriangleMesh,
    t_sensor_object: &Pose,
    force_n: f64,
    stiffness_pa_m: f64,
    grid: &SensorGeometry,
) -> Option<f64> {
    let everywhere = [f64::NEG_INFINITY, f64::INFINITY];
    let mut rasteriser = Rasteriser::new();
    let nearest = rasteriser.nearest(object, t_sensor_object, grid, everywhere);
    let lowest = nearest.iter().copied().fold(f32::INFINITY, f32::min);
    if !lowest.is_finite() {
        return None;
    }
    let heights: Vec<f64> = nearest
        .iter()
        .map(|z| f64::from(z - lowest))
        .filter(|height| *height < grid.gel_thickness_m)
        .collect();
    let pixel_m2 = grid.pixel_m * grid.pixel_m;
    let carried = |depth: f64| {
        let sunk: f64 = heights.iter().map(|height| (depth - height).max(0.0)).sum();
        stiffness_pa_m * pixel_m2 * sunk
    };
    let (mut min_m, mut max_m) = (0.0, grid.gel_thickness_m);
    for _ in 0..BISECTION_STEPS {
        let middle = 0.5 * (min_m + max_m);
        if carried(middle) < force_n {
            min_m = middle;
        } else {
            max_m = middle;
        }
    }
    Some(max_m)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::SensorProfile;
    use gripcast_geometry::builtin;

    fn grid() -> SensorGeometry {
        SensorProfile::gelsight_mini().unwrap().geometry
    }

    #[test]
    fn flat_face_depth_is_pressure_over_stiffness() {
        let bar = builtin("box").unwrap();
        let k = foundation_pa_m(1e6, 0.3, 0.004);
        let grid = grid();
        let depth = depth_under_force(&bar, &Pose::IDENTITY, 20.0, k, &grid).unwrap();
        // The box covers the whole image.
        let area = grid.pixel_m.powi(2) * (grid.width * grid.height) as f64;
        let expected = 20.0 / (k * area);
        assert!((depth / expected - 1.0).abs() < 1e-3, "{depth} {expected}");
    }

    #[test]
    fn ball_depth_grows_with_root_of_force() {
        // F = k π R δ² for a ball on an elastic foundation.
        let ball = builtin("ball").unwrap();
        let k = foundation_pa_m(1e6, 0.3, 0.004);
        let depth = |force| depth_under_force(&ball, &Pose::IDENTITY, force, k, &grid()).unwrap();
        let expected = |force: f64| (force / (k * std::f64::consts::PI * 0.025)).sqrt();
        for force in [2.0, 8.0] {
            assert!(
                (depth(force) / expected(force) - 1.0).abs() < 0.04,
                "{force}"
            );
        }
        let soft = depth_under_force(&ball, &Pose::IDENTITY, 1e6, k, &grid()).unwrap();
        assert!(soft <= grid().gel_thickness_m);
    }

    #[test]
    fn object_beside_the_sensor_has_no_depth() {
        let ball = builtin("ball").unwrap();
        let aside = Pose::from_translation(DVec3::X * 0.5);
        assert_eq!(depth_under_force(&ball, &aside, 5.0, 1e8, &grid()), None);
    }
}
