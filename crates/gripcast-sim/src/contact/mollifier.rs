//! Edge-edge mollifier (Li et al. 2020, eq. 24): smoothly reduces the barrier of two edges to zero
//! as they become parallel, where their closest points jump.
//!
//! `m = (2 − c/ε) c/ε` for `c < ε`, else 1, with `c = |ea × eb|²` of the current edges and
//! `ε = 1e-3 |ea|² |eb|²` of the edges at rest.

use glam::DVec3;

/// ε relative to the squared lengths of the edges at rest; mollifies edges within about 1.8°.
const RELATIVE_THRESHOLD: f64 = 1e-3;

/// ε of two edges at rest, m⁴.
#[inline]
pub fn threshold(rest_ea: DVec3, rest_eb: DVec3) -> f64 {
    RELATIVE_THRESHOLD * rest_ea.length_squared() * rest_eb.length_squared()
}

/// The mollifier of one pair of edges, and its gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mollifier {
    /// Factor of the barrier, in [0, 1].
    pub value: f64,
    /// Derivative with respect to the edge `ea = a1 − a0`, 1/m.
    pub gradient_ea: DVec3,
    /// Derivative with respect to the edge `eb = b1 − b0`, 1/m.
    pub gradient_eb: DVec3,
}

impl Mollifier {
    /// Whether the mollifier has no effect: factor 1, gradient 0.
    #[inline]
    pub fn is_one(&self) -> bool {
        self.value >= 1.0
    }

    /// Gradient with respect to the stencil points `[a0, a1, b0, b1]`, 1/m.
    #[inline]
    pub fn gradient(&self) -> [DVec3; 4] {
        [
            -self.gradient_ea,
            self.gradient_ea,
            -self.gradient_eb,
            self.gradient_eb,
        ]
    }
}

/// Value of the mollifier of the edges `ea`, `eb` (m) with threshold `epsilon` (m⁴).
#[inline]
pub fn value(ea: DVec3, eb: DVec3, epsilon: f64) -> f64 {
    let c = ea.cross(eb).length_squared();
    if c >= epsilon {
        return 1.0;
    }
    let x = c / epsilon;
    (2.0 - x) * x
}

/// Mollifier of the edges `ea`, `eb` (m) with threshold `epsilon` (m⁴).
#[inline]
pub fn mollifier(ea: DVec3, eb: DVec3, epsilon: f64) -> Mollifier {
    let cross = ea.cross(eb);
    let c = cross.length_squared();
    if c >= epsilon {
        return Mollifier {
            value: 1.0,
            gradient_ea: DVec3::ZERO,
            gradient_eb: DVec3::ZERO,
        };
    }
    let x = c / epsilon;
    let slope = 4.0 * (1.0 - x) / epsilon;
    Mollifier {
        value: (2.0 - x) * x,
        gradient_ea: eb.cross(cross) * slope,
        gradient_eb: cross.cross(ea) * slope,
    }
}

#[cfg(test)]
mod tests {
    use super::super::stencil_cases::{Points, SCALES, assert_close, difference, edge_edge, flat};
    use super::*;

    fn edges(x: &Points) -> (DVec3, DVec3) {
        (x[1] - x[0], x[3] - x[2])
    }

    #[test]
    fn derivatives_match_finite_differences() {
        for scale in SCALES {
            for points in edge_edge(scale) {
                let (ea, eb) = edges(&points);
                let epsilon = threshold(ea, eb);
                let c = ea.cross(eb).length_squared();
                // The second derivative jumps at the threshold.
                if (c / epsilon - 1.0).abs() < 1e-3 {
                    continue;
                }
                let at = |x: &Points| {
                    let (ea, eb) = edges(x);
                    mollifier(ea, eb, epsilon)
                };
                let step = 1e-6 * scale;
                let found = at(&points);
                assert_eq!(found.value, value(ea, eb, epsilon));
                assert_eq!(found.is_one(), c >= epsilon);
                let expected = difference(&points, step, |x| at(x).value);
                assert_close(
                    &flat(&found.gradient()),
                    &expected,
                    1.0 / scale,
                    1e-6,
                    "gradient",
                );
            }
        }
    }

    #[test]
    fn parallel_edges_are_fully_mollified() {
        let found = mollifier(
            DVec3::X,
            DVec3::X * 2.0,
            threshold(DVec3::X, DVec3::X * 2.0),
        );
        assert_eq!(found.value, 0.0);
        assert_eq!(found.gradient(), [DVec3::ZERO; 4]);
        assert_eq!(value(DVec3::ZERO, DVec3::X, 0.0), 1.0);
    }
}
