//! Sparse Cholesky factor of one gel's stiffness: faer's supernodal factorisation with a symbolic
//! part computed once, and separate triangular solves.
//!
//! `P K Pᵀ = L Lᵀ`. The Schur complement on the object's 12 unknowns costs 12 forward substitutions
//! per factorisation and one forward and one back substitution per iteration. The latter two are
//! bound by the memory bandwidth for L and only have to give a descent direction, so they use a
//! copy in single precision.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Par, Side};

use gripcast_base::error::{Error, Result};

/// The matrix is not positive definite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NotPositiveDefinite;

/// One dense block column of L: `columns` columns from `start`, first the triangle, then the rows
/// of `pattern`; column-major at `values[offset..]`.
#[derive(Clone, Copy, Debug)]
struct Supernode {
    start: usize,
    columns: usize,
    offset: usize,
    pattern: (usize, usize),
}

/// Factor of a symmetric positive definite matrix of a fixed sparsity pattern.
pub(super) struct GelFactor {
    symbolic: SymbolicCholesky<usize>,
    column_pointers: Vec<usize>,
    row_indices: Vec<usize>,
    /// Row of the matrix behind each row of the factor.
    permutation: Vec<usize>,
    supernodes: Vec<Supernode>,
    patterns: Vec<u32>,
    values: Vec<f64>,
    inverse_diagonal: Vec<f64>,
    /// `values` and `inverse_diagonal` in single precision.
    single: Vec<f32>,
    single_inverse_diagonal: Vec<f32>,
    memory: MemBuffer,
}

impl std::fmt::Debug for GelFactor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GelFactor")
            .field("unknowns", &self.len())
            .field("entries", &self.entries())
            .finish_non_exhaustive()
    }
}

impl GelFactor {
    /// Symbolic factorisation of a pattern: lower triangle, compressed columns, rows ascending.
    ///
    /// # Errors
    /// `Internal` for an invalid pattern.
    pub(super) fn new(column_pointers: &[usize], row_indices: &[usize]) -> Result<Self> {
        let n = column_pointers.len().saturating_sub(1);
        let defect = |what: &str| Error::internal(what.to_owned());
        let pattern =
            SymbolicSparseColMatRef::new_checked(n, n, column_pointers, None, row_indices);
        let parameters = CholeskySymbolicParams {
            // Negative: supernodal also for a matrix without fill.
            supernodal_flop_ratio_threshold: SupernodalThreshold(-1.0),
            ..Default::default()
        };
        let symbolic =
            factorize_symbolic_cholesky(pattern, Side::Lower, SymmetricOrdering::Amd, parameters)
                .map_err(|_| defect("the gel's stiffness pattern cannot be factorised"))?;
        let SymbolicCholeskyRaw::Supernodal(raw) = symbolic.raw() else {
            return Err(defect(
                "the factor of the gel's stiffness is not supernodal",
            ));
        };
        let mut supernodes = Vec::with_capacity(raw.n_supernodes());
        let mut patterns = Vec::new();
        for s in 0..raw.n_supernodes() {
            let start = raw.supernode_begin()[s];
            let rows = raw.supernode(s).pattern();
            let from = patterns.len();
            patterns.extend(rows.iter().map(|&row| row as u32));
            supernodes.push(Supernode {
                start,
                columns: raw.supernode_end()[s] - start,
                offset: raw.col_ptr_for_val()[s],
                pattern: (from, patterns.len()),
            });
        }
        let permutation = match symbolic.perm() {
            Some(permutation) => permutation.arrays().0.to_vec(),
            None => (0..n).collect(),
        };
        let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let memory = MemBuffer::try_new(scratch)
            .map_err(|_| defect("not enough memory to factorise a gel"))?;
        Ok(Self {
            values: vec![0.0; symbolic.len_val()],
            inverse_diagonal: vec![0.0; n],
            single: vec![0.0; symbolic.len_val()],
            single_inverse_diagonal: vec![0.0; n],
            symbolic,
            column_pointers: column_pointers.to_vec(),
            row_indices: row_indices.to_vec(),
            permutation,
            supernodes,
            patterns,
            memory,
        })
    }

    /// Number of unknowns.
    pub(super) fn len(&self) -> usize {
        self.permutation.len()
    }

    /// Stored entries of the factor.
    pub(super) fn entries(&self) -> usize {
        self.values.len()
    }

    /// Factorises the matrix with these values at the entries of the pattern.
    ///
    /// # Errors
    /// If it is not positive definite; the factor is then unusable until the next success.
    pub(super) fn factorize(&mut self, values: &[f64]) -> Result<(), NotPositiveDefinite> {
        let n = self.len();
        let pattern = SymbolicSparseColMatRef::new_checked(
            n,
            n,
            &self.column_pointers,
            None,
            &self.row_indices,
        );
        let matrix = SparseColMatRef::new(pattern, values);
        self.symbolic
            .factorize_numeric_llt(
                &mut self.values,
                matrix,
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut self.memory),
                Default::default(),
            )
            .map_err(|_| NotPositiveDefinite)?;
        for node in &self.supernodes {
            let rows = node.columns + node.pattern.1 - node.pattern.0;
            for column in 0..node.columns {
                let diagonal = self.values[node.offset + column * rows + column];
                if !(diagonal.is_finite() && diagonal > 0.0) {
                    return Err(NotPositiveDefinite);
                }
                self.inverse_diagonal[node.start + column] = 1.0 / diagonal;
            }
        }
        pulp::Arch::new().dispatch(|| {
            let single = self.single.iter_mut().zip(&self.values);
            for (single, value) in single {
                *single = *value as f32;
            }
            let single = self.single_inverse_diagonal.iter_mut();
            for (single, value) in single.zip(&self.inverse_diagonal) {
                *single = *value as f32;
            }
        });
        Ok(())
    }

    /// Permutes a vector into the order of the factor.
    pub(super) fn permute(&self, vector: &[f64], permuted: &mut [f32]) {
        for (to, &from) in permuted.iter_mut().zip(&self.permutation) {
            *to = vector[from] as f32;
        }
    }

    /// Permutes a vector back into the order of the matrix.
    pub(super) fn unpermute(&self, permuted: &[f32], vector: &mut [f64]) {
        for (value, &to) in permuted.iter().zip(&self.permutation) {
            vector[to] = f64::from(*value);
        }
    }

    /// `x ← L⁻¹ x`, in the factor's order. `scratch` grows as needed.
    pub(super) fn forward_substitute(&self, x: &mut [f32], scratch: &mut Vec<f32>) {
        pulp::Arch::new().dispatch(|| self.forward_substitute_lanes(x, scratch));
    }

    #[inline(always)]
    fn forward_substitute_lanes(&self, x: &mut [f32], scratch: &mut Vec<f32>) {
        for node in &self.supernodes {
            let pattern = &self.patterns[node.pattern.0..node.pattern.1];
            let rows = node.columns + pattern.len();
            let block = &self.single[node.offset..node.offset + rows * node.columns];
            scratch.clear();
            scratch.resize(pattern.len(), 0.0);
            for column in 0..node.columns {
                let entries = &block[column * rows..(column + 1) * rows];
                let index = node.start + column;
                let value = x[index] * self.single_inverse_diagonal[index];
                x[index] = value;
                let (triangle, below) = entries.split_at(node.columns);
                let rest = &mut x[index + 1..node.start + node.columns];
                for (target, entry) in rest.iter_mut().zip(&triangle[column + 1..]) {
                    *target -= entry * value;
                }
                for (target, entry) in scratch.iter_mut().zip(below) {
                    *target += entry * value;
                }
            }
            for (&row, value) in pattern.iter().zip(&*scratch) {
                x[row as usize] -= value;
            }
        }
    }

    /// `X ← L⁻¹ X` for `N` right-hand sides at once, rows in the factor's order.
    pub(super) fn forward_substitute_many<const N: usize>(
        &self,
        x: &mut [[f64; N]],
        scratch: &mut Vec<[f64; N]>,
    ) {
        pulp::Arch::new().dispatch(|| self.forward_substitute_many_lanes(x, scratch));
    }

    #[inline(always)]
    fn forward_substitute_many_lanes<const N: usize>(
        &self,
        x: &mut [[f64; N]],
        scratch: &mut Vec<[f64; N]>,
    ) {
        for node in &self.supernodes {
            let pattern = &self.patterns[node.pattern.0..node.pattern.1];
            let rows = node.columns + pattern.len();
            let block = &self.values[node.offset..node.offset + rows * node.columns];
            scratch.clear();
            scratch.resize(pattern.len(), [0.0; N]);
            for column in 0..node.columns {
                let entries = &block[column * rows..(column + 1) * rows];
                let index = node.start + column;
                let value = x[index].map(|value| value * self.inverse_diagonal[index]);
                x[index] = value;
                let (triangle, below) = entries.split_at(node.columns);
                let rest = &mut x[index + 1..node.start + node.columns];
                for (target, entry) in rest.iter_mut().zip(&triangle[column + 1..]) {
                    for (target, value) in target.iter_mut().zip(value) {
                        *target -= entry * value;
                    }
                }
                for (target, entry) in scratch.iter_mut().zip(below) {
                    for (target, value) in target.iter_mut().zip(value) {
                        *target += entry * value;
                    }
                }
            }
            for (&row, value) in pattern.iter().zip(&*scratch) {
                for (target, value) in x[row as usize].iter_mut().zip(value) {
                    *target -= value;
                }
            }
        }
    }

    /// Row of the matrix behind each row of the factor.
    pub(super) fn permutation(&self) -> &[usize] {
        &self.permutation
    }

    /// `x ← L⁻ᵀ x`, in the factor's order. `scratch` grows as needed.
    pub(super) fn back_substitute(&self, x: &mut [f32], scratch: &mut Vec<f32>) {
        pulp::Arch::new().dispatch(|| self.back_substitute_lanes(x, scratch));
    }

    #[inline(always)]
    fn back_substitute_lanes(&self, x: &mut [f32], scratch: &mut Vec<f32>) {
        for node in self.supernodes.iter().rev() {
            let pattern = &self.patterns[node.pattern.0..node.pattern.1];
            let rows = node.columns + pattern.len();
            let block = &self.single[node.offset..node.offset + rows * node.columns];
            scratch.clear();
            scratch.extend(pattern.iter().map(|&row| x[row as usize]));
            for column in (0..node.columns).rev() {
                let entries = &block[column * rows..(column + 1) * rows];
                let index = node.start + column;
                let (triangle, below) = entries.split_at(node.columns);
                let solved = &x[index + 1..node.start + node.columns];
                let sum = dot_single(below, scratch) + dot_single(&triangle[column + 1..], solved);
                x[index] = (x[index] - sum) * self.single_inverse_diagonal[index];
            }
        }
    }
}

/// Scalar product in sixteen lanes summed in a fixed order: the same bits on every machine.
#[inline(always)]
fn dot_single(a: &[f32], b: &[f32]) -> f32 {
    let n = a.len().min(b.len());
    let (a, b) = (&a[..n], &b[..n]);
    let mut lanes = [0.0_f32; 16];
    for (x, y) in a.chunks_exact(16).zip(b.chunks_exact(16)) {
        for lane in 0..16 {
            lanes[lane] += x[lane] * y[lane];
        }
    }
    let tail = n - n % 16;
    let rest: f32 = a[tail..].iter().zip(&b[tail..]).map(|(x, y)| x * y).sum();
    for half in [8, 4, 2, 1] {
        for lane in 0..half {
            lanes[lane] += lanes[lane + half];
        }
    }
    lanes[0] + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lower triangle of a chain of `n` springs with a pinned start and a few long links.
    fn chain(n: usize) -> (Vec<usize>, Vec<usize>, Vec<f64>) {
        let (mut pointers, mut rows, mut values) = (vec![0], Vec::new(), Vec::new());
        for column in 0..n {
            rows.push(column);
            values.push(4.5 + column as f64 * 0.01);
            for row in [column + 1, column + 7] {
                if row < n {
                    rows.push(row);
                    values.push(-1.0 - (row % 3) as f64 * 0.1);
                }
            }
            pointers.push(rows.len());
        }
        (pointers, rows, values)
    }

    fn times(pointers: &[usize], rows: &[usize], values: &[f64], x: &[f64]) -> Vec<f64> {
        let mut y = vec![0.0; x.len()];
        for column in 0..x.len() {
            for entry in pointers[column]..pointers[column + 1] {
                y[rows[entry]] += values[entry] * x[column];
                if rows[entry] != column {
                    y[column] += values[entry] * x[rows[entry]];
                }
            }
        }
        y
    }

    #[test]
    fn forward_and_back_substitution_solve_the_system() {
        for n in [1, 5, 60, 301] {
            let (pointers, rows, values) = chain(n);
            let mut factor = GelFactor::new(&pointers, &rows).unwrap();
            factor.factorize(&values).unwrap();
            let expected: Vec<f64> = (0..n).map(|i| (i as f64 * 0.7 + 0.3).sin()).collect();
            let right = times(&pointers, &rows, &values, &expected);
            let (mut x, mut found) = (vec![0.0_f32; n], vec![0.0; n]);
            let mut scratch = Vec::new();
            factor.permute(&right, &mut x);
            factor.forward_substitute(&mut x, &mut scratch);
            factor.back_substitute(&mut x, &mut scratch);
            factor.unpermute(&x, &mut found);
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-5, "{n}: {found} {expected}");
            }
            // In double precision, b^T K^-1 b is the squared length of L^-1 P b.
            let mut columns: Vec<[f64; 1]> =
                factor.permutation().iter().map(|&i| [right[i]]).collect();
            factor.forward_substitute_many(&mut columns, &mut Vec::new());
            let squared: f64 = columns.iter().map(|[v]| v * v).sum();
            let product: f64 = right.iter().zip(&expected).map(|(b, x)| b * x).sum();
            assert!((squared / product - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn indefinite_matrix_fails_and_factor_stays_usable() {
        let (pointers, rows, values) = chain(40);
        let mut factor = GelFactor::new(&pointers, &rows).unwrap();
        let mut indefinite = values.clone();
        indefinite[pointers[20]] = -3.0;
        assert_eq!(factor.factorize(&indefinite), Err(NotPositiveDefinite));
        assert_eq!(factor.factorize(&values), Ok(()));
    }
}
