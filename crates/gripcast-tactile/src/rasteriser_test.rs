//! Tests of the z-buffer against rays.

use glam::{DQuat, DVec3};
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::rays::{bumpy_ball, nearest_by_rays};
use gripcast_geometry::{MeshQuery, builtin};

const GRID: SensorGeometry = SensorGeometry {
    width: 160,
    height: 120,
    pixel_m: 2e-4,
    gel_thickness_m: 4e-3,
};
const RANGE: [f64; 2] = [-0.5, 0.5];

fn random_pose(rng: &mut impl Rng) -> Pose {
    let mut random = || 2.0 * rng.random::<f64>() - 1.0;
    let turn = DQuat::from_xyzw(random(), random(), random(), random());
    Pose::new(turn, DVec3::new(random(), random(), random()) * 5e-3)
}

/// Returns the maximum difference where both hit, and the pixels that only one hits.
fn compare(mesh: &TriangleMesh, pose: &Pose, range: [f64; 2]) -> (f32, usize, usize) {
    let mut rasteriser = Rasteriser::new();
    let ours = rasteriser.nearest(mesh, pose, &GRID, range);
    let query = MeshQuery::new(&mesh.transformed(pose));
    let rays = nearest_by_rays(&query, &GRID, range);
    let far = range[1] as f32;
    let (mut worst, mut lonely, mut seen) = (0.0f32, 0, 0);
    for (ours, rays) in ours.iter().zip(&rays) {
        if (*ours == far) == (*rays == far) {
            worst = worst.max((ours - rays).abs());
            seen += usize::from(*ours != far);
        } else {
            lonely += 1;
        }
    }
    (worst, lonely, seen)
}

#[test]
fn depth_and_silhouette_agree_with_ray_casting() {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut meshes: Vec<TriangleMesh> = ["mug", "box", "wedge", "spike"]
        .map(|name| builtin(&format!("builtin:{name}")).unwrap().scaled(0.25))
        .into();
    meshes.push(bumpy_ball(0.01, 1e-3, 120, 120));
    for mesh in &meshes {
        for _ in 0..4 {
            let (worst, lonely, seen) = compare(mesh, &random_pose(&mut rng), RANGE);
            assert!(
                worst < 1e-6 && lonely == 0 && seen > 500,
                "{worst} {lonely} {seen}"
            );
        }
    }
}

#[test]
fn thin_and_steep_triangles_agree_with_ray_casting() {
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let mut soup = TriangleMesh::default();
    for index in 0..600 {
        let mut random = || 2.0 * rng.random::<f64>() - 1.0;
        let start = DVec3::new(random(), random(), random()) * 0.012;
        let along = DVec3::new(random(), random(), random()) * 0.01;
        // From a tenth of a pixel to a hundred-thousandth wide.
        let wide = 0.1f64.powi(index % 5 + 1) * GRID.pixel_m;
        let across = DVec3::new(random(), random(), 100.0 * random()) * wide;
        let first = soup.vertices.len() as u32;
        soup.vertices.extend([start, start + along, start + across]);
        soup.triangles.push([first, first + 1, first + 2]);
    }
    let (worst, lonely, seen) = compare(&soup, &Pose::IDENTITY, RANGE);
    assert!(
        worst < 1e-6 && lonely == 0 && seen > 100,
        "{worst} {lonely} {seen}"
    );
}

#[test]
fn degenerate_triangles_are_not_drawn() {
    let p = |x: f64, y: f64, z: f64| DVec3::new(x, y, z) * 1e-3;
    let mesh = TriangleMesh {
        vertices: vec![
            p(0.1, 0.1, 0.0),
            p(0.1, 0.1, 5.0),
            p(3.1, 3.1, 0.0),
            p(1.1, 1.1, 0.0),
            p(0.1, 0.1, 0.0),
        ],
        // Upright, all corners in one line, two corners in one place, all three.
        triangles: vec![[0, 1, 2], [0, 2, 3], [0, 4, 2], [0, 0, 0]],
    };
    let mut rasteriser = Rasteriser::new();
    let seen = rasteriser.nearest(&mesh, &Pose::IDENTITY, &GRID, RANGE);
    assert!(seen.iter().all(|z| *z == 0.5));
}

/// Pixels that a mesh covers.
fn covered(mesh: &TriangleMesh) -> Vec<usize> {
    let mut rasteriser = Rasteriser::new();
    let seen = rasteriser.nearest(mesh, &Pose::IDENTITY, &GRID, RANGE);
    (0..seen.len()).filter(|i| seen[*i] != 0.5).collect()
}

#[test]
fn edges_on_pixel_centres_follow_top_left_rule() {
    let at = |column: f64, row: f64| {
        let [x, y] = GRID.pixel_to_gel_m(column, row);
        DVec3::new(x, y, 0.0)
    };
    let square = TriangleMesh {
        vertices: vec![at(2.0, 1.0), at(6.0, 1.0), at(6.0, 4.0), at(2.0, 4.0)],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    // Half a rounding error off the centres would be enough to fail.
    let exact = SensorGeometry {
        pixel_m: 0.25,
        ..GRID
    };
    let exactly = TriangleMesh {
        vertices: square
            .vertices
            .iter()
            .map(|v| (*v / GRID.pixel_m * 4.0).round() / 4.0 * exact.pixel_m)
            .collect(),
        ..square
    };
    let mut rasteriser = Rasteriser::new();
    let mut count = vec![0; GRID.width * GRID.height];
    for triangle in &exactly.triangles {
        let one = TriangleMesh {
            triangles: vec![*triangle],
            ..exactly.clone()
        };
        let seen = rasteriser.nearest(&one, &Pose::IDENTITY, &exact, RANGE);
        for (count, z) in count.iter_mut().zip(seen) {
            *count += usize::from(*z != 0.5);
        }
    }
    for (pixel, count) in count.iter().enumerate() {
        let (column, row) = (pixel % GRID.width, pixel / GRID.width);
        let inside = (2..6).contains(&column) && (1..4).contains(&row);
        assert_eq!(*count, usize::from(inside), "{column} {row}");
    }
}

#[test]
fn fan_covers_each_pixel_once() {
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let mut fan = TriangleMesh {
        vertices: vec![DVec3::new(1e-4, -2e-4, 0.0)],
        triangles: Vec::new(),
    };
    let count = 97;
    for k in 0..count {
        let angle = std::f64::consts::TAU * (f64::from(k) + 0.5 * rng.random::<f64>()) / 97.0;
        fan.vertices
            .push(DVec3::new(angle.cos(), angle.sin(), 0.0) * 0.1);
        fan.triangles
            .push([0, k as u32 + 1, (k as u32 + 1) % count as u32 + 1]);
    }
    let mut times = vec![0; GRID.width * GRID.height];
    for triangle in &fan.triangles {
        let one = TriangleMesh {
            triangles: vec![*triangle],
            ..fan.clone()
        };
        for pixel in covered(&one) {
            times[pixel] += 1;
        }
    }
    assert!(times.iter().all(|times| *times == 1));
}

#[test]
fn huge_triangle_keeps_its_depth() {
    let mesh = TriangleMesh {
        vertices: vec![
            DVec3::new(-300.0, -200.0, -30.0),
            DVec3::new(400.0, -100.0, 40.0),
            DVec3::new(10.0, 500.0, 1.0),
        ],
        triangles: vec![[0, 1, 2]],
    };
    let mut rasteriser = Rasteriser::new();
    // z = 0.1 x in this plane.
    let seen = rasteriser.nearest(&mesh, &Pose::IDENTITY, &GRID, RANGE);
    for (pixel, z) in seen.iter().enumerate() {
        let [x, _] = GRID.pixel_to_gel_m((pixel % GRID.width) as f64, 0.0);
        assert!((f64::from(*z) - 0.1 * x).abs() < 1e-8, "{pixel}: {z}");
    }
}

#[test]
fn surfaces_before_the_range_are_ignored() {
    let ball = bumpy_ball(0.01, 0.0, 40, 40);
    // Its near half lies before the plane at 0, so the inside of the far half is seen.
    let mut rasteriser = Rasteriser::new();
    let seen = rasteriser.nearest(&ball, &Pose::IDENTITY, &GRID, [0.0, 0.5]);
    let middle = seen[60 * GRID.width + 80];
    assert!((f64::from(middle) - 0.01).abs() < 1e-4, "{middle}");
    let (worst, lonely, _) = compare(&ball, &Pose::IDENTITY, [0.003, 0.5]);
    assert!(worst < 1e-6 && lonely < 3, "{worst} {lonely}");
}

#[test]
fn triangle_indices_agree_with_ray_casting() {
    let mug = builtin("builtin:mug").unwrap().scaled(0.25);
    let pose = random_pose(&mut Pcg64Mcg::seed_from_u64(4));
    let query = MeshQuery::new(&mug.transformed(&pose));
    let mut rasteriser = Rasteriser::new();
    // Buffers of an earlier frame must not be visible.
    rasteriser.nearest(&bumpy_ball(0.02, 0.0, 20, 20), &pose, &GRID, RANGE);
    let (z, triangles) = rasteriser.nearest_with_triangles(&mug, &pose, &GRID, RANGE);
    for (pixel, (z, triangle)) in z.iter().zip(triangles).enumerate() {
        let [x, y] = GRID.pixel_to_gel_m((pixel % GRID.width) as f64, (pixel / GRID.width) as f64);
        let hit = query.ray_cast(DVec3::new(x, y, -0.5), DVec3::Z, 1.0);
        assert_eq!(
            hit.map_or(NO_TRIANGLE, |hit| hit.triangle),
            *triangle,
            "{pixel} {z}"
        );
    }
}
