//! Stencils for tests, named and random, at several scales, and finite differences over them.

use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Points of a stencil.
pub(crate) type Points = [DVec3; 4];

/// Edge lengths of the tests, m: smallest mesh detail, gel element, largest object.
pub(crate) const SCALES: [f64; 3] = [1e-5, 2e-3, 1.0];

fn stencil(points: [[f64; 3]; 4], scale: f64) -> Points {
    points.map(|p| DVec3::from_array(p) * scale)
}

fn rotated(points: Points, rng: &mut Pcg64) -> Points {
    let mut angle = || rng.random_range(-3.0..3.0);
    let rotation = DQuat::from_euler(glam::EulerRot::XYZ, angle(), angle(), angle());
    points.map(|p| rotation * p)
}

/// Random stencils in a cube of edge `2 scale`.
pub(crate) fn random(count: usize, scale: f64, seed: u64) -> Vec<Points> {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut point = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-scale..scale)));
    (0..count)
        .map(|_| std::array::from_fn(|_| point()))
        .collect()
}

/// Points over interior, edges and corners of triangles, far and near, including thin triangles.
pub(crate) fn point_triangle(scale: f64) -> Vec<Points> {
    let mut rng = Pcg64::seed_from_u64(11);
    let mut cases = random(200, scale, 12);
    let shapes = [
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-0.8, 0.3, 0.0]],
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.99, 0.02, 0.0]],
    ];
    for [a, b, c] in shapes {
        let [va, vb, vc] = [a, b, c].map(DVec3::from_array);
        for (u, v) in [
            (0.2, 0.3),
            (0.5, 0.5),
            (0.0, 0.4),
            (0.4, 0.0),
            (0.0, 0.0),
            (1.0, 0.0),
            (0.0, 1.0),
        ] {
            for height in [0.5, 0.1, 1e-3] {
                for out in [0.0, 0.05] {
                    let centre = (va + vb + vc) / 3.0;
                    let foot = va + (vb - va) * u + (vc - va) * v;
                    let p = foot + (foot - centre) * out + DVec3::Z * height;
                    cases.push(rotated(stencil([p.to_array(), a, b, c], scale), &mut rng));
                }
            }
        }
    }
    cases
}

/// Edges that cross, pass each other's ends, or are nearly or exactly parallel.
pub(crate) fn edge_edge(scale: f64) -> Vec<Points> {
    let mut rng = Pcg64::seed_from_u64(21);
    let mut cases = random(200, scale, 22);
    for angle in [0.0, 1e-12, 1e-8, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0] {
        let direction = DVec3::new(f64::cos(angle), f64::sin(angle), 0.0);
        for shift in [0.0, 0.3, 1.2] {
            for height in [0.5, 0.1, 1e-3] {
                let middle = DVec3::new(0.5 + shift, 0.02, height);
                let ends = [middle - direction * 0.5, middle + direction * 0.5];
                let a = [[0.0; 3], [1.0, 0.0, 0.0]];
                let points = [a[0], a[1], ends[0].to_array(), ends[1].to_array()];
                cases.push(rotated(stencil(points, scale), &mut rng));
            }
        }
    }
    cases
}

/// The stencil with one coordinate (`3 point + axis`) moved by `step`.
pub(crate) fn moved(points: &Points, coordinate: usize, step: f64) -> Points {
    let mut moved = *points;
    moved[coordinate / 3][coordinate % 3] += step;
    moved
}

/// The 12 coordinates of four vectors.
pub(crate) fn flat(vectors: &[DVec3; 4]) -> [f64; 12] {
    std::array::from_fn(|i| vectors[i / 3][i % 3])
}

/// Central difference of `f` over the 12 coordinates.
pub(crate) fn difference(points: &Points, step: f64, f: impl Fn(&Points) -> f64) -> [f64; 12] {
    std::array::from_fn(|i| {
        (f(&moved(points, i, step)) - f(&moved(points, i, -step))) / (2.0 * step)
    })
}

/// Largest entry.
pub(crate) fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().map(f64::abs).fold(0.0, f64::max)
}

/// Asserts that `found` equals `expected` within `tolerance` of the largest entry or of `floor`.
#[track_caller]
pub(crate) fn assert_close(
    found: &[f64],
    expected: &[f64],
    floor: f64,
    tolerance: f64,
    what: &str,
) {
    let scale = largest(expected.iter().copied()).max(floor);
    let error = largest(found.iter().zip(expected).map(|(a, b)| a - b));
    assert!(
        error <= tolerance * scale,
        "{what}: {found:?} differs from {expected:?} by {:e} of {scale:e}",
        error / scale
    );
}
