//! Projects the element Hessians of a group to positive semidefinite, by correcting negative modes.
//!
//! With F = U diag(s) V^T and c = lambda ln J - mu the only negative eigenvalues while c <= 0 are
//! those of the three twists, mu + c / (s_i s_j); for c > 0 they are those of the flips,
//! mu - c / (s_i s_j), and possibly of the stretches, which are rare and handled one by one.

#![allow(
    clippy::needless_range_loop,
    reason = "loops over lanes run through many arrays at once"
)]

use glam::{DMat3, DVec3};

use super::batch::{Batch, Lanes, WIDTH};
use super::kernel::{Blocks, Vector, add_outer, at, cross, dot, ln};
use super::neo_hookean::{NeoHookean, Projection};
use super::svd::svd;

/// Maximum number of Jacobi sweeps; four or five are typical.
const MAX_SWEEPS: usize = 10;

/// Squared cosine between columns at which the sweeps end.
const SMALL_SKEW: f64 = 1e-14;

/// Singular directions of the three shear modes.
const SHEARS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// Adds the corrections of negative eigenvalues to `blocks`.
#[inline(always)]
pub(super) fn project(
    law: &NeoHookean,
    batch: &Batch,
    edges: &[Vector; 3],
    projection: Projection,
    blocks: &mut Blocks,
) {
    let f = deformation(batch, edges);
    let (mut u, v) = orthogonal_columns(&f);
    let sigma = normalise(&mut u);
    let (weights, slope) = shear_weights(law, batch, edges, &sigma, projection.factor());
    if weights
        .iter()
        .flatten()
        .fold(false, |any, w| any | (*w > 0.0))
    {
        for (weight, (p, q)) in weights.iter().zip(SHEARS) {
            let modes = shear_modes(batch, [&u[p], &u[q]], [&v[p], &v[q]], &slope);
            add_outer(weight, &modes, blocks);
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
    let [mut g0, mut g1, mut g2] = *f;
    let (none, one) = ([0.0; WIDTH], [1.0; WIDTH]);
    let (mut v0, mut v1, mut v2) = ([one, none, none], [none, one, none], [none, none, one]);
    for _ in 0..MAX_SWEEPS {
        let mut skew = [0.0; WIDTH];
        rotate(&mut g0, &mut g1, &mut v0, &mut v1, &mut skew);
        rotate(&mut g0, &mut g2, &mut v0, &mut v2, &mut skew);
        rotate(&mut g1, &mut g2, &mut v1, &mut v2, &mut skew);
        if skew.iter().fold(true, |done, s| done & (*s < SMALL_SKEW)) {
            break;
        }
    }
    ([g0, g1, g2], [v0, v1, v2])
}

/// Makes two columns of F V orthogonal; `skew` keeps the largest squared cosine found.
#[inline(always)]
fn rotate(gp: &mut Vector, gq: &mut Vector, vp: &mut Vector, vq: &mut Vector, skew: &mut Lanes) {
    for l in 0..WIDTH {
        let (x, y) = (at(gp, l), at(gq, l));
        let (a, b, c2) = (dot(x, x), dot(y, y), 2.0 * dot(x, y));
        let d = b - a;
        let t = c2.copysign(c2 * d) / (d.abs() + (d * d + c2 * c2).sqrt() + f64::MIN_POSITIVE);
        let cos = 1.0 / (1.0 + t * t).sqrt();
        let sin = cos * t;
        let (vx, vy) = (at(vp, l), at(vq, l));
        for axis in 0..3 {
            gp[axis][l] = cos * x[axis] - sin * y[axis];
            gq[axis][l] = sin * x[axis] + cos * y[axis];
            vp[axis][l] = cos * vx[axis] - sin * vy[axis];
            vq[axis][l] = sin * vx[axis] + cos * vy[axis];
        }
        let cosine2 = c2 * c2 / (a * b);
        skew[l] = if cosine2 > skew[l] { cosine2 } else { skew[l] };
    }
}

/// Normalises columns; returns their lengths.
#[inline(always)]
fn normalise(columns: &mut [Vector; 3]) -> [Lanes; 3] {
    let mut lengths = [[0.0; WIDTH]; 3];
    for (column, length) in columns.iter_mut().zip(&mut lengths) {
        for l in 0..WIDTH {
            let v = at(column, l);
            length[l] = dot(v, v).sqrt();
            for axis in 0..3 {
                column[axis][l] = v[axis] / length[l];
            }
        }
    }
    lengths
}

/// Weight in N m of the three shear modes, halved for their length, and c.
#[inline(always)]
fn shear_weights(
    law: &NeoHookean,
    batch: &Batch,
    edges: &[Vector; 3],
    sigma: &[Lanes; 3],
    factor: f64,
) -> ([Lanes; 3], Lanes) {
    let mut weights = [[0.0; WIDTH]; 3];
    let mut slope = [0.0; WIDTH];
    for l in 0..WIDTH {
        let det = dot(cross(at(&edges[0], l), at(&edges[1], l)), at(&edges[2], l));
        slope[l] = law.lambda() * ln(det * batch.inverse_det[l]) - law.mu();
    }
    for (weight, (p, q)) in weights.iter_mut().zip(SHEARS) {
        for l in 0..WIDTH {
            let eigenvalue = law.mu() - slope[l].abs() / (sigma[p][l] * sigma[q][l]);
            let negative = if eigenvalue < 0.0 { -eigenvalue } else { 0.0 };
            weight[l] = 0.5 * factor * batch.volume[l] * negative;
        }
    }
    (weights, slope)
}

/// Displacements of corners 1 to 3 in mode u_p v_q^T + sign(c) u_q v_p^T, times grad N_i.
#[inline(always)]
fn shear_modes(batch: &Batch, u: [&Vector; 2], v: [&Vector; 2], slope: &Lanes) -> [Vector; 3] {
    let mut modes = [[[0.0; WIDTH]; 3]; 3];
    for (shape, mode) in batch.shape.iter().zip(&mut modes) {
        for l in 0..WIDTH {
            let shape = at(shape, l);
            let along_q = dot(at(v[1], l), shape);
            let along_p = dot(at(v[0], l), shape) * 1.0_f64.copysign(slope[l]);
            for axis in 0..3 {
                mode[axis][l] = u[0][axis][l] * along_q + u[1][axis][l] * along_p;
            }
        }
    }
    modes
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
        add_outer(&weights, &moves, blocks);
    }
}
