//! Largest step size without inverted tetrahedra.
//!
//! Along x + a dx the determinant of a tetrahedron's edges is a cubic in a; the step ends before
//! the first root of det(a) = fraction * det(0) (the filter of Smith and Schaefer, *Bijective
//! Parameterization with Free Boundaries*, 2015, in three dimensions).

#![allow(
    clippy::needless_range_loop,
    reason = "loops over lanes run through many arrays at once"
)]

use glam::DVec3;
use pulp::{Simd, WithSimd};

use super::batch::{Batch, Lanes, WIDTH};
use super::kernel::{Vector, at, cross, dot};

/// Minimum fraction of its volume that a tetrahedron keeps in one step.
const MIN_VOLUME_FRACTION: f64 = 0.1;

/// Largest step size in (0, 1] along `dx`.
pub(super) struct SafeStep<'a> {
    pub(super) batches: &'a [Batch],
    pub(super) x: &'a [DVec3],
    pub(super) dx: &'a [DVec3],
}

impl WithSimd for SafeStep<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let mut step = 1.0;
        for batch in self.batches {
            let cubic = volume_cubic(&batch.edges(self.x), &batch.edges(self.dx));
            let mut bound = [0.0; WIDTH];
            for l in 0..WIDTH {
                let tail = cubic[2][l].abs() + step * cubic[3][l].abs();
                bound[l] = step * (cubic[1][l].abs() + step * tail);
            }
            // Far from a root for all steps allowed so far: the usual case.
            if bound
                .iter()
                .fold(true, |safe, b| safe & (*b < 1.0 - MIN_VOLUME_FRACTION))
            {
                continue;
            }
            for l in 0..WIDTH {
                step = first_root([0, 1, 2, 3].map(|k| cubic[k][l]), step);
            }
        }
        step
    }
}

/// det(x + a dx) / det(x) - fraction as coefficients of 1, a, a², a³.
#[inline(always)]
fn volume_cubic(x: &[Vector; 3], dx: &[Vector; 3]) -> [Lanes; 4] {
    let mut cubic = [[0.0; WIDTH]; 4];
    for l in 0..WIDTH {
        let (a, b, c) = (at(&x[0], l), at(&x[1], l), at(&x[2], l));
        let (u, v, w) = (at(&dx[0], l), at(&dx[1], l), at(&dx[2], l));
        let (ab, uv) = (cross(a, b), cross(u, v));
        let mixed = [cross(a, v), cross(u, b)];
        let mixed = [0, 1, 2].map(|k| mixed[0][k] + mixed[1][k]);
        let scale = 1.0 / dot(ab, c);
        cubic[0][l] = 1.0 - MIN_VOLUME_FRACTION;
        cubic[1][l] = (dot(ab, w) + dot(mixed, c)) * scale;
        cubic[2][l] = (dot(mixed, w) + dot(uv, c)) * scale;
        cubic[3][l] = dot(uv, w) * scale;
    }
    cubic
}

/// Smaller of `limit` and a point just before the first root of the cubic in (0, `limit`); the
/// cubic is positive at 0 and up to the returned point. Zero when a coefficient is not a number.
fn first_root(c: [f64; 4], limit: f64) -> f64 {
    if !c.iter().all(|v| v.is_finite()) {
        return 0.0;
    }
    let value = |a: f64| c[0] + a * (c[1] + a * (c[2] + a * c[3]));
    let mut low = 0.0;
    // Between its turning points the cubic is monotone: a change of sign encloses one root.
    for end in turning_points(c, limit) {
        if value(end) <= 0.0 {
            return bisect(value, low, end);
        }
        low = end;
    }
    limit
}

/// Turning points of the cubic in (0, limit), ascending, then `limit`.
fn turning_points(c: [f64; 4], limit: f64) -> [f64; 3] {
    // Roots of 3 c3 a² + 2 c2 a + c1 in the form that does not cancel.
    let discriminant = c[2] * c[2] - 3.0 * c[3] * c[1];
    let q = -(c[2] + discriminant.max(0.0).sqrt().copysign(c[2]));
    let inside = |a: f64| if a > 0.0 && a < limit { a } else { limit };
    let (first, second) = if discriminant <= 0.0 {
        (limit, limit)
    } else {
        (inside(q / (3.0 * c[3])), inside(c[1] / q))
    };
    [first.min(second), first.max(second), limit]
}

/// Lower end of a bracket of the root in (low, high], where `value` falls from positive.
fn bisect(value: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    while high - low > 1e-6 * high {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            break;
        }
        if value(middle) > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    /// (1 - MIN_VOLUME_FRACTION) scaled cubic with the given roots, positive at zero.
    fn with_roots(roots: [f64; 3]) -> [f64; 4] {
        let [r, s, t] = roots;
        let scale = -1.0 / (r * s * t);
        [
            1.0,
            scale * (r * s + s * t + t * r),
            -scale * (r + s + t),
            scale,
        ]
    }

    #[test]
    fn first_positive_root_bounds_the_step() {
        for (roots, expected) in [
            ([0.5, 0.7, 2.0], 0.5),
            ([0.7, 0.2, 0.9], 0.2),
            ([0.4, 0.4, 0.4], 0.4),
            ([-1.0, -2.0, 0.3], 0.3),
            ([-1.0, -0.5, 4.0], 1.0),
            ([1e-9, 0.5, 1.0], 1e-9),
            ([1e9, 1e9, 0.3], 0.3),
        ] {
            let step = first_root(with_roots(roots), 1.0);
            let width = if roots[0] == roots[1] { 1e-4 } else { 2e-6 };
            assert!(
                (step - expected).abs() <= width * expected,
                "{roots:?}: {step}"
            );
        }
    }

    #[test]
    fn lower_degrees_are_handled() {
        assert_eq!(first_root([1.0, 0.0, 0.0, 0.0], 1.0), 1.0);
        assert!((first_root([1.0, -2.0, 0.0, 0.0], 1.0) - 0.5).abs() < 1e-6);
        assert!((first_root([1.0, 0.0, -4.0, 0.0], 1.0) - 0.5).abs() < 1e-6);
        assert!((first_root([1.0, 0.0, 0.0, -8.0], 1.0) - 0.5).abs() < 1e-6);
        assert_eq!(first_root([1.0, f64::NAN, 0.0, 0.0], 1.0), 0.0);
    }

    #[test]
    fn step_never_exceeds_the_limit() {
        assert_eq!(first_root([1.0, -2.0, 0.0, 0.0], 0.3), 0.3);
    }
}
