//! Energy, gradient and Hessian of a group of elements in terms of their current edges.
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

/// A vector's three numbers of one element.
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

/// Natural logarithm of a normal positive number, to 2 units in the last place, without branches.
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

/// Energies in J of the elements. False when one is inverted; its energy then means nothing.
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

/// Hessian blocks in N/m over corners 1 to 3: 11, 22, 33, 21, 31, 32, each as entry 3 column + row.
pub(super) type Blocks = [[Lanes; 9]; 6];

/// Exact Hessian blocks.
#[inline(always)]
pub(super) fn hessian(law: &NeoHookean, batch: &Batch, edges: &[Vector; 3], out: &mut Blocks) {
    let (mu, lambda) = (law.mu(), law.lambda());
    let m = &batch.metric;
    for l in 0..WIDTH {
        let (a, b, c) = (at(&edges[0], l), at(&edges[1], l), at(&edges[2], l));
        let (ab, bc, ca) = (cross(a, b), cross(b, c), cross(c, a));
        let det = dot(ab, c);
        let slope = lambda * ln(det * batch.inverse_det[l]) - mu;
        let curvature = batch.volume[l] * (lambda - slope) / (det * det);
        let turn = batch.volume[l] * slope / det;
        let q = [bc, ca, ab];
        let metric = [m[0][l], m[3][l], m[5][l], m[1][l], m[2][l], m[4][l]];
        for (k, (i, j)) in [(0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1)]
            .into_iter()
            .enumerate()
        {
            for column in 0..3 {
                for row in 0..3 {
                    out[k][3 * column + row][l] = curvature * q[i][row] * q[j][column];
                }
                out[k][4 * column][l] += mu * metric[k];
            }
        }
        for (k, axis, sign) in [(3, c, 1.0), (4, b, -1.0), (5, a, 1.0)] {
            let [x, y, z] = axis.map(|w| sign * turn * w);
            out[k][1][l] += z;
            out[k][2][l] -= y;
            out[k][3][l] -= z;
            out[k][5][l] += x;
            out[k][6][l] += y;
            out[k][7][l] -= x;
        }
    }
}
