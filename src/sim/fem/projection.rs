//! Positive semidefinite element Hessians of a group, by adding their negative modes back.
//!
//! With F = U diag(s) V^T and c = lambda ln J - mu the only negative eigenvalues while c <= 0 are
//! those of the three twists, mu + c / (s_i s_j); for c > 0 they are those of the flips,
//! mu - c / (s_i s_j), and perhaps of the stretches, which are rare and done one by one.

#![allow(
    clippy::needless_range_loop,
    reason = "loops over lanes run through many arrays at once"
)]

use glam::{DMat3, DVec3};

use super::batch::{Batch, Lanes, WIDTH};
use super::kernel::{Blocks, Vector, at, cross, dot, ln};
use super::neo_hookean::{NeoHookean, Projection};
use super::svd::svd;

/// Adds to `blocks` what turns their negative eigenvalues to zero or positive.
#[inline(always)]
pub(super) fn project(
    law: &NeoHookean,
    batch: &Batch,
    edges: &[Vector; 3],
    projection: Projection,
    blocks: &mut Blocks,
) {
    let f = deformation(batch, edges);
    let (g, v) = orthogonal_columns(&f);
    let (weights, slope) = shear_weights(law, batch, edges, &g, projection.factor());
    if weights.iter().flatten().any(|w| *w > 0.0) {
        for (k, (p, q)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
            let modes = shear_modes(batch, &g, &v, &slope, p, q);
            add_modes(&weights[k], &modes, blocks);
        }
    }
    for lane in 0..WIDTH {
        if slope[lane] > 0.0 && batch.volume[lane] > 0.0 {
            add_stretches(law, batch, &f, lane, projection, blocks);
        }
    }
}

/// Columns of F.
#[inline(always)]
fn deformation(batch: &Batch, edges: &[Vector; 3]) -> [Vector; 3] {
    let mut f = [[[0.0; WIDTH]; 3]; 3];
    for column in 0..3 {
        for row in 0..3 {
            for l in 0..WIDTH {
                f[column][row][l] = edges[0][row][l] * batch.shape[0][column][l]
                    + edges[1][row][l] * batch.shape[1][column][l]
                    + edges[2][row][l] * batch.shape[2][column][l];
            }
        }
    }
    f
}

/// F V with orthogonal columns, and V, by one-sided Jacobi rotations of all elements at once.
#[inline(always)]
fn orthogonal_columns(f: &[Vector; 3]) -> ([Vector; 3], [Vector; 3]) {
    let mut g = *f;
    let mut v = [[[0.0; WIDTH]; 3]; 3];
    for (axis, column) in v.iter_mut().enumerate() {
        column[axis] = [1.0; WIDTH];
    }
    for _ in 0..10 {
        let mut skew = [0.0; WIDTH];
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            rotate(&mut g, &mut v, p, q, &mut skew);
        }
        if skew.iter().all(|s| *s < 1e-15) {
            break;
        }
    }
    (g, v)
}

/// Makes columns p and q of g orthogonal; `skew` keeps the largest squared cosine found.
#[inline(always)]
fn rotate(g: &mut [Vector; 3], v: &mut [Vector; 3], p: usize, q: usize, skew: &mut Lanes) {
    for l in 0..WIDTH {
        let (x, y) = (at(&g[p], l), at(&g[q], l));
        let (a, b, c2) = (dot(x, x), dot(y, y), 2.0 * dot(x, y));
        let d = b - a;
        let t = c2.copysign(c2 * d) / (d.abs() + (d * d + c2 * c2).sqrt() + f64::MIN_POSITIVE);
        let cos = 1.0 / (1.0 + t * t).sqrt();
        let sin = cos * t;
        let (vx, vy) = (at(&v[p], l), at(&v[q], l));
        for axis in 0..3 {
            g[p][axis][l] = cos * x[axis] - sin * y[axis];
            g[q][axis][l] = sin * x[axis] + cos * y[axis];
            v[p][axis][l] = cos * vx[axis] - sin * vy[axis];
            v[q][axis][l] = sin * vx[axis] + cos * vy[axis];
        }
        let cosine2 = c2 * c2 / (a * b);
        skew[l] = if cosine2 > skew[l] { cosine2 } else { skew[l] };
    }
}

/// Weight in N m of the three shear modes, halved for their length, and c.
#[inline(always)]
fn shear_weights(
    law: &NeoHookean,
    batch: &Batch,
    edges: &[Vector; 3],
    g: &[Vector; 3],
    factor: f64,
) -> ([Lanes; 3], Lanes) {
    let mut weights = [[0.0; WIDTH]; 3];
    let mut slope = [0.0; WIDTH];
    for l in 0..WIDTH {
        let det = dot(cross(at(&edges[0], l), at(&edges[1], l)), at(&edges[2], l));
        slope[l] = law.lambda() * ln(det * batch.inverse_det[l]) - law.mu();
        let s = [0, 1, 2].map(|i| dot(at(&g[i], l), at(&g[i], l)));
        for (k, (p, q)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
            let eigenvalue = law.mu() - slope[l].abs() / (s[p] * s[q]).sqrt();
            let negative = if eigenvalue < 0.0 { -eigenvalue } else { 0.0 };
            weights[k][l] = 0.5 * factor * batch.volume[l] * negative;
        }
    }
    (weights, slope)
}

/// Displacements of corners 1 to 3 in mode u_p v_q^T + sign(c) u_q v_p^T, times grad N_i.
#[inline(always)]
fn shear_modes(
    batch: &Batch,
    g: &[Vector; 3],
    v: &[Vector; 3],
    slope: &Lanes,
    p: usize,
    q: usize,
) -> [Vector; 3] {
    let mut modes = [[[0.0; WIDTH]; 3]; 3];
    for l in 0..WIDTH {
        let (gp, gq) = (at(&g[p], l), at(&g[q], l));
        let inverse_p = 1.0 / dot(gp, gp).sqrt();
        let inverse_q = 1.0f64.copysign(slope[l]) / dot(gq, gq).sqrt();
        for corner in 0..3 {
            let shape = at(&batch.shape[corner], l);
            let along_q = dot(at(&v[q], l), shape) * inverse_p;
            let along_p = dot(at(&v[p], l), shape) * inverse_q;
            for axis in 0..3 {
                modes[corner][axis][l] = gp[axis] * along_q + gq[axis] * along_p;
            }
        }
    }
    modes
}

/// Adds weight m_i m_j^T to each block of corners (i, j).
#[inline(always)]
fn add_modes(weight: &Lanes, modes: &[Vector; 3], blocks: &mut Blocks) {
    for (k, (i, j)) in [(0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1)]
        .into_iter()
        .enumerate()
    {
        for column in 0..3 {
            for row in 0..3 {
                for l in 0..WIDTH {
                    blocks[k][3 * column + row][l] +=
                        weight[l] * modes[i][row][l] * modes[j][column][l];
                }
            }
        }
    }
}

/// The stretch modes of one element.
#[cold]
fn add_stretches(
    law: &NeoHookean,
    batch: &Batch,
    f: &[Vector; 3],
    lane: usize,
    projection: Projection,
    blocks: &mut Blocks,
) {
    let [x, y, z] = [0, 1, 2].map(|c| DVec3::from_array(at(&f[c], lane)));
    let modes = svd(&DMat3::from_cols(x, y, z));
    for (weight, mode) in law.scaling_corrections(&modes, projection) {
        let mut weights = [0.0; WIDTH];
        weights[lane] = weight * batch.volume[lane];
        let mut moves = [[[0.0; WIDTH]; 3]; 3];
        for (corner, motion) in moves.iter_mut().enumerate() {
            let along = mode * DVec3::from_array(at(&batch.shape[corner], lane));
            for axis in 0..3 {
                motion[axis][lane] = along[axis];
            }
        }
        add_modes(&weights, &moves, blocks);
    }
}
