//! Elastic energy of a gel: mesh, law, and the sums over its elements.

#![allow(
    clippy::needless_range_loop,
    reason = "loops over lanes run through many arrays at once"
)]

use glam::{DMat3, DVec3};

use super::batch::{Batch, PAIRS, WIDTH};
use super::kernel::{self, Blocks};
use super::neo_hookean::{NeoHookean, Projection};
use super::pattern::StiffnessPattern;
use super::projection;
use crate::error::{Error, ErrorKind, Result};

/// Elastic energy of linear tetrahedra as a function of the node positions.
///
/// Positions are in m, one per node; energies in J, gradients in N, Hessians in N/m. Element sums
/// run in a fixed order on one thread, so results do not depend on the machine's load.
#[derive(Clone, Debug)]
pub struct Elastic {
    law: NeoHookean,
    nodes: usize,
    batches: Vec<Batch>,
    pattern: StiffnessPattern,
}

impl Elastic {
    /// From rest positions in m and positively oriented tetrahedra.
    ///
    /// # Errors
    /// `Input` when there is no tetrahedron, one names a node that does not exist or has no
    /// positive finite volume at rest, or the stiffness matrix has 2^32 entries or more.
    pub fn new(rest: &[DVec3], tets: &[[u32; 4]], law: NeoHookean) -> Result<Self> {
        if tets.is_empty() {
            return Err(bad_mesh("no tetrahedra".to_owned()));
        }
        for (t, tet) in tets.iter().enumerate() {
            if let Some(v) = tet.iter().find(|v| **v as usize >= rest.len()) {
                let nodes = rest.len();
                return Err(bad_mesh(format!(
                    "tetrahedron {t} names node {v} of {nodes}"
                )));
            }
            let [a, b, c, d] = tet.map(|v| rest[v as usize]);
            let volume = (b - a).cross(c - a).dot(d - a) / 6.0;
            if !(volume > 0.0 && volume.is_finite()) {
                return Err(bad_mesh(format!(
                    "tetrahedron {t} has volume {volume} m3, expected a positive one"
                )));
            }
        }
        let pattern = StiffnessPattern::new(rest.len(), tets);
        if pattern.entries() > u32::MAX as usize {
            return Err(bad_mesh("2^32 matrix entries or more".to_owned()));
        }
        Ok(Self {
            law,
            nodes: rest.len(),
            batches: Batch::group(tets, rest, &pattern),
            pattern,
        })
    }

    /// The law of the material.
    #[must_use]
    pub fn law(&self) -> &NeoHookean {
        &self.law
    }

    /// Number of nodes: the length of every position and gradient slice.
    #[must_use]
    pub fn nodes(&self) -> usize {
        self.nodes
    }

    /// Sparsity of the Hessian.
    #[must_use]
    pub fn pattern(&self) -> &StiffnessPattern {
        &self.pattern
    }

    /// Energy in J; infinite when an element is flat or inverted, or a position is not finite.
    #[must_use]
    pub fn energy(&self, x: &[DVec3]) -> f64 {
        let mut sums = [0.0; WIDTH];
        for batch in &self.batches {
            let (energies, valid) = kernel::energy(&self.law, batch, &batch.edges(x));
            if !valid {
                return f64::INFINITY;
            }
            add_lanes(&mut sums, &energies);
        }
        total(&sums)
    }

    /// Adds the gradient in N at a state of finite energy to `gradient`.
    pub fn gradient(&self, x: &[DVec3], gradient: &mut [DVec3]) {
        for batch in &self.batches {
            let forces = kernel::gradient(&self.law, batch, &batch.edges(x));
            scatter_forces(batch, &forces, gradient);
        }
    }

    /// [`Elastic::energy`] and [`Elastic::gradient`] at once; what is added for an infinite
    /// energy means nothing.
    pub fn energy_gradient(&self, x: &[DVec3], gradient: &mut [DVec3]) -> f64 {
        let mut sums = [0.0; WIDTH];
        for batch in &self.batches {
            let edges = batch.edges(x);
            let (energies, valid) = kernel::energy(&self.law, batch, &edges);
            if !valid {
                return f64::INFINITY;
            }
            add_lanes(&mut sums, &energies);
            scatter_forces(batch, &kernel::gradient(&self.law, batch, &edges), gradient);
        }
        total(&sums)
    }

    /// Adds the Hessian in N/m at a state of finite energy to `values`, which are laid out by
    /// [`Elastic::pattern`]. Projection acts on each element, so the sum is positive semidefinite.
    pub fn hessian(&self, x: &[DVec3], projection: Projection, values: &mut [f64]) {
        let mut blocks: Blocks = [[[0.0; WIDTH]; 9]; 6];
        for batch in &self.batches {
            let edges = batch.edges(x);
            kernel::hessian(&self.law, batch, &edges, &mut blocks);
            if projection != Projection::None {
                projection::project(&self.law, batch, &edges, projection, &mut blocks);
            }
            scatter_blocks(batch, &blocks, values);
        }
    }

    /// Adds a symmetric block on the diagonal of the Hessian; only its lower triangle is read.
    pub fn add_diagonal_block(&self, node: usize, block: &DMat3, values: &mut [f64]) {
        self.pattern.add_diagonal_block(node, block, values);
    }

    /// Adds a block and its transpose for two nodes of one element; see
    /// [`StiffnessPattern::add_pair_block`].
    pub fn add_pair_block(&self, i: usize, j: usize, block: &DMat3, values: &mut [f64]) -> bool {
        self.pattern.add_pair_block(i, j, block, values)
    }
}

fn bad_mesh(what: String) -> Error {
    Error::new(ErrorKind::Input, format!("tetrahedral mesh: {what}"))
}

#[inline(always)]
fn add_lanes(sums: &mut [f64; WIDTH], terms: &[f64; WIDTH]) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        *sum += term;
    }
}

/// Sum of the lanes; infinite when it is not a number.
fn total(sums: &[f64; WIDTH]) -> f64 {
    let sum: f64 = sums.iter().sum();
    if sum.is_nan() { f64::INFINITY } else { sum }
}

#[inline(always)]
fn scatter_forces(batch: &Batch, forces: &[kernel::Vector; 3], gradient: &mut [DVec3]) {
    for lane in 0..WIDTH {
        let [a, b, c] = [0, 1, 2].map(|i| DVec3::from_array(kernel::at(&forces[i], lane)));
        for (corner, force) in [-(a + b + c), a, b, c].into_iter().enumerate() {
            gradient[batch.nodes[corner][lane] as usize] += force;
        }
    }
}

#[inline(always)]
fn scatter_blocks(batch: &Batch, blocks: &Blocks, values: &mut [f64]) {
    for lane in 0..WIDTH {
        if batch.volume[lane] == 0.0 {
            continue;
        }
        let k = |block: usize| -> [f64; 9] { std::array::from_fn(|e| blocks[block][e][lane]) };
        let inner = [k(0), k(1), k(2), k(3), k(4), k(5)];
        let full = with_first_corner(&inner);
        for corner in 0..4 {
            let start = batch.diagonal_starts[corner][lane] as usize;
            let stride = batch.strides[corner][lane] as usize;
            add_lower(values, start, stride, &full.0[corner]);
        }
        for (pair, (_, low)) in PAIRS.into_iter().enumerate() {
            let start = batch.pair_starts[pair][lane] as usize;
            let stride = batch.strides[low][lane] as usize;
            add_block(values, start, stride, &full.1[pair]);
        }
    }
}

/// Blocks of all four corners: corner 0 balances the others, as a translation costs nothing.
#[inline(always)]
fn with_first_corner(k: &[[f64; 9]; 6]) -> ([[f64; 9]; 4], [[f64; 9]; 6]) {
    let transposed = |m: &[f64; 9]| [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
    let minus = |a: &[f64; 9], b: &[f64; 9], c: &[f64; 9]| -> [f64; 9] {
        std::array::from_fn(|e| -(a[e] + b[e] + c[e]))
    };
    let [k11, k22, k33, k21, k31, k32] = k;
    let k10 = minus(k11, &transposed(k21), &transposed(k31));
    let k20 = minus(k21, k22, &transposed(k32));
    let k30 = minus(k31, k32, k33);
    let k00 = minus(&k10, &k20, &k30);
    ([k00, *k11, *k22, *k33], [k10, k20, k30, *k21, *k31, *k32])
}

#[inline(always)]
fn add_lower(values: &mut [f64], start: usize, stride: usize, block: &[f64; 9]) {
    for (axis, shorter) in [0, 0, 1].into_iter().enumerate() {
        let at = start + axis * stride - shorter;
        for (value, entry) in values[at..at + 3 - axis].iter_mut().zip(&block[4 * axis..]) {
            *value += entry;
        }
    }
}

#[inline(always)]
fn add_block(values: &mut [f64], start: usize, stride: usize, block: &[f64; 9]) {
    for (axis, shorter) in [0, 1, 3].into_iter().enumerate() {
        let at = start + axis * stride - shorter;
        for (value, entry) in values[at..at + 3]
            .iter_mut()
            .zip(&block[3 * axis..3 * axis + 3])
        {
            *value += entry;
        }
    }
}

#[cfg(test)]
#[path = "elastic_test.rs"]
mod tests;
