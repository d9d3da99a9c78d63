//! The edge-edge mollifier (Li et al. 2020, eq. 24): takes the barrier of two edges smoothly to
//! zero as they become parallel, where their closest points jump.
//!
//! `m = (2 − c/ε) c/ε` for `c < ε`, else 1, with `c = |ea × eb|²` of the current edges and
//! `ε = 1e-3 |ea|² |eb|²` of the edges at rest.

use glam::{DMat3, DVec3};

use super::distance_hessian::Matrix12;

/// ε relative to the squared lengths of the edges at rest; edges within about 1.8° are mollified.
pub const RELATIVE_THRESHOLD: f64 = 1e-3;

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
    /// Whether the factor is 1 and its derivatives are 0.
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

/// Second derivatives of the mollifier with respect to the edges, 1/m²: `[aa, ab, bb]`, the block
/// `ab` with rows over `ea` and columns over `eb`.
pub fn edge_hessian(ea: DVec3, eb: DVec3, epsilon: f64) -> [DMat3; 3] {
    let cross = ea.cross(eb);
    let c = cross.length_squared();
    if c >= epsilon {
        return [DMat3::ZERO; 3];
    }
    let first = 2.0 * (1.0 - c / epsilon) / epsilon;
    let second = -2.0 / (epsilon * epsilon);
    let (ga, gb) = (eb.cross(cross) * 2.0, cross.cross(ea) * 2.0);
    let dot = ea.dot(eb);
    let identity = DMat3::IDENTITY;
    let c_aa = (identity * eb.length_squared() - outer(eb, eb)) * 2.0;
    let c_bb = (identity * ea.length_squared() - outer(ea, ea)) * 2.0;
    let c_ab = (outer(ea, eb) * 2.0 - outer(eb, ea) - identity * dot) * 2.0;
    [
        c_aa * first + outer(ga, ga) * second,
        c_ab * first + outer(ga, gb) * second,
        c_bb * first + outer(gb, gb) * second,
    ]
}

/// Hessian of the mollifier over the stencil points `[a0, a1, b0, b1]`, 1/m².
pub fn hessian(ea: DVec3, eb: DVec3, epsilon: f64) -> Matrix12 {
    let [aa, ab, bb] = edge_hessian(ea, eb, epsilon);
    let mut matrix = [[0.0; 12]; 12];
    for i in 0..4 {
        for j in 0..4 {
            let sign = if i % 2 == j % 2 { 1.0 } else { -1.0 };
            let block = match (i < 2, j < 2) {
                (true, true) => aa,
                (true, false) => ab,
                (false, true) => ab.transpose(),
                (false, false) => bb,
            };
            for row in 0..3 {
                for column in 0..3 {
                    matrix[3 * i + row][3 * j + column] = sign * block.col(column)[row];
                }
            }
        }
    }
    matrix
}

/// `a bᵀ`.
#[inline]
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

#[cfg(test)]
mod tests {
    use super::super::stencil_cases::{
        Points, SCALES, assert_close, difference, difference_rows, edge_edge, flat,
    };
    use super::*;

    fn edges(x: &Points) -> (DVec3, DVec3) {
        (x[1] - x[0], x[3] - x[2])
    }

    #[test]
    fn derivatives_are_finite_differences() {
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
                let expected = difference_rows(&points, step, |x| flat(&at(x).gradient()));
                let hessian = hessian(ea, eb, epsilon);
                assert_close(
                    hessian.as_flattened(),
                    expected.as_flattened(),
                    1.0 / (scale * scale),
                    1e-6,
                    "hessian",
                );
            }
        }
    }

    #[test]
    fn parallel_edges_have_none() {
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
