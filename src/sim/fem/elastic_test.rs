use super::*;
use crate::sim::fem::{GelGrid, GelResolution};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// A gel of 4 x 3 x 2 cells of unequal sizes; 120 tetrahedra.
fn small() -> (Vec<DVec3>, Elastic) {
    let mm = |v: &[f64]| v.iter().map(|x| x * 1e-3).collect::<Vec<_>>();
    let grid = GelGrid::new([
        mm(&[-4.0, -1.5, 0.0, 2.0, 4.0]),
        mm(&[-2.0, -0.5, 1.0, 2.0]),
        mm(&[0.0, 1.5, 2.0]),
    ])
    .unwrap();
    let law = NeoHookean::new(1e6, 0.3).unwrap();
    let elastic = Elastic::new(grid.positions(), grid.tets(), law).unwrap();
    (grid.positions().to_vec(), elastic)
}

fn noise(rng: &mut Pcg64, size: f64) -> DVec3 {
    DVec3::from_array([(); 3].map(|()| rng.random_range(-size..size)))
}

/// Named states: rest, pure rotation, equal stretch, strong compression, random.
fn states(rest: &[DVec3]) -> Vec<(&'static str, Vec<DVec3>)> {
    let mut rng = Pcg64::seed_from_u64(7);
    let turn = DMat3::from_quat(glam::DQuat::from_scaled_axis(DVec3::new(0.4, -1.1, 0.7)));
    let affine = |m: DMat3| rest.iter().map(|x| m * *x).collect::<Vec<_>>();
    let squash = DMat3::from_diagonal(DVec3::new(1.1, 1.0, 0.3));
    let mut jitter = |x: &[DVec3], size| {
        x.iter()
            .map(|p| *p + noise(&mut rng, size))
            .collect::<Vec<_>>()
    };
    vec![
        ("rest", rest.to_vec()),
        ("turned", affine(turn)),
        ("swollen", affine(DMat3::from_diagonal(DVec3::splat(1.4)))),
        (
            "blown up",
            affine(DMat3::from_diagonal(DVec3::new(2.5, 2.0, 1.5))),
        ),
        ("squashed", affine(turn * squash)),
        ("jittered", jitter(rest, 1e-4)),
        (
            "squashed and jittered",
            jitter(&affine(turn * squash), 5e-5),
        ),
    ]
}

fn dense(elastic: &Elastic, x: &[DVec3], projection: Projection) -> Vec<Vec<f64>> {
    let pattern = elastic.pattern();
    let mut values = pattern.zeros();
    elastic.hessian(x, projection, &mut values);
    let n = pattern.dimension();
    let mut h = vec![vec![0.0; n]; n];
    for c in 0..n {
        for k in pattern.column_starts()[c]..pattern.column_starts()[c + 1] {
            let r = pattern.rows()[k];
            h[r][c] = values[k];
            h[c][r] = values[k];
        }
    }
    h
}

fn gradient(elastic: &Elastic, x: &[DVec3]) -> Vec<f64> {
    let mut g = vec![DVec3::ZERO; x.len()];
    elastic.gradient(x, &mut g);
    g.iter().flat_map(|v| v.to_array()).collect()
}

fn moved(x: &[DVec3], dof: usize, by: f64) -> Vec<DVec3> {
    let mut x = x.to_vec();
    x[dof / 3][dof % 3] += by;
    x
}

#[test]
fn gradient_is_the_slope_of_the_energy() {
    let (rest, elastic) = small();
    for (name, x) in states(&rest) {
        let g = gradient(&elastic, &x);
        let scale = g.iter().fold(1e-3, |m: f64, v| m.max(v.abs()));
        let step = 1e-8;
        for dof in 0..g.len() {
            let slope = (elastic.energy(&moved(&x, dof, step))
                - elastic.energy(&moved(&x, dof, -step)))
                / (2.0 * step);
            assert!(
                (slope - g[dof]).abs() < 1e-6 * scale,
                "{name} {dof}: {slope} {}",
                g[dof]
            );
        }
    }
}

#[test]
fn hessian_is_the_slope_of_the_gradient() {
    let (rest, elastic) = small();
    for (name, x) in states(&rest) {
        let h = dense(&elastic, &x, Projection::None);
        let scale = h.iter().flatten().fold(0.0, |m: f64, v| m.max(v.abs()));
        let step = 1e-8;
        for dof in 0..h.len() {
            let (up, down) = (moved(&x, dof, step), moved(&x, dof, -step));
            let (up, down) = (gradient(&elastic, &up), gradient(&elastic, &down));
            for row in 0..h.len() {
                let slope = (up[row] - down[row]) / (2.0 * step);
                assert!(
                    (slope - h[row][dof]).abs() < 1e-6 * scale,
                    "{name} {row} {dof}"
                );
            }
        }
    }
}

#[test]
fn the_same_numbers_as_element_by_element() {
    let (rest, elastic) = small();
    let tets = GelGrid::pad(GelResolution::Coarse).unwrap();
    assert_eq!(tets.tets().len(), 1200);
    for (name, x) in states(&rest) {
        let e = elastic.energy(&x);
        let mut g = vec![DVec3::ZERO; x.len()];
        let both = elastic.energy_gradient(&x, &mut g);
        assert_eq!(e.to_bits(), both.to_bits(), "{name}");
        let alone = gradient(&elastic, &x);
        assert!(g.iter().flat_map(|v| v.to_array()).eq(alone), "{name}");
    }
}
