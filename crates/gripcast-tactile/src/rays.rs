//! Ray-cast depth: slow reference for the z-buffer.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::depth::{IMAGE_PLANE_M, depth_below};
use crate::{PressDepth, SensorGeometry, TactileScene};
use gripcast_geometry::{MeshQuery, TriangleMesh};

/// [`crate::object_depth`] by ray casting; the mesh of `query` is in the sensor frame.
pub fn depth_by_rays(
    scene: &TactileScene<'_>,
    query: &MeshQuery,
    grid: &SensorGeometry,
) -> PressDepth {
    let touch = scene.face_m + scene.gap_m;
    let nearest = nearest_by_rays(query, grid, [IMAGE_PLANE_M, touch]);
    depth_below(&nearest, touch, grid)
}

/// [`crate::Rasteriser::nearest`] by ray casting; the mesh of `query` is in the sensor frame.
pub fn nearest_by_rays(
    query: &MeshQuery,
    grid: &SensorGeometry,
    [near, far]: [f64; 2],
) -> Vec<f32> {
    (0..grid.width * grid.height)
        .map(|pixel| {
            let (column, row) = (pixel % grid.width, pixel / grid.width);
            let [x, y] = grid.pixel_to_gel_m(column as f64, row as f64);
            let hit = query.ray_cast(DVec3::new(x, y, near), DVec3::Z, far - near);
            hit.map_or(far, |hit| near + hit.t) as f32
        })
        .collect()
}

/// Closed ball with bumps of height `bump`, m, with `rings` rings from pole to pole.
pub fn bumpy_ball(radius: f64, bump: f64, rings: u32, segments: u32) -> TriangleMesh {
    let at = |ring: u32, segment: u32| {
        let polar = PI * f64::from(ring) / f64::from(rings);
        let around = TAU * f64::from(segment) / f64::from(segments);
        let (sin, cos) = polar.sin_cos();
        let direction = DVec3::new(sin * around.cos(), sin * around.sin(), cos);
        let wave = (16.0 * around).sin() * (16.0 * polar).sin() * sin * sin;
        direction * (radius + bump * wave)
    };
    let mut mesh = TriangleMesh::default();
    mesh.vertices.push(at(0, 0));
    for ring in 1..rings {
        mesh.vertices
            .extend((0..segments).map(|segment| at(ring, segment)));
    }
    mesh.vertices.push(at(rings, 0));
    let last = mesh.vertices.len() as u32 - 1;
    let node = |ring: u32, segment: u32| 1 + (ring - 1) * segments + segment % segments;
    for segment in 0..segments {
        mesh.triangles
            .push([0, node(1, segment), node(1, segment + 1)]);
        for ring in 1..rings - 1 {
            let [a, b] = [node(ring, segment), node(ring, segment + 1)];
            let [c, d] = [node(ring + 1, segment + 1), node(ring + 1, segment)];
            mesh.triangles.extend([[a, d, c], [a, c, b]]);
        }
        let [a, b] = [node(rings - 1, segment), node(rings - 1, segment + 1)];
        mesh.triangles.push([a, last, b]);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::MassProperties;

    #[test]
    fn ball_is_closed_and_has_expected_volume() {
        let ball = bumpy_ball(0.01, 0.0, 60, 60);
        assert!(ball.edges().is_closed());
        let volume = MassProperties::from_mesh(&ball).unwrap().volume_m3;
        let sphere = 4.0 / 3.0 * PI * 1e-6;
        assert!((volume / sphere - 1.0).abs() < 0.01, "{volume}");
    }
}
