#![allow(
    clippy::needless_range_loop,
    reason = "rows and columns of several matrices at once"
)]

use super::super::svd::svd;
use super::*;
use gripcast_base::error::ErrorKind;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn law() -> NeoHookean {
    NeoHookean::new(1e6, 0.3).unwrap()
}

/// Random and degenerate deformation gradients with J > 0.
fn cases() -> Vec<(String, DMat3)> {
    let rotation = DMat3::from_rotation_z(0.7) * DMat3::from_rotation_x(-0.4);
    let stretched = |x, y, z| rotation * DMat3::from_diagonal(DVec3::new(x, y, z)) * rotation;
    let mut all: Vec<(String, DMat3)> = [
        ("rest", DMat3::IDENTITY),
        ("rotated", rotation),
        ("equal stretch", stretched(1.3, 1.3, 1.3)),
        ("equal compression", stretched(0.6, 0.6, 0.6)),
        ("two equal", stretched(1.2, 1.2, 0.5)),
        ("nearly equal", stretched(0.8, 0.8 + 1e-9, 0.8 - 1e-9)),
        ("compressed to 0.3", stretched(1.0, 1.0, 0.3)),
        ("J = 1e-3", stretched(1.0, 1.0, 1e-3)),
        ("J = 1e-3, two equal", stretched(0.1, 0.1, 0.1)),
        ("volume doubled", stretched(2.0, 1.0, 1.0)),
        ("drawn out", stretched(0.5, 0.5, 20.0)),
        ("drawn out far", stretched(0.5, 0.6, 60.0)),
        ("blown up", stretched(3.0, 2.5, 2.0)),
        (
            "shear",
            DMat3::from_cols(DVec3::X, DVec3::new(1.5, 1.0, 0.0), DVec3::Z),
        ),
    ]
    .map(|(name, f)| (name.to_owned(), f))
    .into();
    let mut rng = Pcg64::seed_from_u64(11);
    while all.len() < 60 {
        let noise: [f64; 9] = std::array::from_fn(|_| rng.random_range(-0.6..0.6));
        let f = DMat3::IDENTITY + DMat3::from_cols_array(&noise);
        if f.determinant() > 0.02 {
            all.push((format!("random {}", all.len()), f));
        }
    }
    all
}

/// Step of a difference that stays well inside J > 0.
fn step(f: &DMat3) -> f64 {
    2e-6 * svd(f).sigma.min_element()
}

fn moved(f: &DMat3, entry: usize, by: f64) -> DMat3 {
    let mut array = f.to_cols_array();
    array[entry] += by;
    DMat3::from_cols_array(&array)
}

fn largest(entries: impl IntoIterator<Item = f64>) -> f64 {
    entries.into_iter().fold(0.0, |m, v| m.max(v.abs()))
}

/// Eigenvalues of a symmetric 9x9 matrix by cyclic Jacobi rotations.
fn eigenvalues(mut a: [[f64; 9]; 9]) -> [f64; 9] {
    for _ in 0..30 {
        for p in 0..9 {
            for q in p + 1..9 {
                if a[p][q] == 0.0 {
                    continue;
                }
                let theta = 0.5 * (2.0 * a[p][q]).atan2(a[q][q] - a[p][p]);
                let (s, c) = theta.sin_cos();
                for row in &mut a {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
                for k in 0..9 {
                    (a[p][k], a[q][k]) = (c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]);
                }
            }
        }
    }
    let mut values = std::array::from_fn(|k| a[k][k]);
    values.sort_by(f64::total_cmp);
    values
}

#[test]
fn lame_constants_follow_from_modulus_and_ratio() {
    let law = law();
    assert!((law.mu() - 384_615.384_615_384_6).abs() < 1e-6);
    assert!((law.lambda() - 576_923.076_923_076_9).abs() < 1e-6);
    for (young, poisson) in [
        (0.0, 0.3),
        (f64::NAN, 0.3),
        (f64::INFINITY, 0.3),
        (-1.0, 0.3),
        (1e6, 0.5),
        (1e6, -0.1),
        (1e6, f64::NAN),
    ] {
        let error = NeoHookean::new(young, poisson).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Config, "{young} {poisson}");
    }
    assert_eq!(NeoHookean::new(1e6, 0.0).unwrap().lambda(), 0.0);
}

#[test]
fn stress_is_the_slope_of_the_energy() {
    let law = law();
    for (name, f) in cases() {
        let stress = law.pk1(&f).to_cols_array();
        let scale = largest(stress).max(law.mu());
        let h = step(&f);
        for (entry, value) in stress.into_iter().enumerate() {
            let e = |k: f64| law.energy(&moved(&f, entry, k * h));
            let slope = (8.0 * (e(1.0) - e(-1.0)) - (e(2.0) - e(-2.0))) / (12.0 * h);
            assert!(
                (slope - value).abs() < 1e-6 * scale,
                "{name} {entry}: {slope} {value}"
            );
        }
    }
}

#[test]
fn tangent_is_the_slope_of_the_stress() {
    let law = law();
    for (name, f) in cases() {
        let tangent = law.hessian(&f);
        let scale = largest(tangent.into_iter().flatten());
        let h = step(&f);
        for column in 0..9 {
            let up = law.pk1(&moved(&f, column, h)).to_cols_array();
            let down = law.pk1(&moved(&f, column, -h)).to_cols_array();
            for row in 0..9 {
                let slope = (up[row] - down[row]) / (2.0 * h);
                assert!(
                    (slope - tangent[row][column]).abs() < 1e-6 * scale,
                    "{name} {row} {column}"
                );
            }
        }
    }
}

#[test]
fn rest_and_rotation_have_no_stress() {
    let law = law();
    let rotation = DMat3::from_rotation_z(2.0) * DMat3::from_rotation_x(-0.4);
    for f in [DMat3::IDENTITY, rotation] {
        assert!(law.energy(&f).abs() < 1e-9);
        assert!(law.pk1(&f).abs_diff_eq(DMat3::ZERO, 1e-9));
    }
}

#[test]
fn inverted_elements_have_infinite_energy() {
    let law = law();
    for f in [
        DMat3::ZERO,
        DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)),
        DMat3::from_diagonal(DVec3::splat(f64::NAN)),
    ] {
        assert_eq!(law.energy(&f), f64::INFINITY);
    }
}

#[test]
fn projection_changes_only_negative_eigenvalues() {
    let law = law();
    for (name, f) in cases() {
        let exact = law.hessian(&f);
        let before = eigenvalues(exact);
        for projection in [Projection::Clamp, Projection::Abs] {
            let mut expected = before.map(|v| v + projection.correction(v));
            expected.sort_by(f64::total_cmp);
            let projected = law.projected_hessian(&f, projection);
            let found = eigenvalues(projected);
            for (a, b) in found.into_iter().zip(expected) {
                assert!(
                    (a - b).abs() < 1e-11 * before[8],
                    "{name} {projection:?}: {a} {b}"
                );
            }
            if before[0] >= 0.0 {
                assert_eq!(projected, exact, "{name}");
            }
        }
        assert_eq!(law.projected_hessian(&f, Projection::None), exact);
    }
}

#[test]
fn cases_cover_all_negative_modes() {
    let law = law();
    let indefinite = |f: &DMat3| eigenvalues(law.hessian(f))[0] < -1.0;
    let grown = |f: &DMat3| law.log_slope(f.determinant()) > 0.0;
    let stretches = |f: &DMat3| {
        let corrections = law.scaling_corrections(&svd(f), Projection::Clamp);
        corrections.iter().any(|(weight, _)| *weight > 1.0)
    };
    let all = cases();
    assert!(all.iter().any(|(_, f)| indefinite(f) && !grown(f)));
    assert!(all.iter().any(|(_, f)| indefinite(f) && grown(f)));
    assert!(all.iter().any(|(_, f)| stretches(f)));
    assert!(all.iter().any(|(_, f)| !indefinite(f)));
}

/// Nominal stresses in MPa of the law at E = 1 MPa, nu = 0.3, from a root search on its analytic
/// uniaxial and confined stress.
const NOMINAL: [(f64, f64, f64); 4] = [
    (0.05, 0.05205, 0.07062),
    (0.20, 0.24001, 0.33400),
    (0.30, 0.40523, 0.57418),
    (0.40, 0.62435, 0.90143),
];

#[test]
fn compression_matches_the_analytic_stress() {
    let law = law();
    for (compression, uniaxial, confined) in NOMINAL {
        let axial = 1.0 - compression;
        let stress = |side: f64| law.pk1(&DMat3::from_diagonal(DVec3::new(side, side, axial)));
        let confined_mpa = -stress(1.0).z_axis.z * 1e-6;
        assert!(
            (confined_mpa - confined).abs() < 5.1e-6,
            "{compression}: {confined_mpa}"
        );
        let (mut low, mut high) = (1.0, 1.5);
        for _ in 0..60 {
            let side = 0.5 * (low + high);
            if stress(side).x_axis.x < 0.0 {
                low = side;
            } else {
                high = side;
            }
        }
        let uniaxial_mpa = -stress(low).z_axis.z * 1e-6;
        assert!(
            (uniaxial_mpa - uniaxial).abs() < 5.1e-6,
            "{compression}: {uniaxial_mpa}"
        );
    }
}
