//! Sums over the elements: energy, gradient and Hessian of the mesh.
//!
//! Each sum is compiled for several instruction sets and dispatched at run time. All perform the
//! same operations in the same order, so their results are bit-identical.

#![allow(
    clippy::needless_range_loop,
    reason = "loops over lanes run through many arrays at once"
)]

use glam::DVec3;
use pulp::{Simd, WithSimd};

use super::batch::{Batch, Lanes, PAIRS, WIDTH};
use super::kernel::{self, Blocks};
use super::neo_hookean::{NeoHookean, Projection};
use super::projection;

/// Elements of a sum.
#[derive(Clone, Copy)]
pub(super) struct Elements<'a> {
    pub(super) law: &'a NeoHookean,
    pub(super) batches: &'a [Batch],
}

/// Energy in J, infinite for an inverted element.
pub(super) struct EnergySum<'a> {
    pub(super) elements: Elements<'a>,
    pub(super) x: &'a [DVec3],
}

impl WithSimd for EnergySum<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let mut sums = [0.0; WIDTH];
        for batch in self.elements.batches {
            let (energies, valid) = kernel::energy(self.elements.law, batch, &batch.edges(self.x));
            if !valid {
                return f64::INFINITY;
            }
            add_lanes(&mut sums, &energies);
        }
        total(&sums)
    }
}

/// Adds the gradient in N.
pub(super) struct GradientSum<'a> {
    pub(super) elements: Elements<'a>,
    pub(super) x: &'a [DVec3],
    pub(super) gradient: &'a mut [DVec3],
}

impl WithSimd for GradientSum<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for batch in self.elements.batches {
            let forces = kernel::gradient(self.elements.law, batch, &batch.edges(self.x));
            scatter_forces(batch, &forces, self.gradient);
        }
    }
}

/// Adds the Hessian in N/m to the values of the pattern.
pub(super) struct HessianSum<'a> {
    pub(super) elements: Elements<'a>,
    pub(super) x: &'a [DVec3],
    pub(super) projection: Projection,
    pub(super) values: &'a mut [f64],
}

impl WithSimd for HessianSum<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let law = self.elements.law;
        let mut blocks = Blocks::ZERO;
        for batch in self.elements.batches {
            let edges = batch.edges(self.x);
            kernel::hessian(law, batch, &edges, &mut blocks);
            if self.projection != Projection::None {
                projection::project(law, batch, &edges, self.projection, &mut blocks);
            }
            kernel::balance(&mut blocks);
            scatter_blocks(batch, &blocks, self.values);
        }
    }
}

#[inline(always)]
fn add_lanes(sums: &mut [f64; WIDTH], terms: &[f64; WIDTH]) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        *sum += term;
    }
}

/// Sum of the lanes; infinite if NaN.
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
        for corner in 0..4 {
            let start = batch.diagonal_starts[corner][lane] as usize;
            let stride = batch.strides[corner][lane] as usize;
            add_lower(values, start, stride, &blocks.diagonal[corner], lane);
        }
        for (pair, (_, low)) in PAIRS.into_iter().enumerate() {
            let start = batch.pair_starts[pair][lane] as usize;
            let stride = batch.strides[low][lane] as usize;
            add_block(values, start, stride, &blocks.pairs[pair], lane);
        }
    }
}

/// Adds a lower triangle; in each next column the block starts one entry further down.
#[inline(always)]
fn add_lower(values: &mut [f64], start: usize, stride: usize, block: &[Lanes; 6], lane: usize) {
    let column = &mut values[start..start + 3];
    column[0] += block[0][lane];
    column[1] += block[1][lane];
    column[2] += block[2][lane];
    let column = &mut values[start + stride..start + stride + 2];
    column[0] += block[3][lane];
    column[1] += block[4][lane];
    values[start + 2 * stride - 1] += block[5][lane];
}

/// Adds a block below the diagonal; the diagonal block above it shortens each next column.
#[inline(always)]
fn add_block(values: &mut [f64], start: usize, stride: usize, block: &[Lanes; 9], lane: usize) {
    for (axis, shorter) in [0, 1, 3].into_iter().enumerate() {
        let first = start + axis * stride - shorter;
        let column = &mut values[first..first + 3];
        column[0] += block[3 * axis][lane];
        column[1] += block[3 * axis + 1][lane];
        column[2] += block[3 * axis + 2][lane];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::pattern::StiffnessPattern;
    use crate::fem::{GelPad, GelResolution};
    use pulp::Arch;

    /// Without SIMD on this machine both are the same.
    #[test]
    fn simd_is_bit_identical_to_scalar() {
        let grid = GelPad::default().grid(GelResolution::Coarse).unwrap();
        let law = NeoHookean::new(1e6, 0.3).unwrap();
        let pattern = StiffnessPattern::new(grid.positions().len(), grid.tets());
        let batches = Batch::group(grid.tets(), grid.positions(), &pattern);
        let elements = Elements {
            law: &law,
            batches: &batches,
        };
        let wave = |p: &DVec3| *p * (0.8 + 0.1 * (500.0 * p.x + 900.0 * p.y).sin());
        let x: Vec<DVec3> = grid.positions().iter().map(wave).collect();
        let all = |arch: Arch| {
            let mut gradient = vec![DVec3::ZERO; x.len()];
            let mut values = pattern.zeros();
            let x = &x[..];
            let energy = arch.dispatch(EnergySum { elements, x });
            let gradient = &mut gradient[..];
            arch.dispatch(GradientSum {
                elements,
                x,
                gradient,
            });
            arch.dispatch(HessianSum {
                elements,
                x,
                projection: Projection::Abs,
                values: &mut values,
            });
            let gradient: Vec<u64> = gradient
                .iter()
                .flat_map(|g| g.to_array())
                .map(f64::to_bits)
                .collect();
            let values: Vec<u64> = values.into_iter().map(f64::to_bits).collect();
            (energy.to_bits(), gradient, values)
        };
        assert!(all(Arch::new()) == all(Arch::Scalar));
    }
}
