//! State and rate of an affine body, and their map to its material points.

use glam::{DMat3, DVec3};

use super::{Matrix12, Vector12};
use crate::fem::svd;

/// State of an affine body: material point X, relative to the centre of mass, is at p + A X.
///
/// As a vector q = (p, columns of A): entry 3 + 3 j + i is A(i, j). With weights w = (1, X), a
/// point is x = Σ w_k q_k over the four 3-vectors of q.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AffineState {
    /// Centre of mass in m.
    pub p: DVec3,
    /// Linear part; a rotation when the body is not strained.
    pub a: DMat3,
}

/// Rate of change of an [`AffineState`] in 1/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AffineRate {
    /// Velocity of the centre of mass in m/s.
    pub p: DVec3,
    /// Rate of the linear part in 1/s.
    pub a: DMat3,
}

impl AffineRate {
    /// At rest.
    pub const ZERO: Self = Self {
        p: DVec3::ZERO,
        a: DMat3::ZERO,
    };
}

impl AffineState {
    /// A body rotated by `rotation` with its centre of mass at `p` (m).
    pub fn rigid(p: DVec3, rotation: DMat3) -> Self {
        Self { p, a: rotation }
    }

    /// World position of material point `x`, m.
    pub fn point(&self, x: DVec3) -> DVec3 {
        self.p + self.a * x
    }

    /// As a vector of 12: p, then the columns of A.
    pub fn to_array(&self) -> Vector12 {
        let mut q = [0.0; 12];
        self.p.write_to_slice(&mut q[..3]);
        self.a.write_cols_to_slice(&mut q[3..]);
        q
    }

    /// Inverse of [`AffineState::to_array`].
    pub fn from_array(q: &Vector12) -> Self {
        Self {
            p: DVec3::from_slice(&q[..3]),
            a: DMat3::from_cols_slice(&q[3..]),
        }
    }

    /// This state plus `scale` times a step of the 12 numbers.
    #[must_use]
    pub fn stepped(&self, step: &Vector12, scale: f64) -> Self {
        let step = Self::from_array(step);
        Self {
            p: self.p + scale * step.p,
            a: self.a + step.a * scale,
        }
    }

    /// This state after the rigid motion x → rotation x + translation (m) of the world.
    #[must_use]
    pub fn moved(&self, rotation: DMat3, translation: DVec3) -> Self {
        Self {
            p: rotation * self.p + translation,
            a: rotation * self.a,
        }
    }

    /// Rate that leads from `before` to this state in `dt` seconds.
    pub fn rate_since(&self, before: &Self, dt: f64) -> AffineRate {
        AffineRate {
            p: (self.p - before.p) / dt,
            a: (self.a - before.a) * (1.0 / dt),
        }
    }

    /// Inertial prediction of implicit Euler after `dt` seconds with a constant acceleration
    /// (m/s²): the minimum of the kinetic term.
    #[must_use]
    pub fn inertial(&self, rate: &AffineRate, acceleration: DVec3, dt: f64) -> Self {
        Self {
            p: self.p + dt * rate.p + dt * dt * acceleration,
            a: self.a + rate.a * dt,
        }
    }

    /// Rotation nearest to A in the Frobenius norm (polar decomposition). For det A < 0 the
    /// smallest singular direction is mirrored.
    pub fn nearest_rotation(&self) -> DMat3 {
        let mut parts = svd(&self.a);
        if parts.u.determinant() < 0.0 {
            let smallest = parts.sigma.min_position();
            *parts.u.col_mut(smallest) = -parts.u.col(smallest);
        }
        parts.u * parts.v.transpose()
    }
}

/// Weights (1, X) of the four 3-vectors of q in material point `x`: the Jacobian of a world point
/// is their Kronecker product with the identity.
pub fn axis_weights(x: DVec3) -> [f64; 4] {
    [1.0, x.x, x.y, x.z]
}

/// Adds J^T f for a force f on material point `x` to `gradient`.
pub fn add_point_gradient(x: DVec3, force: DVec3, gradient: &mut Vector12) {
    for (k, w) in axis_weights(x).into_iter().enumerate() {
        for axis in 0..3 {
            gradient[3 * k + axis] += w * force[axis];
        }
    }
}

/// Adds J(x)^T H J(y) to `hessian`.
pub fn add_point_hessian(x: DVec3, y: DVec3, block: &DMat3, hessian: &mut Matrix12) {
    let columns = block.to_cols_array_2d();
    for (k, wx) in axis_weights(x).into_iter().enumerate() {
        for (l, wy) in axis_weights(y).into_iter().enumerate() {
            let w = wx * wy;
            for (c, column) in columns.iter().enumerate() {
                for (r, entry) in column.iter().enumerate() {
                    hessian[3 * k + r][3 * l + c] += w * entry;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(
        clippy::needless_range_loop,
        reason = "rows and columns of several matrices at once"
    )]

    use super::*;

    fn rotation() -> DMat3 {
        DMat3::from_rotation_z(0.8) * DMat3::from_rotation_x(-0.3)
    }

    #[test]
    fn vector_form_is_p_and_the_columns() {
        let s = AffineState {
            p: DVec3::new(1.0, 2.0, 3.0),
            a: DMat3::from_cols_array(&[4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0]),
        };
        let q = s.to_array();
        assert_eq!(q, std::array::from_fn(|k| k as f64 + 1.0));
        assert_eq!(AffineState::from_array(&q), s);
        let x = DVec3::new(0.5, -1.0, 2.0);
        let w = axis_weights(x);
        let point: DVec3 = (0..4).map(|k| w[k] * DVec3::from_slice(&q[3 * k..])).sum();
        assert!(point.abs_diff_eq(s.point(x), 1e-14));
    }

    #[test]
    fn point_gradient_and_hessian_match_the_jacobian() {
        let (x, y) = (DVec3::new(0.1, -0.2, 0.3), DVec3::new(-0.4, 0.5, 0.6));
        let force = DVec3::new(1.0, -2.0, 4.0);
        let block = DMat3::from_cols_array(&std::array::from_fn(|k| k as f64 - 3.5));
        let (mut g, mut h) = ([0.0; 12], [[0.0; 12]; 12]);
        add_point_gradient(x, force, &mut g);
        add_point_hessian(x, y, &block, &mut h);
        let jacobian = |p: DVec3, k: usize| {
            let mut unit = [0.0; 12];
            unit[k] = 1.0;
            AffineState::from_array(&unit).point(p)
        };
        for r in 0..12 {
            assert!((g[r] - jacobian(x, r).dot(force)).abs() < 1e-14);
            for c in 0..12 {
                let expected = jacobian(x, r).dot(block * jacobian(y, c));
                assert!((h[r][c] - expected).abs() < 1e-14, "{r} {c}");
            }
        }
    }

    #[test]
    fn nearest_rotation_ignores_stretch() {
        let stretch = DMat3::from_rotation_y(0.4)
            * DMat3::from_diagonal(DVec3::new(0.5, 1.0, 1.7))
            * DMat3::from_rotation_y(-0.4);
        for a in [rotation(), rotation() * 3.0, rotation() * stretch] {
            let s = AffineState { p: DVec3::ZERO, a };
            assert!(s.nearest_rotation().abs_diff_eq(rotation(), 1e-13));
        }
    }

    #[test]
    fn nearest_rotation_handles_mirrored_and_flat_states() {
        let mirrored = rotation() * DMat3::from_diagonal(DVec3::new(1.0, 0.9, -0.1));
        for a in [
            mirrored,
            rotation() * DMat3::from_diagonal(DVec3::new(1.0, 0.9, 0.0)),
            DMat3::ZERO,
        ] {
            let r = AffineState { p: DVec3::ZERO, a }.nearest_rotation();
            assert!((r.determinant() - 1.0).abs() < 1e-13);
            assert!((r.transpose() * r).abs_diff_eq(DMat3::IDENTITY, 1e-13));
        }
        let nearest = AffineState {
            p: DVec3::ZERO,
            a: mirrored,
        }
        .nearest_rotation();
        assert!(nearest.abs_diff_eq(rotation(), 1e-13));
    }

    #[test]
    fn inertial_prediction_inverts_the_rate() {
        let start = AffineState::rigid(DVec3::X, rotation());
        let step = std::array::from_fn(|k| 0.01 * k as f64);
        let next = start.stepped(&step, 0.5);
        let rate = next.rate_since(&start, 0.1);
        let back = next.inertial(&rate, DVec3::ZERO, -0.1);
        assert!(back.p.abs_diff_eq(start.p, 1e-15) && back.a.abs_diff_eq(start.a, 1e-15));
    }
}
