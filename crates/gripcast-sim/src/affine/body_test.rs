#![allow(
    clippy::needless_range_loop,
    reason = "rows and columns of several matrices at once"
)]

use super::*;
use crate::affine::{AffineRate, Cholesky};
use gripcast_base::error::ErrorKind;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// A box of 40 x 30 x 60 mm and 60 g.
fn body() -> AffineBody {
    let size = DVec3::new(0.04, 0.03, 0.06);
    let volume = size.element_product();
    let moment = DMat3::from_diagonal(size * size * (volume / 12.0));
    AffineBody::new(0.06, volume, moment, 1e9).unwrap()
}

fn rotation() -> DMat3 {
    DMat3::from_rotation_z(0.8) * DMat3::from_rotation_x(-0.3)
}

/// Rotations, equal and unequal stretches, mirrored, flat and random linear parts.
fn cases() -> Vec<DMat3> {
    let stretched = |x, y, z| rotation() * DMat3::from_diagonal(DVec3::new(x, y, z)) * rotation();
    let mut all = vec![
        DMat3::IDENTITY,
        rotation(),
        stretched(1.001, 0.999, 1.0),
        stretched(0.9, 0.9, 0.9),
        stretched(0.5, 0.5, 1.2),
        stretched(0.3, 0.8, 0.8 + 1e-9),
        stretched(1.0, 1.0, 1e-3),
        stretched(1.0, 0.9, 0.0),
        stretched(1.0, 0.7, -0.4),
        stretched(1.3, 1.2, 1.1),
    ];
    let mut rng = Pcg64::seed_from_u64(21);
    all.extend(
        (0..30)
            .map(|_| DMat3::from_cols_array(&std::array::from_fn(|_| rng.random_range(-1.0..1.0)))),
    );
    all
}

fn state(a: DMat3) -> AffineState {
    AffineState {
        p: DVec3::new(0.1, -0.2, 0.3),
        a,
    }
}

fn moved(s: &AffineState, k: usize, by: f64) -> AffineState {
    let mut q = s.to_array();
    q[k] += by;
    AffineState::from_array(&q)
}

fn largest<'a>(values: impl IntoIterator<Item = &'a f64>) -> f64 {
    values.into_iter().fold(0.0, |m: f64, v| m.max(v.abs()))
}

fn shape_hessian(a: &DMat3, projection: Projection) -> Matrix12 {
    let mut h = [[0.0; 12]; 12];
    body().add_shape_hessian(a, projection, 1.0, &mut h);
    h
}

fn shape_gradient(a: &DMat3) -> Vector12 {
    let mut g = [0.0; 12];
    body().add_shape_gradient(a, 1.0, &mut g);
    g
}

#[test]
fn shape_gradient_and_hessian_are_slopes() {
    let (body, h) = (body(), 1e-5);
    for a in cases() {
        let s = state(a);
        let (g, m) = (shape_gradient(&a), shape_hessian(&a, Projection::None));
        let (g_scale, m_scale) = (
            largest(&g).max(1e-2 * largest(m.iter().flatten())),
            largest(m.iter().flatten()),
        );
        for k in 0..12 {
            let e = |by: f64| body.shape(&moved(&s, k, by * h).a);
            // Fourth order: exact but for rounding, as the energy is a quartic.
            let slope = (8.0 * (e(1.0) - e(-1.0)) - (e(2.0) - e(-2.0))) / (12.0 * h);
            assert!(
                (slope - g[k]).abs() < 1e-6 * g_scale,
                "{a} {k}: {slope} {}",
                g[k]
            );
            let gradient = |by: f64| shape_gradient(&moved(&s, k, by * h).a);
            let (up, down) = (gradient(1.0), gradient(-1.0));
            for r in 0..12 {
                let slope = (up[r] - down[r]) / (2.0 * h);
                assert!((slope - m[r][k]).abs() < 1e-6 * m_scale, "{a} {r} {k}");
            }
        }
    }
}

#[test]
fn rotations_have_no_shape_energy() {
    assert!(body().shape(&rotation()) < 1e-12);
    assert!(largest(&shape_gradient(&rotation())) < 1e-6);
}

#[test]
fn kinetic_gradient_and_hessian_are_slopes() {
    let body = body();
    let (s, hat) = (
        state(rotation() * 1.1),
        state(DMat3::IDENTITY).moved(rotation(), DVec3::X),
    );
    let mut m = [[0.0; 12]; 12];
    body.add_kinetic_hessian(1.0, &mut m);
    let mut g = [0.0; 12];
    body.add_kinetic_gradient(&s, &hat, 1.0, &mut g);
    let h = 1e-3;
    for k in 0..12 {
        let (up, down) = (moved(&s, k, h), moved(&s, k, -h));
        let slope = (body.kinetic(&up, &hat) - body.kinetic(&down, &hat)) / (2.0 * h);
        assert!((slope - g[k]).abs() < 1e-9 * largest(&g), "{k}");
        let [mut high, mut low] = [[0.0; 12]; 2];
        body.add_kinetic_gradient(&up, &hat, 1.0, &mut high);
        body.add_kinetic_gradient(&down, &hat, 1.0, &mut low);
        for r in 0..12 {
            let slope = (high[r] - low[r]) / (2.0 * h);
            assert!((slope - m[r][k]).abs() < 1e-9 * largest(m.iter().flatten()));
        }
    }
    assert_eq!(body.kinetic(&hat, &hat), 0.0);
}

/// The kinetic term is the integral of rho |x - x^|² / 2: a cloud of points with the same moments.
#[test]
fn kinetic_term_matches_a_point_cloud() {
    let body = body();
    let (s, hat) = (state(rotation() * 1.1), state(DMat3::from_rotation_y(0.2)));
    let half = DVec3::new(0.02, 0.015, 0.03) / 3.0_f64.sqrt();
    let mut sum = 0.0;
    for k in 0..8 {
        let sign = |bit: i32| if k & bit == 0 { -1.0 } else { 1.0 };
        let x = half * DVec3::new(sign(1), sign(2), sign(4));
        sum += 0.5 * 0.06 / 8.0 * (s.point(x) - hat.point(x)).length_squared();
    }
    assert!((body.kinetic(&s, &hat) / sum - 1.0).abs() < 1e-12);
}

fn positive_semidefinite(m: &Matrix12) -> bool {
    let mut m = *m;
    let shift = 1e-11 * largest(m.iter().flatten());
    (0..12).for_each(|k| m[k][k] += shift);
    Cholesky::new(&m).is_some()
}

#[test]
fn projected_shape_hessian_is_positive_semidefinite() {
    let mut indefinite = 0;
    for a in cases() {
        let exact = shape_hessian(&a, Projection::None);
        for projection in [Projection::Clamp, Projection::Abs] {
            let projected = shape_hessian(&a, projection);
            assert!(positive_semidefinite(&projected), "{a}");
            let scale = largest(exact.iter().flatten());
            let change =
                (0..144).map(|k| (projected[k / 12][k % 12] - exact[k / 12][k % 12]).abs());
            let changed = change.fold(0.0, f64::max) > 1e-11 * scale;
            assert_eq!(changed, !positive_semidefinite(&exact), "{a}");
        }
        indefinite += usize::from(!positive_semidefinite(&exact));
    }
    assert!((5..cases().len() - 2).contains(&indefinite), "{indefinite}");
}

/// `Abs` preserves the magnitudes of the eigenvalues, and so the square of the Hessian.
#[test]
fn absolute_projection_preserves_the_square() {
    let square = |m: &Matrix12| -> Matrix12 {
        std::array::from_fn(|r| std::array::from_fn(|c| (0..12).map(|k| m[r][k] * m[k][c]).sum()))
    };
    for a in cases() {
        let exact = square(&shape_hessian(&a, Projection::None));
        let absolute = square(&shape_hessian(&a, Projection::Abs));
        let scale = largest(exact.iter().flatten());
        for k in 0..144 {
            let (r, c) = (k / 12, k % 12);
            assert!((exact[r][c] - absolute[r][c]).abs() < 1e-11 * scale, "{a}");
        }
    }
}

/// One implicit Euler step without contact by Newton's method.
fn advance(
    body: &AffineBody,
    s: &AffineState,
    rate: &AffineRate,
    g: DVec3,
    dt: f64,
) -> AffineState {
    let inertial = s.inertial(rate, g, dt);
    let mut next = inertial;
    for _ in 0..20 {
        let (mut gradient, mut hessian) = ([0.0; 12], [[0.0; 12]; 12]);
        body.add_kinetic_gradient(&next, &inertial, 1.0, &mut gradient);
        body.add_shape_gradient(&next.a, dt * dt, &mut gradient);
        body.add_kinetic_hessian(1.0, &mut hessian);
        body.add_shape_hessian(&next.a, Projection::Clamp, dt * dt, &mut hessian);
        let step = Cholesky::new(&hessian).unwrap().solve(&gradient);
        next = next.stepped(&step, -1.0);
        if largest(&step) < 1e-15 {
            break;
        }
    }
    next
}

/// Twice the axial vector of the skew part.
fn axial(m: DMat3) -> DVec3 {
    DVec3::new(
        m.y_axis.z - m.z_axis.y,
        m.z_axis.x - m.x_axis.z,
        m.x_axis.y - m.y_axis.x,
    )
}

/// Angular momentum about the centre of mass in kg m²/s.
fn angular_momentum(body: &AffineBody, s: &AffineState, rate: &AffineRate) -> DVec3 {
    axial(rate.a * *body.second_moment() * s.a.transpose())
}

/// The shape energy exerts no torque, so a step changes the angular momentum only by the damping
/// error of implicit Euler, dt axial(A'_old S A'_new^T).
#[test]
fn free_body_conserves_momenta() {
    let (body, dt) = (body(), 0.01);
    let mut s = state(rotation());
    let omega = DVec3::new(0.5, -1.0, 2.0);
    let mut rate = AffineRate {
        p: DVec3::new(0.1, 0.0, -0.2),
        a: DMat3::from_cols(
            omega.cross(s.a.x_axis),
            omega.cross(s.a.y_axis),
            omega.cross(s.a.z_axis),
        ),
    };
    let velocity = rate.p;
    for step in 0..100 {
        let before = angular_momentum(&body, &s, &rate);
        let next = advance(&body, &s, &rate, DVec3::ZERO, dt);
        let next_rate = next.rate_since(&s, dt);
        let after = angular_momentum(&body, &next, &next_rate);
        let error = dt * axial(rate.a * *body.second_moment() * next_rate.a.transpose());
        (s, rate) = (next, next_rate);
        assert!(
            (rate.p - velocity).length() < 1e-12,
            "step {step}: {}",
            rate.p
        );
        let drift = (after - before - error).length() / before.length();
        assert!(drift < 1e-9, "step {step}: {drift}");
        let kept = after.length() / before.length();
        assert!(
            kept <= 1.0 && kept > 1.0 - (omega.length() * dt).powi(2),
            "{step}: {kept}"
        );
    }
    let strain = s.a.transpose() * s.a - DMat3::IDENTITY;
    assert!(largest(&strain.to_cols_array()) < 1e-6);
    let rotated = s.a * rotation().transpose();
    assert!(!rotated.abs_diff_eq(DMat3::IDENTITY, 0.5), "no rotation");
}

#[test]
fn free_fall_follows_implicit_euler() {
    let (body, dt, g) = (body(), 0.01, DVec3::new(0.0, 0.0, -9.81));
    let start = state(rotation());
    let (mut s, mut rate) = (start, AffineRate::ZERO);
    for n in 1..=100 {
        let next = advance(&body, &s, &rate, g, dt);
        rate = next.rate_since(&s, dt);
        s = next;
        let fallen = 9.81 * dt * dt * f64::from(n * (n + 1)) / 2.0;
        assert!((s.p.z - (start.p.z - fallen)).abs() < 1e-9, "{n}");
        assert!(s.a.abs_diff_eq(start.a, 1e-12), "{n}");
    }
}

#[test]
fn invalid_bodies_are_rejected() {
    let good = DMat3::from_diagonal(DVec3::new(1e-9, 2e-9, 3e-9));
    let skew = DMat3::from_cols(good.x_axis + DVec3::Y * 1e-9, good.y_axis, good.z_axis);
    let flat = DMat3::from_diagonal(DVec3::new(1e-9, 2e-9, 0.0));
    assert!(AffineBody::new(0.05, 1e-5, good, 1e9).is_ok());
    for (mass, volume, moment, stiffness) in [
        (0.0, 1e-5, good, 1e9),
        (f64::INFINITY, 1e-5, good, 1e9),
        (0.05, -1e-5, good, 1e9),
        (0.05, 1e-5, skew, 1e9),
        (0.05, 1e-5, flat, 1e9),
        (0.05, 1e-5, good * -1.0, 1e9),
        (0.05, 1e-5, good * f64::NAN, 1e9),
        (0.05, 1e-5, good, 0.0),
    ] {
        let error = AffineBody::new(mass, volume, moment, stiffness).unwrap_err();
        assert_eq!(
            error.kind(),
            ErrorKind::Input,
            "{mass} {volume} {moment} {stiffness}"
        );
    }
}
