//! Energy, gradient and Hessian of a group of elements from their current edges.
//!
//! With edges e_i from corner 0 and rest shape gradients g_i, F = sum e_i g_i^T. Hence
//! tr F^T F = sum (g_i . g_j) e_i . e_j, J = det(e) / det(e at rest) and
//! d ln J / d x_i = (e_j x e_k) / det(e): neither F nor its inverse is needed.

#![allow(
    clippy::needless_range_loop,
    reason = "loops over lanes run through many arrays at once"
)]

use super::batch::{Batch, Lanes, WIDTH};
use super::neo_hookean::NeoHookean;

pub(super) type Vector = [Lanes; 3];

/// The vector of one element.
#[inline(always)]
pub(super) fn at(v: &Vector, lane: usize) -> [f64; 3] {
    [v[0][lane], v[1][lane], v[2][lane]]
}

#[inline(always)]
pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(super) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Branch-free natural logarithm of a normal positive number, accurate to 2 ulp.
///
/// x = 2^k m with m in [sqrt(1/2), sqrt(2)), ln m = 2 artanh((m - 1) / (m + 1)) by its series.
#[inline(always)]
pub(super) fn ln(x: f64) -> f64 {
    const SQRT_HALF: u64 = 0x3fe6_a09e_667f_3bcd;
    const ONE: u64 = 0x3ff0_0000_0000_0000;
    const TWO_52: u64 = 0x4330_0000_0000_0000;
    let shifted = x.to_bits().wrapping_add(ONE - SQRT_HALF);
    // The exponent, read as an integer below 2^52 in the mantissa of 2^52.
    let exponent = f64::from_bits((shifted >> 52) | TWO_52) - (4_503_599_627_370_496.0 + 1023.0);
    let m = f64::from_bits((shifted & 0x000f_ffff_ffff_ffff) + SQRT_HALF);
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let mut series = 2.0 / 23.0;
    for k in [21, 19, 17, 15, 13, 11, 9, 7, 5, 3] {
        series = series * z + 2.0 / f64::from(k);
    }
    exponent * std::f64::consts::LN_2 + (2.0 * s + s * z * series)
}

/// Energies of the elements in J; false if one is inverted, whose energy is then meaningless.
#[inline(always)]
pub(super) fn energy(law: &NeoHookean, batch: &Batch, edges: &[Vector; 3]) -> (Lanes, bool) {
    let (mu, lambda) = (law.mu(), law.lambda());
    let mut energies = [0.0; WIDTH];
    let mut smallest = [0.0; WIDTH];
    let m = &batch.metric;
    for l in 0..WIDTH {
        let (a, b, c) = (at(&edges[0], l), at(&edges[1], l), at(&edges[2], l));
        let j = dot(cross(a, b), c) * batch.inverse_det[l];
        let squares = m[0][l] * dot(a, a) + m[3][l] * dot(b, b) + m[5][l] * dot(c, c);
        let products = m[1][l] * dot(a, b) + m[2][l] * dot(a, c) + m[4][l] * dot(b, c);
        let log_j = ln(j);
        let volumetric = log_j * (0.5 * lambda * log_j - mu) - 1.5 * mu;
        energies[l] = mu * (0.5 * squares + products) + batch.volume[l] * volumetric;
        smallest[l] = j;
    }
    let valid = smallest
        .iter()
        .fold(true, |ok, j| ok & (*j >= f64::MIN_POSITIVE));
    (energies, valid)
}

/// Gradients in N on corners 1 to 3; that of corner 0 is minus their sum.
#[inline(always)]
pub(super) fn gradient(law: &NeoHookean, batch: &Batch, edges: &[Vector; 3]) -> [Vector; 3] {
    let (mu, lambda) = (law.mu(), law.lambda());
    let mut g = [[[0.0; WIDTH]; 3]; 3];
    let m = &batch.metric;
    for l in 0..WIDTH {
        let (a, b, c) = (at(&edges[0], l), at(&edges[1], l), at(&edges[2], l));
        let (ab, bc, ca) = (cross(a, b), cross(b, c), cross(c, a));
        let det = dot(ab, c);
        let slope = lambda * ln(det * batch.inverse_det[l]) - mu;
        let k = batch.volume[l] * slope / det;
        for axis in 0..3 {
            let (x, y, z) = (mu * a[axis], mu * b[axis], mu * c[axis]);
            g[0][axis][l] = m[0][l] * x + m[1][l] * y + m[2][l] * z + k * bc[axis];
            g[1][axis][l] = m[1][l] * x + m[3][l] * y + m[4][l] * z + k * ca[axis];
            g[2][axis][l] = m[2][l] * x + m[4][l] * y + m[5][l] * z + k * ab[axis];
        }
    }
    g
}

/// Hessian blocks of a group in N/m.
#[derive(Clone, Debug)]
pub(super) struct Blocks {
    /// Lower triangles on the diagonal by corner, columns one after the other.
    pub(super) diagonal: [[Lanes; 6]; 4],
    /// Blocks of [`super::batch::PAIRS`], rows of the higher corner: entry 3 column + row.
    pub(super) pairs: [[Lanes; 9]; 6],
}

impl Blocks {
    pub(super) const ZERO: Self = Self {
        diagonal: [[[0.0; WIDTH]; 6]; 4],
        pairs: [[[0.0; WIDTH]; 9]; 6],
    };
}

/// Row and column of the entries of a lower triangle.
pub(super) const LOWER: [(usize, usize); 6] = [(0, 0), (1, 0), (2, 0), (1, 1), (2, 1), (2, 2)];

/// Entry 3 column + row of a symmetric block in its lower triangle.
const FROM_LOWER: [usize; 9] = [0, 1, 2, 1, 3, 4, 2, 4, 5];

/// Entry 3 row + column for entry 3 column + row.
const TRANSPOSED: [usize; 9] = [0, 3, 6, 1, 4, 7, 2, 5, 8];

/// The pairs among corners 1 to 3: index in [`Blocks::pairs`], higher and lower corner minus one.
const INNER: [(usize, usize, usize); 3] = [(3, 1, 0), (4, 2, 0), (5, 2, 1)];

/// Exact Hessian blocks of corners 1 to 3.
#[inline(always)]
pub(super) fn hessian(law: &NeoHookean, batch: &Batch, edges: &[Vector; 3], out: &mut Blocks) {
    let (mu, m) = (law.mu(), &batch.metric);
    let (normals, curvature, twist) = bending(law, batch, edges);
    for (corner, metric) in [(0, &m[0]), (1, &m[3]), (2, &m[5])] {
        let q = &normals[corner];
        for (e, (row, column)) in LOWER.into_iter().enumerate() {
            let straight = if row == column { mu } else { 0.0 };
            for l in 0..WIDTH {
                out.diagonal[corner + 1][e][l] =
                    curvature[l] * q[row][l] * q[column][l] + straight * metric[l];
            }
        }
    }
    for ((pair, high, low), metric) in INNER.into_iter().zip([&m[1], &m[2], &m[4]]) {
        let block = &mut out.pairs[pair];
        let (p, q) = (&normals[high], &normals[low]);
        for column in 0..3 {
            for row in 0..3 {
                let straight = if row == column { mu } else { 0.0 };
                for l in 0..WIDTH {
                    block[3 * column + row][l] =
                        curvature[l] * p[row][l] * q[column][l] + straight * metric[l];
                }
            }
        }
    }
    for (pair, edge, sign) in [(3, 2, 1.0), (4, 1, -1.0), (5, 0, 1.0)] {
        add_cross(&mut out.pairs[pair], &edges[edge], &twist, sign);
    }
}

/// The vectors e_j x e_k = det d ln J / d x_i, and the factors of their products and of the edges.
#[inline(always)]
fn bending(law: &NeoHookean, batch: &Batch, edges: &[Vector; 3]) -> ([Vector; 3], Lanes, Lanes) {
    let (mu, lambda) = (law.mu(), law.lambda());
    let mut normals = [[[0.0; WIDTH]; 3]; 3];
    let (mut curvature, mut twist) = ([0.0; WIDTH], [0.0; WIDTH]);
    for l in 0..WIDTH {
        let (a, b, c) = (at(&edges[0], l), at(&edges[1], l), at(&edges[2], l));
        let (ab, bc, ca) = (cross(a, b), cross(b, c), cross(c, a));
        let det = dot(ab, c);
        let slope = lambda * ln(det * batch.inverse_det[l]) - mu;
        curvature[l] = batch.volume[l] * (lambda - slope) / (det * det);
        twist[l] = batch.volume[l] * slope / det;
        for axis in 0..3 {
            normals[0][axis][l] = bc[axis];
            normals[1][axis][l] = ca[axis];
            normals[2][axis][l] = ab[axis];
        }
    }
    (normals, curvature, twist)
}

/// Adds sign * twist * the cross product matrix of an edge.
#[inline(always)]
fn add_cross(block: &mut [Lanes; 9], edge: &Vector, twist: &Lanes, sign: f64) {
    for (entry, axis, sign) in [
        (1, 2, sign),
        (2, 1, -sign),
        (3, 2, -sign),
        (5, 0, sign),
        (6, 1, sign),
        (7, 0, -sign),
    ] {
        for l in 0..WIDTH {
            block[entry][l] += sign * twist[l] * edge[axis][l];
        }
    }
}

/// Adds weight m_i m_j^T to the block of each pair of corners i, j in 1 to 3.
#[inline(always)]
pub(super) fn add_outer(weight: &Lanes, m: &[Vector; 3], out: &mut Blocks) {
    for corner in 0..3 {
        for (e, (row, column)) in LOWER.into_iter().enumerate() {
            for l in 0..WIDTH {
                out.diagonal[corner + 1][e][l] +=
                    weight[l] * m[corner][row][l] * m[corner][column][l];
            }
        }
    }
    for (pair, high, low) in INNER {
        for column in 0..3 {
            for row in 0..3 {
                for l in 0..WIDTH {
                    out.pairs[pair][3 * column + row][l] +=
                        weight[l] * m[high][row][l] * m[low][column][l];
                }
            }
        }
    }
}

/// Blocks of corner 0 from the others: translation invariance makes block rows sum to zero.
#[inline(always)]
pub(super) fn balance(out: &mut Blocks) {
    let [_, k11, k22, k33] = out.diagonal;
    let [.., k21, k31, k32] = out.pairs;
    for e in 0..9 {
        let (t, s) = (TRANSPOSED[e], FROM_LOWER[e]);
        for l in 0..WIDTH {
            out.pairs[0][e][l] = -(k11[s][l] + k21[t][l] + k31[t][l]);
            out.pairs[1][e][l] = -(k21[e][l] + k22[s][l] + k32[t][l]);
            out.pairs[2][e][l] = -(k31[e][l] + k32[e][l] + k33[s][l]);
        }
    }
    let [k10, k20, k30, ..] = &out.pairs;
    for (e, (row, column)) in LOWER.into_iter().enumerate() {
        let e9 = 3 * column + row;
        for l in 0..WIDTH {
            out.diagonal[0][e][l] = -(k10[e9][l] + k20[e9][l] + k30[e9][l]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithm_matches_std() {
        let near_one = (-40..40).map(|k| 1.0 + f64::from(k) * 1e-9);
        let wide = (-3000..3000).map(|k| (f64::from(k) * 0.2).exp2());
        let edges = [
            0.5_f64.sqrt(),
            2.0_f64.sqrt(),
            0.999_999_999_999,
            1e-300,
            1e300,
        ];
        for x in near_one.chain(wide).chain(edges) {
            let (found, expected) = (ln(x), x.ln());
            assert!(
                (found - expected).abs() <= 4.5e-16 * expected.abs(),
                "{x}: {found} {expected}"
            );
        }
        assert_eq!(ln(1.0), 0.0);
    }
}
