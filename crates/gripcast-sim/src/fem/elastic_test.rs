#![allow(
    clippy::needless_range_loop,
    reason = "rows and columns of several matrices at once"
)]

use super::*;
use crate::fem::{GelGrid, GelPad, GelResolution};
use glam::DMat3;
use gripcast_base::error::ErrorKind;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// A gel of 4 x 3 x 2 cells of unequal sizes; 120 tetrahedra.
fn small_grid() -> GelGrid {
    let mm = |v: &[f64]| v.iter().map(|x| x * 1e-3).collect::<Vec<_>>();
    GelGrid::new([
        mm(&[-4.0, -1.5, 0.0, 2.0, 4.0]),
        mm(&[-2.0, -0.5, 1.0, 2.0]),
        mm(&[0.0, 1.5, 2.0]),
    ])
    .unwrap()
}

fn small() -> (Vec<DVec3>, Elastic) {
    let grid = small_grid();
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
    let rotation = DMat3::from_quat(glam::DQuat::from_scaled_axis(DVec3::new(0.4, -1.1, 0.7)));
    let affine = |m: DMat3| rest.iter().map(|x| m * *x).collect::<Vec<_>>();
    let squash = DMat3::from_diagonal(DVec3::new(1.1, 1.0, 0.3));
    let mut jitter = |x: &[DVec3], size| {
        x.iter()
            .map(|p| *p + noise(&mut rng, size))
            .collect::<Vec<_>>()
    };
    vec![
        ("rest", rest.to_vec()),
        ("rotated", affine(rotation)),
        ("swollen", affine(DMat3::from_diagonal(DVec3::splat(1.4)))),
        (
            "blown up",
            affine(DMat3::from_diagonal(DVec3::new(2.5, 2.0, 1.5))),
        ),
        ("squashed", affine(rotation * squash)),
        ("jittered", jitter(rest, 1e-4)),
        (
            "squashed and jittered",
            jitter(&affine(rotation * squash), 5e-5),
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

/// Energy, gradient and Hessian from the law's own 3x3 and 9x9 functions.
fn by_hand(x: &[DVec3], projection: Projection) -> (f64, Vec<f64>, Vec<Vec<f64>>) {
    let grid = small_grid();
    let law = NeoHookean::new(1e6, 0.3).unwrap();
    let n = 3 * x.len();
    let (mut energy, mut g, mut h) = (0.0, vec![0.0; n], vec![vec![0.0; n]; n]);
    for tet in grid.tets() {
        let edges = |x: &[DVec3]| {
            let [a, b, c, d] = tet.map(|v| x[v as usize]);
            DMat3::from_cols(b - a, c - a, d - a)
        };
        let rest = edges(grid.positions());
        let volume = rest.determinant() / 6.0;
        let gradients = rest.inverse().transpose();
        let [b, c, d] = [0, 1, 2].map(|i| gradients.col(i));
        let shape = [-(b + c + d), b, c, d];
        let f = edges(x) * rest.inverse();
        let (stress, tangent) = (law.pk1(&f), law.projected_hessian(&f, projection));
        energy += volume * law.energy(&f);
        for (p, sp) in tet.iter().zip(shape) {
            let force = stress * sp * volume;
            for r in 0..3 {
                g[3 * *p as usize + r] += force[r];
            }
            for (q, sq) in tet.iter().zip(shape) {
                for (i, j, r, c) in all_indices() {
                    h[3 * *p as usize + r][3 * *q as usize + c] +=
                        volume * sp[i] * tangent[3 * i + r][3 * j + c] * sq[j];
                }
            }
        }
    }
    (energy, g, h)
}

fn all_indices() -> impl Iterator<Item = (usize, usize, usize, usize)> {
    (0..81).map(|k| (k / 27, k / 9 % 3, k / 3 % 3, k % 3))
}

#[test]
fn sums_match_element_by_element() {
    let (rest, elastic) = small();
    for (name, x) in states(&rest) {
        let energy = elastic.energy(&x);
        let found = gradient(&elastic, &x);
        for projection in [Projection::None, Projection::Clamp, Projection::Abs] {
            let (e, g, h) = by_hand(&x, projection);
            assert!(
                (energy - e).abs() < 1e-12 * (e.abs() + 1e-3),
                "{name}: {energy} {e}"
            );
            close(&found, &g, 1e-12, name);
            let found = dense(&elastic, &x, projection);
            close(
                &found.concat(),
                &h.concat(),
                1e-10,
                &format!("{name} {projection:?}"),
            );
        }
    }
}

fn close(found: &[f64], expected: &[f64], tolerance: f64, name: &str) {
    let scale = expected.iter().fold(0.1, |m: f64, v| m.max(v.abs()));
    for (k, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() < tolerance * scale, "{name} {k}: {a} {b}");
    }
}

#[test]
fn rest_and_rotation_have_no_force() {
    let (rest, elastic) = small();
    for (name, x) in &states(&rest)[..2] {
        let forces = gradient(&elastic, x);
        assert!(forces.iter().all(|f| f.abs() < 1e-11), "{name}");
        assert!(elastic.energy(x).abs() < 1e-16, "{name}");
    }
}

#[test]
fn inner_forces_balance() {
    let (rest, elastic) = small();
    for (name, x) in states(&rest) {
        let mut g = vec![DVec3::ZERO; x.len()];
        elastic.gradient(&x, &mut g);
        let size: f64 = g.iter().map(|f| f.length()).sum::<f64>() + 1e-3;
        let force: DVec3 = g.iter().sum();
        let torque: DVec3 = g.iter().zip(&x).map(|(f, x)| x.cross(*f)).sum();
        assert!(force.length() < 1e-12 * size, "{name}: {force}");
        assert!(torque.length() < 1e-12 * size * 0.1, "{name}: {torque}");
    }
}

#[test]
fn affine_motion_has_uniform_stress() {
    let grid = GelPad::default().grid(GelResolution::Coarse).unwrap();
    let law = NeoHookean::new(1e6, 0.3).unwrap();
    let elastic = Elastic::new(grid.positions(), grid.tets(), law).unwrap();
    let f = DMat3::from_cols(
        DVec3::new(1.05, 0.02, 0.0),
        DVec3::new(-0.1, 0.98, 0.03),
        DVec3::new(0.2, 0.1, 0.8),
    );
    let x: Vec<DVec3> = grid.positions().iter().map(|p| f * *p).collect();
    let volume = 0.025 * 0.020 * 0.004;
    assert!((elastic.energy(&x) / (volume * law.energy(&f)) - 1.0).abs() < 1e-12);
    let mut g = vec![DVec3::ZERO; x.len()];
    elastic.gradient(&x, &mut g);
    // The virtual work of any other affine motion is that of the stress; inner nodes are free.
    let moment = g
        .iter()
        .zip(grid.positions())
        .fold(DMat3::ZERO, |sum, (f, p)| {
            sum + DMat3::from_cols(*f * p.x, *f * p.y, *f * p.z)
        });
    assert!((moment * (1.0 / volume)).abs_diff_eq(law.pk1(&f), 1e-6));
    let [nx, ny, _] = grid.nodes();
    for j in 1..ny - 1 {
        for i in 1..nx - 1 {
            assert!(g[grid.node(i, j, 1)].length() < 1e-12);
        }
    }
}

#[test]
fn projected_hessian_is_positive_semidefinite() {
    let (rest, elastic) = small();
    for (name, x) in states(&rest) {
        for projection in [Projection::Clamp, Projection::Abs] {
            let h = dense(&elastic, &x, projection);
            let scale = h.iter().flatten().fold(0.0, |m: f64, v| m.max(v.abs()));
            assert!(factors(&h, 1e-9 * scale), "{name} {projection:?}");
        }
    }
    let squashed = &states(&rest)[5].1;
    let h = dense(&elastic, squashed, Projection::None);
    assert!(!factors(&h, 1e-9), "no state tests the projection");
}

/// Whether h + shift I has a Cholesky factor.
fn factors(h: &[Vec<f64>], shift: f64) -> bool {
    let n = h.len();
    let mut l = vec![vec![0.0; n]; n];
    for j in 0..n {
        for i in j..n {
            let done: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
            let rest = h[i][j] - done + if i == j { shift } else { 0.0 };
            if i > j {
                l[i][j] = rest / l[j][j];
            } else if rest > 0.0 {
                l[j][j] = f64::sqrt(rest);
            } else {
                return false;
            }
        }
    }
    true
}

#[test]
fn degenerate_states_have_infinite_energy() {
    let (rest, elastic) = small();
    let mut flat = rest.clone();
    flat.iter_mut().for_each(|x| x.z = 0.0);
    let mut inside_out = rest.clone();
    inside_out[0] = DVec3::new(1.0, 1.0, 1.0);
    let mut nan = rest.clone();
    nan[59].y = f64::NAN;
    for x in [flat, inside_out, nan] {
        assert_eq!(elastic.energy(&x), f64::INFINITY);
    }
}

/// Smallest volume of an element over its volume at `start`.
fn smallest_ratio(start: &[DVec3], x: &[DVec3]) -> f64 {
    let grid = small_grid();
    let volume = |x: &[DVec3], tet: &[u32; 4]| {
        let [a, b, c, d] = tet.map(|v| x[v as usize]);
        (b - a).cross(c - a).dot(d - a)
    };
    let ratios = grid.tets().iter().map(|t| volume(x, t) / volume(start, t));
    ratios.fold(f64::INFINITY, f64::min)
}

#[test]
fn steps_stop_before_inversion() {
    let (rest, elastic) = small();
    let mut rng = Pcg64::seed_from_u64(9);
    let mut cut = 0;
    for (name, x) in states(&rest) {
        for size in [1e-6, 1e-4, 1e-3, 1e-1] {
            let dx: Vec<DVec3> = x.iter().map(|_| noise(&mut rng, size)).collect();
            let step = elastic.inversion_free_step(&x, &dx);
            assert!(step > 0.0 && step <= 1.0, "{name} {size}: {step}");
            let at = |a: f64| {
                x.iter()
                    .zip(&dx)
                    .map(|(x, d)| *x + a * *d)
                    .collect::<Vec<_>>()
            };
            for k in 1..=20 {
                let part = at(step * f64::from(k) / 20.0);
                assert!(elastic.energy(&part).is_finite(), "{name} {size} {k}");
            }
            if step < 1.0 {
                cut += 1;
                // A little further some element has lost nine tenths of its volume.
                let ratio = smallest_ratio(&x, &at(1.001 * step));
                assert!(ratio < 0.101, "{name} {size}: {ratio}");
            }
        }
    }
    assert!(cut > 10);
    let squash: Vec<DVec3> = rest.iter().map(|x| DVec3::new(0.0, 0.0, -x.z)).collect();
    let step = elastic.inversion_free_step(&rest, &squash);
    assert!(step <= 0.9 && step > 0.9 * (1.0 - 2e-6), "{step}");
}

#[test]
fn steps_along_nan_are_zero() {
    let (rest, elastic) = small();
    let mut dx = vec![DVec3::ZERO; rest.len()];
    assert_eq!(elastic.inversion_free_step(&rest, &dx), 1.0);
    dx[7].x = f64::NAN;
    assert_eq!(elastic.inversion_free_step(&rest, &dx), 0.0);
}

#[test]
fn invalid_meshes_are_rejected() {
    let law = NeoHookean::new(1e6, 0.3).unwrap();
    let x = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    assert!(Elastic::new(&x, &[[0, 1, 2, 3]], law).is_ok());
    for tets in [
        vec![],
        vec![[0, 1, 2, 4]],
        vec![[0, 2, 1, 3]],
        vec![[0, 1, 2, 2]],
    ] {
        let error = Elastic::new(&x, &tets, law).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{tets:?}");
    }
}
