//! Elements in groups of [`WIDTH`] as structures of arrays, for SIMD.

use glam::{DMat3, DVec3};

use super::pattern::StiffnessPattern;

/// Elements per group.
pub(super) const WIDTH: usize = 8;

/// One value per element of a group.
pub(super) type Lanes = [f64; WIDTH];

/// Pairs of corners of an element, the higher first, in the order of [`Batch::pair_starts`].
pub(super) const PAIRS: [(usize, usize); 6] = [(1, 0), (2, 0), (3, 0), (2, 1), (3, 1), (3, 2)];

/// Constant data of [`WIDTH`] elements; the last group is padded with elements of weight zero.
///
/// Corners are sorted by node, so that the lower corner owns the column of each block below the
/// diagonal. Sorting may mirror an element, which only affects the sign of `inverse_det`.
#[derive(Clone, Debug)]
pub(super) struct Batch {
    /// Node indices by corner.
    pub(super) nodes: [[u32; WIDTH]; 4],
    /// Rest volume in m³.
    pub(super) volume: Lanes,
    /// 1 / det of the rest edges from corner 0, in 1/m³.
    pub(super) inverse_det: Lanes,
    /// volume * grad N_i . grad N_j in m for (i, j) = 11, 12, 13, 22, 23, 33.
    pub(super) metric: [Lanes; 6],
    /// grad N_i in 1/m by corner 1 to 3 and axis.
    pub(super) shape: [[Lanes; 3]; 3],
    /// First entry of the column of each corner.
    pub(super) diagonal_starts: [[u32; WIDTH]; 4],
    /// Stride to the next column of the block of each corner.
    pub(super) strides: [[u32; WIDTH]; 4],
    /// First entry of the blocks of [`PAIRS`].
    pub(super) pair_starts: [[u32; WIDTH]; 6],
}

impl Batch {
    const EMPTY: Self = Self {
        nodes: [[0; WIDTH]; 4],
        volume: [0.0; WIDTH],
        inverse_det: [0.0; WIDTH],
        metric: [[0.0; WIDTH]; 6],
        shape: [[[0.0; WIDTH]; 3]; 3],
        diagonal_starts: [[0; WIDTH]; 4],
        strides: [[0; WIDTH]; 4],
        pair_starts: [[0; WIDTH]; 6],
    };

    /// Groups `tets` in order. Every tetrahedron must have a volume and every entry fit 32 bits.
    pub(super) fn group(
        tets: &[[u32; 4]],
        rest: &[DVec3],
        pattern: &StiffnessPattern,
    ) -> Vec<Self> {
        let pack = |group: &[[u32; 4]]| {
            let mut batch = Self::EMPTY;
            for lane in 0..WIDTH {
                let tet = group[lane.min(group.len() - 1)];
                let weight = if lane < group.len() { 1.0 } else { 0.0 };
                batch.fill(lane, tet, weight, rest);
                batch.locate(lane, pattern);
            }
            batch
        };
        tets.chunks(WIDTH).map(pack).collect()
    }

    fn fill(&mut self, lane: usize, mut tet: [u32; 4], weight: f64, rest: &[DVec3]) {
        tet.sort_unstable();
        let [a, b, c, d] = tet.map(|v| rest[v as usize]);
        let edges = DMat3::from_cols(b - a, c - a, d - a);
        let det = edges.determinant();
        let gradients = edges.inverse().transpose();
        self.volume[lane] = weight * det.abs() / 6.0;
        self.inverse_det[lane] = 1.0 / det;
        for (nodes, node) in self.nodes.iter_mut().zip(tet) {
            nodes[lane] = node;
        }
        for (k, (i, j)) in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
            .into_iter()
            .enumerate()
        {
            let dot = gradients.col(i).dot(gradients.col(j));
            self.metric[k][lane] = self.volume[lane] * dot;
        }
        for i in 0..3 {
            for axis in 0..3 {
                self.shape[i][axis][lane] = gradients.col(i)[axis];
            }
        }
    }

    fn locate(&mut self, lane: usize, pattern: &StiffnessPattern) {
        for corner in 0..4 {
            let block = pattern.diagonal(self.nodes[corner][lane] as usize);
            self.diagonal_starts[corner][lane] = block.start as u32;
            self.strides[corner][lane] = block.stride as u32;
        }
        for (k, (high, low)) in PAIRS.into_iter().enumerate() {
            let [high, low] = [high, low].map(|corner| self.nodes[corner][lane] as usize);
            if let Some(block) = pattern.pair(low, high) {
                self.pair_starts[k][lane] = block.start as u32;
            }
        }
    }

    /// Edges from corner 0 to corners 1 to 3, by axis, in m.
    #[inline(always)]
    pub(super) fn edges(&self, x: &[DVec3]) -> [[Lanes; 3]; 3] {
        let mut edges = [[[0.0; WIDTH]; 3]; 3];
        for lane in 0..WIDTH {
            let origin = x[self.nodes[0][lane] as usize];
            for i in 0..3 {
                let edge = x[self.nodes[i + 1][lane] as usize] - origin;
                edges[i][0][lane] = edge.x;
                edges[i][1][lane] = edge.y;
                edges[i][2][lane] = edge.z;
            }
        }
        edges
    }
}
