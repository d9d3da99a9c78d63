//! Second derivatives of the squared distance.
//!
//! With `f(x, θ) = |r|²`, `r = Σ w_i(θ) x_i`, and θ at its minimum, the Hessian of `min f` is
//! `f_xx − f_xθ f_θθ⁻¹ f_θx`. θ is empty for two points, one parameter for a point and an edge,
//! two for a point and a triangle or two edges. `w` is linear in θ, so `f_θθ = 2 JᵀJ` with
//! `J = ∂r/∂θ`.

use glam::DVec3;

use super::distance::{Closest, Region};

/// A 12×12 matrix over the coordinates of a stencil, row `3 i + k` for coordinate k of point i.
pub type Matrix12 = [[f64; 12]; 12];

/// Derivatives of the weights with respect to the free parameters of a region.
fn weight_derivatives(region: Region) -> ([[f64; 4]; 2], usize) {
    let mut rows = [[0.0; 4]; 2];
    match region {
        Region::PointPoint(..) => (rows, 0),
        Region::PointEdge(point, start, end) => {
            // The offset runs from the second feature to the first.
            let sign = if point < start { 1.0 } else { -1.0 };
            rows[0][usize::from(start)] = sign;
            rows[0][usize::from(end)] = -sign;
            (rows, 1)
        }
        Region::PointTriangle => ([[0.0, 1.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]], 2),
        Region::EdgeEdge => ([[-1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]], 2),
    }
}

/// Inverse of `JᵀJ`; zero in directions along which r does not change.
fn inverse_gram(j: [DVec3; 2], count: usize) -> [[f64; 2]; 2] {
    let (a, c) = (j[0].length_squared(), j[1].length_squared());
    if count == 1 || c == 0.0 {
        let inverse = if a > 0.0 { 1.0 / a } else { 0.0 };
        return [[inverse, 0.0], [0.0, 0.0]];
    }
    // |j0 × j1|² loses less than ac − b² when the two are nearly parallel.
    let determinant = j[0].cross(j[1]).length_squared();
    if determinant <= 0.0 {
        let inverse = if a > 0.0 { 1.0 / a } else { 0.0 };
        return [[inverse, 0.0], [0.0, 0.0]];
    }
    let b = j[0].dot(j[1]);
    [
        [c / determinant, -b / determinant],
        [-b / determinant, a / determinant],
    ]
}

/// Hessian of the squared distance of `closest` at the stencil `points` (m); no unit.
///
/// Exact inside each region; between regions the Hessian jumps.
pub fn squared_distance_hessian(closest: &Closest, points: &[DVec3; 4]) -> Matrix12 {
    let weights = &closest.weights;
    let (derivatives, count) = weight_derivatives(closest.region());
    let mut hessian = [[0.0; 12]; 12];
    for i in 0..4 {
        for j in 0..4 {
            for k in 0..3 {
                hessian[3 * i + k][3 * j + k] = 2.0 * weights[i] * weights[j];
            }
        }
    }
    if count == 0 {
        return hessian;
    }
    let mut jacobian = [DVec3::ZERO; 2];
    let mut mixed = [[0.0; 12]; 2];
    for m in 0..count {
        jacobian[m] = (0..4).map(|i| points[i] * derivatives[m][i]).sum();
        for i in 0..4 {
            let block = closest.offset * derivatives[m][i] + jacobian[m] * weights[i];
            mixed[m][3 * i..3 * i + 3].copy_from_slice(&block.to_array());
        }
    }
    let inverse = inverse_gram(jacobian, count);
    for (row, line) in hessian.iter_mut().enumerate() {
        let left = [0, 1].map(|n| mixed[0][row] * inverse[0][n] + mixed[1][row] * inverse[1][n]);
        for (column, entry) in line.iter_mut().enumerate() {
            *entry -= 2.0 * (left[0] * mixed[0][column] + left[1] * mixed[1][column]);
        }
    }
    hessian
}

#[cfg(test)]
mod tests {
    use super::super::distance::{edge_edge, point_triangle};
    use super::super::stencil_cases::{
        self as cases, Points, SCALES, assert_close, difference_rows, flat, moved,
    };
    use super::*;

    /// Compares where the region does not change within the difference; returns how often.
    fn check(points: &Points, scale: f64, closest: impl Fn(&Points) -> Closest) -> usize {
        let step = 1e-6 * scale;
        let here = closest(points);
        let same = (0..12).all(|i| {
            [-step, step]
                .iter()
                .all(|&h| closest(&moved(points, i, h)).region() == here.region())
        });
        if !same {
            return 0;
        }
        let expected = difference_rows(points, step, |x| flat(&closest(x).gradient()));
        let found = squared_distance_hessian(&here, points);
        assert_close(
            found.as_flattened(),
            expected.as_flattened(),
            1.0,
            1e-6,
            &format!("{points:?}"),
        );
        1
    }

    #[test]
    fn hessian_is_the_finite_difference_of_the_gradient() {
        for scale in SCALES {
            let pt = cases::point_triangle(scale);
            let compared: usize = pt
                .iter()
                .map(|x| check(x, scale, |x| point_triangle(x[0], x[1], x[2], x[3])))
                .sum();
            assert!(compared > pt.len() / 2, "{compared} of {}", pt.len());
            let mut compared = 0;
            for points in cases::edge_edge(scale) {
                let [u, v] = [points[1] - points[0], points[3] - points[2]];
                // Closer to parallel the second derivatives grow beyond what differences resolve.
                if u.cross(v).length() > 1e-2 * u.length() * v.length() {
                    compared += check(&points, scale, |x| edge_edge(x[0], x[1], x[2], x[3]));
                }
            }
            assert!(compared > 180, "{compared}");
        }
    }

    #[test]
    fn hessian_is_symmetric_and_finite_where_features_vanish() {
        let a = DVec3::new(0.3, 0.2, 0.1);
        for points in [
            [a; 4],
            [a, DVec3::ZERO, DVec3::X, DVec3::X],
            [a, a, DVec3::X, DVec3::Y],
        ] {
            for closest in [
                point_triangle(points[0], points[1], points[2], points[3]),
                edge_edge(points[0], points[1], points[2], points[3]),
            ] {
                let hessian = squared_distance_hessian(&closest, &points);
                for (i, row) in hessian.iter().enumerate() {
                    for (j, entry) in row.iter().enumerate() {
                        assert!(entry.is_finite());
                        assert!((entry - hessian[j][i]).abs() < 1e-14);
                    }
                }
            }
        }
    }
}
