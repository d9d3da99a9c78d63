//! Lagged, mollified Coulomb friction (Li et al. 2020, §5).
//!
//! For a step of dt seconds with relative displacement u (m) of the two closest points, a normal
//! force λ (N) and the normal n of the step's start, the dissipative potential is
//! `D(u) = μ λ f0(|u − n (n·u)|)`. f0 is quadratic-cubic up to `ε = eps_v dt` (m) and the identity
//! above, so the force is at most μ λ and C1 in u.

use glam::{DMat3, DVec3};

use crate::fem::outer;

/// f0 (m) of a tangential displacement `y >= 0` (m); `epsilon` is `eps_v dt` (m).
#[inline]
pub fn f0(y: f64, epsilon: f64) -> f64 {
    if y >= epsilon {
        return y;
    }
    let x = y / epsilon;
    epsilon * (x * x * (1.0 - x / 3.0) + 1.0 / 3.0)
}

/// f1, the derivative of f0: the friction force as a fraction of μ λ, in [0, 1].
#[inline]
pub fn f1(y: f64, epsilon: f64) -> f64 {
    if y >= epsilon {
        return 1.0;
    }
    let x = y / epsilon;
    x * (2.0 - x)
}

/// `f1 / y`, 1/m; finite at `y = 0`.
#[inline]
pub fn f1_over_y(y: f64, epsilon: f64) -> f64 {
    if y >= epsilon {
        return 1.0 / y;
    }
    (2.0 - y / epsilon) / epsilon
}

/// f2, the derivative of f1, 1/m; never negative.
#[inline]
pub fn f2(y: f64, epsilon: f64) -> f64 {
    if y >= epsilon {
        return 0.0;
    }
    2.0 * (1.0 - y / epsilon) / epsilon
}

/// Friction of one contact over a time step, with normal and force lagged from its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction {
    /// Unit normal.
    pub normal: DVec3,
    /// Limit force μ λ, N.
    pub limit: f64,
    /// `eps_v dt`, m: displacement below which the contact sticks (creeps).
    pub epsilon: f64,
}

impl Friction {
    /// Tangential component of the relative displacement `u`, m.
    #[inline]
    pub fn tangential(&self, u: DVec3) -> DVec3 {
        u - self.normal * self.normal.dot(u)
    }

    /// Dissipative potential of the relative displacement `u` (m), J.
    #[inline]
    pub fn value(&self, u: DVec3) -> f64 {
        self.limit * f0(self.tangential(u).length(), self.epsilon)
    }

    /// Gradient with respect to `u`, N; the friction force is its negative.
    #[inline]
    pub fn gradient(&self, u: DVec3) -> DVec3 {
        let tangential = self.tangential(u);
        tangential * (self.limit * f1_over_y(tangential.length(), self.epsilon))
    }

    /// Hessian with respect to `u`, N/m: positive semidefinite, with the normal in its kernel.
    #[inline]
    pub fn hessian(&self, u: DVec3) -> DMat3 {
        let tangential = self.tangential(u);
        let y = tangential.length();
        let across = self.limit * f1_over_y(y, self.epsilon);
        let n = self.normal;
        let projector =
            DMat3::from_cols(DVec3::X - n * n.x, DVec3::Y - n * n.y, DVec3::Z - n * n.z);
        let mut hessian = projector * across;
        if y > 0.0 {
            let along = self.limit * f2(y, self.epsilon);
            let direction = tangential / y;
            hessian += outer(direction * (along - across), direction);
        }
        hessian
    }
}

#[cfg(test)]
mod tests {
    use super::super::stencil_cases::{assert_close, random};
    use super::*;

    const EPSILON: f64 = 1e-5;

    fn friction(normal: DVec3) -> Friction {
        Friction {
            normal: normal.normalize(),
            limit: 0.4 * 2.5,
            epsilon: EPSILON,
        }
    }

    #[test]
    fn scalars_are_derivatives_of_each_other() {
        for fraction in [1e-3, 0.01, 0.1, 0.5, 0.9, 0.999, 1.001, 2.0, 10.0] {
            let y = fraction * EPSILON;
            let h = 1e-4 * y.min(EPSILON);
            let slope = (f0(y + h, EPSILON) - f0(y - h, EPSILON)) / (2.0 * h);
            assert_close(&[f1(y, EPSILON)], &[slope], 1e-3, 1e-6, "f1");
            let slope = (f1(y + h, EPSILON) - f1(y - h, EPSILON)) / (2.0 * h);
            assert_close(&[f2(y, EPSILON)], &[slope], 1.0, 1e-6, "f2");
            let quotient = f1(y, EPSILON) / y;
            assert_close(&[f1_over_y(y, EPSILON)], &[quotient], 1.0, 1e-14, "f1/y");
        }
        assert_eq!(f1(0.0, EPSILON), 0.0);
        assert_eq!(f1(EPSILON, EPSILON), 1.0);
        assert_eq!(f1_over_y(0.0, EPSILON), 2.0 / EPSILON);
    }

    #[test]
    fn derivatives_match_finite_differences() {
        for (case, points) in random(100, 1.0, 5).into_iter().enumerate() {
            let friction = friction(points[0]);
            let size = EPSILON * [1e-3, 0.3, 0.8, 3.0][case % 4];
            let u = points[1] * size;
            let y = friction.tangential(u).length();
            if (y / EPSILON - 1.0).abs() < 1e-2 {
                continue;
            }
            let h = 1e-5 * EPSILON;
            let axes = DVec3::AXES.map(|axis| axis * h);
            let expected =
                axes.map(|a| (friction.value(u + a) - friction.value(u - a)) / (2.0 * h));
            let gradient = friction.gradient(u);
            assert_close(
                &gradient.to_array(),
                &expected,
                friction.limit,
                1e-6,
                "gradient",
            );
            let columns =
                axes.map(|a| (friction.gradient(u + a) - friction.gradient(u - a)) / (2.0 * h));
            let expected = columns.map(|c| c.to_array());
            let hessian = friction.hessian(u).to_cols_array_2d();
            assert_close(
                hessian.as_flattened(),
                expected.as_flattened(),
                friction.limit / EPSILON,
                2e-5,
                "hessian",
            );
        }
    }

    #[test]
    fn hessian_is_positive_semidefinite_without_normal_part() {
        for points in random(200, 1.0, 6) {
            let friction = friction(points[0]);
            for size in [0.0, 1e-9, 1e-6, 1e-5, 1e-3] {
                let hessian = friction.hessian(points[1] * size);
                let stiffness = 2.0 * friction.limit / EPSILON;
                let pressed = hessian * friction.normal;
                assert!(pressed.length() <= 1e-13 * stiffness);
                let energy = points[2].dot(hessian * points[2]);
                assert!(energy >= -1e-13 * stiffness, "{energy:e}");
            }
        }
    }

    #[test]
    fn force_stays_in_the_friction_cone() {
        for points in random(200, 3.0 * EPSILON, 7) {
            let friction = friction(points[0]);
            let force = friction.gradient(points[1]);
            assert!(force.length() <= friction.limit * (1.0 + 1e-15));
            assert!(force.dot(points[1]) >= 0.0);
        }
    }
}
