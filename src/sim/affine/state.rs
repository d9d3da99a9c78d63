//! Position and rate of an affine body, and the map from them to its material points.

use glam::{DMat3, DVec3};

use super::dense::{Matrix12, Vector12};
use crate::sim::fem::svd;

/// Where an affine body is: material point X, relative to the centre of mass, lies at p + A X.
///
/// As 12 numbers q = (p, A's columns): entry 3 + 3 j + i is A(i, j). With weights
/// w = (1, X) a point is x = sum w_k q_k over the four 3-vectors of q.
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
    /// A body turned by `rotation` with its centre of mass at `p` (m).
    #[must_use]
    pub fn rigid(p: DVec3, rotation: DMat3) -> Self {
        Self { p, a: rotation }
    }

    /// World place in m of material point `x`.
    #[must_use]
    pub fn point(&self, x: DVec3) -> DVec3 {
        self.p + self.a * x
    }

    /// The 12 numbers: p, then the columns of A.
    #[must_use]
    pub fn to_array(&self) -> Vector12 {
        let mut q = [0.0; 12];
        self.p.write_to_slice(&mut q[..3]);
        self.a.write_cols_to_slice(&mut q[3..]);
        q
    }

    /// Inverse of [`AffineState::to_array`].
    #[must_use]
    pub fn from_array(q: &Vector12) -> Self {
        Self {
            p: DVec3::from_slice(&q[..3]),
            a: DMat3::from_cols_slice(&q[3..]),
        }
    }

    /// This state moved by `scale` times a step of the 12 numbers.
    #[must_use]
    pub fn stepped(&self, step: &Vector12, scale: f64) -> Self {
        let step = Self::from_array(step);
        Self {
            p: self.p + scale * step.p,
            a: self.a + step.a * scale,
        }
    }

    /// This state after the rigid motion x -> rotation x + translation (m) of the world.
    #[must_use]
    pub fn moved(&self, rotation: DMat3, translation: DVec3) -> Self {
        Self {
            p: rotation * self.p + translation,
            a: rotation * self.a,
        }
    }

    /// Rate in 1/s that leads from `before` to this state in `dt` seconds.
    #[must_use]
    pub fn rate_since(&self, before: &Self, dt: f64) -> AffineRate {
        AffineRate {
            p: (self.p - before.p) / dt,
            a: (self.a - before.a) * (1.0 / dt),
        }
    }

    /// Where inertia and a constant acceleration (m/s²) carry the body in `dt` seconds under
    /// implicit Euler: the minimum of the kinetic term.
    #[must_use]
    pub fn inertial(&self, rate: &AffineRate, acceleration: DVec3, dt: f64) -> Self {
        Self {
            p: self.p + dt * rate.p + dt * dt * acceleration,
            a: self.a + rate.a * dt,
        }
    }

    /// Like [`AffineState::inertial`], but turned by the rate's angular velocity without strain:
    /// a start for Newton's method, not the minimum of the kinetic term.
    #[must_use]
    pub fn rigid_predictor(&self, rate: &AffineRate, acceleration: DVec3, dt: f64) -> Self {
        let spin = rate.a * self.nearest_rotation().transpose();
        let turn = 0.5
            * dt
            * DVec3::new(
                spin.y_axis.z - spin.z_axis.y,
                spin.z_axis.x - spin.x_axis.z,
                spin.x_axis.y - spin.y_axis.x,
            );
        let rotation = glam::DQuat::from_scaled_axis(turn);
        Self {
            p: self.p + dt * rate.p + dt * dt * acceleration,
            a: DMat3::from_quat(rotation) * self.a,
        }
    }

    /// The rotation nearest to A in the Frobenius norm (polar decomposition). For det A < 0 the
    /// smallest singular direction is mirrored.
    #[must_use]
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
#[must_use]
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
