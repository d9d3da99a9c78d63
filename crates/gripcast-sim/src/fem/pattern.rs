//! Sparsity pattern of the stiffness matrix of a mesh: lower triangle, compressed columns.

use glam::DMat3;

/// Sparsity pattern of a symmetric matrix of 3x3 node blocks.
///
/// Row and column 3 n + a belong to axis a of node n. Only the lower triangle is stored, in
/// compressed columns with ascending rows, as required by a sparse Cholesky factorisation. Two
/// nodes are coupled if they share an element.
#[derive(Clone, Debug)]
pub struct StiffnessPattern {
    /// Higher neighbours of each node, ascending: those of node n at `starts[n]..starts[n + 1]`.
    starts: Vec<usize>,
    neighbours: Vec<u32>,
    column_starts: Vec<usize>,
    rows: Vec<usize>,
}

impl StiffnessPattern {
    /// Pattern of `nodes` nodes coupled by `elements`; corners that are not below `nodes` are
    /// ignored.
    pub fn new(nodes: usize, elements: &[[u32; 4]]) -> Self {
        let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(6 * elements.len());
        for e in elements {
            for (k, &b) in e.iter().enumerate() {
                pairs.extend(e[..k].iter().map(|&a| (a.min(b), a.max(b))));
            }
        }
        pairs.retain(|&(a, b)| a != b && (b as usize) < nodes);
        pairs.sort_unstable();
        pairs.dedup();
        let mut starts = vec![0; nodes + 1];
        for &(a, _) in &pairs {
            starts[a as usize + 1] += 1;
        }
        for n in 0..nodes {
            starts[n + 1] += starts[n];
        }
        let neighbours: Vec<u32> = pairs.into_iter().map(|(_, b)| b).collect();
        let (column_starts, rows) = columns(&starts, &neighbours);
        Self {
            starts,
            neighbours,
            column_starts,
            rows,
        }
    }

    /// Number of rows and columns: three per node.
    pub fn dimension(&self) -> usize {
        self.column_starts.len() - 1
    }

    /// Number of stored entries.
    pub fn entries(&self) -> usize {
        self.rows.len()
    }

    /// First entry of each column, then the number of entries.
    pub fn column_starts(&self) -> &[usize] {
        &self.column_starts
    }

    /// Row of each entry.
    pub fn rows(&self) -> &[usize] {
        &self.rows
    }

    /// A matrix of zeros: one value per entry.
    pub fn zeros(&self) -> Vec<f64> {
        vec![0.0; self.entries()]
    }

    /// Adds a symmetric 3x3 block on the diagonal, of which only the lower triangle is read.
    pub fn add_diagonal_block(&self, node: usize, block: &DMat3, values: &mut [f64]) {
        let c = block.to_cols_array_2d();
        for (axis, column) in c.iter().enumerate() {
            let start = self.column_starts[3 * node + axis];
            for (value, entry) in values[start..start + 3 - axis]
                .iter_mut()
                .zip(&column[axis..])
            {
                *value += entry;
            }
        }
    }

    /// Adds `diagonal` to the three diagonal entries of a node.
    pub fn add_diagonal(&self, node: usize, diagonal: [f64; 3], values: &mut [f64]) {
        for (axis, entry) in diagonal.into_iter().enumerate() {
            values[self.column_starts[3 * node + axis]] += entry;
        }
    }

    /// Adds the block of rows of node `i` and columns of node `j`, and its transpose.
    ///
    /// Returns false without adding if the two nodes share no element. `i` = `j` is the diagonal
    /// block.
    pub fn add_pair_block(&self, i: usize, j: usize, block: &DMat3, values: &mut [f64]) -> bool {
        if i == j {
            self.add_diagonal_block(i, block, values);
            return true;
        }
        let (low, high) = (i.min(j), i.max(j));
        let Some(offset) = self.pair(low, high) else {
            return false;
        };
        let lower = if i > j { *block } else { block.transpose() };
        for (axis, column) in lower.to_cols_array_2d().iter().enumerate() {
            let start = offset.entry(axis);
            for (value, entry) in values[start..start + 3].iter_mut().zip(column) {
                *value += entry;
            }
        }
        true
    }

    /// Storage of the block of two coupled nodes, `low` < `high`.
    pub(super) fn pair(&self, low: usize, high: usize) -> Option<BlockOffset> {
        let (start, end) = (self.starts[low], self.starts[low + 1]);
        let neighbours = &self.neighbours[start..end];
        let k = neighbours.binary_search(&(high as u32)).ok()?;
        Some(BlockOffset {
            start: self.column_starts[3 * low] + 3 + 3 * k,
            stride: 3 + 3 * neighbours.len(),
        })
    }

    /// Storage of the diagonal block of a node.
    pub(super) fn diagonal(&self, node: usize) -> BlockOffset {
        BlockOffset {
            start: self.column_starts[3 * node],
            stride: 3 + 3 * (self.starts[node + 1] - self.starts[node]),
        }
    }

    /// y = A x for the full symmetric matrix with these `values`; x and y have `dimension` entries.
    #[cfg(test)]
    pub(crate) fn multiply(&self, values: &[f64], x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        for column in 0..self.dimension() {
            let entries = self.column_starts[column]..self.column_starts[column + 1];
            for (&row, &value) in self.rows[entries.clone()].iter().zip(&values[entries]) {
                y[row] += value * x[column];
                if row != column {
                    y[column] += value * x[row];
                }
            }
        }
    }
}

/// Storage of a 3x3 block: its first entry and the length of its first column.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockOffset {
    pub(super) start: usize,
    pub(super) stride: usize,
}

impl BlockOffset {
    /// First of the three entries in column `axis` of the block. The diagonal block above it is one
    /// entry shorter in each next column.
    pub(super) fn entry(self, axis: usize) -> usize {
        let shorter = [0, 1, 3][axis];
        self.start + axis * self.stride - shorter
    }
}

/// Column starts and rows of the scalar matrix from the higher neighbours of the nodes.
fn columns(starts: &[usize], neighbours: &[u32]) -> (Vec<usize>, Vec<usize>) {
    let mut column_starts = vec![0];
    let mut rows = Vec::with_capacity(9 * neighbours.len() + 6 * starts.len());
    for (node, range) in starts.windows(2).enumerate() {
        for axis in 0..3 {
            rows.extend(3 * node + axis..3 * node + 3);
            for &b in &neighbours[range[0]..range[1]] {
                rows.extend(3 * b as usize..3 * b as usize + 3);
            }
            column_starts.push(rows.len());
        }
    }
    (column_starts, rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// Two tetrahedra that share the face 1, 2, 3.
    fn pattern() -> StiffnessPattern {
        StiffnessPattern::new(5, &[[0, 1, 2, 3], [4, 3, 2, 1]])
    }

    fn dense(p: &StiffnessPattern, values: &[f64]) -> Vec<Vec<f64>> {
        let n = p.dimension();
        let mut columns = vec![vec![0.0; n]; n];
        for (c, column) in columns.iter_mut().enumerate() {
            let mut unit = vec![0.0; n];
            unit[c] = 1.0;
            p.multiply(values, &unit, column);
        }
        columns
    }

    #[test]
    fn columns_contain_the_lower_triangle_in_order() {
        let p = pattern();
        assert_eq!(p.dimension(), 15);
        // 5 diagonal blocks of 6 and 9 pairs of 9; nodes 0 and 4 share no element.
        assert_eq!(p.entries(), 5 * 6 + 9 * 9);
        for c in 0..15 {
            let rows = &p.rows()[p.column_starts()[c]..p.column_starts()[c + 1]];
            assert_eq!(rows[0], c);
            assert!(rows.is_sorted_by(|a, b| a < b));
        }
    }

    #[test]
    fn pair_blocks_are_added_symmetrically() {
        let p = pattern();
        let block = DMat3::from_cols_array(&std::array::from_fn(|k| 1.0 + k as f64));
        for (i, j) in [(0, 1), (1, 0), (3, 1), (1, 4), (2, 3)] {
            let mut values = p.zeros();
            assert!(p.add_pair_block(i, j, &block, &mut values));
            let m = dense(&p, &values);
            for r in 0..3 {
                for c in 0..3 {
                    assert_eq!(m[3 * j + c][3 * i + r], block.col(c)[r], "{i} {j}");
                    assert_eq!(m[3 * i + r][3 * j + c], block.col(c)[r], "{i} {j}");
                }
            }
            let sum: f64 = m.iter().flatten().sum();
            assert_eq!(sum, 2.0 * 45.0);
        }
    }

    #[test]
    fn uncoupled_nodes_are_rejected() {
        let p = pattern();
        let mut values = p.zeros();
        assert!(!p.add_pair_block(0, 4, &DMat3::IDENTITY, &mut values));
        assert!(values.iter().all(|v| *v == 0.0));
    }

    #[test]
    fn diagonal_blocks_and_entries_add_up() {
        let p = pattern();
        let half = DMat3::from_cols_array(&[1.0, 2.0, 3.0, 2.0, 4.0, 5.0, 3.0, 5.0, 6.0]);
        let mut values = p.zeros();
        assert!(p.add_pair_block(2, 2, &half, &mut values));
        p.add_diagonal(2, [10.0, 20.0, 30.0], &mut values);
        let expected = half + DMat3::from_diagonal(DVec3::new(10.0, 20.0, 30.0));
        let m = dense(&p, &values);
        for c in 0..3 {
            for r in 0..3 {
                assert_eq!(m[6 + c][6 + r], expected.col(c)[r]);
            }
        }
    }
}
