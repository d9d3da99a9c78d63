//! Boundary surface of a tetrahedral mesh: triangles, edges and vertices with lumped areas.

use glam::DVec3;

/// A triangle surface over the nodes of a mesh, with the rest areas that weigh contact pairs.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    triangles: Vec<[u32; 3]>,
    edges: Vec<[u32; 2]>,
    vertices: Vec<u32>,
    vertex_areas: Vec<f64>,
    edge_areas: Vec<f64>,
}

impl Surface {
    /// Surface of `triangles`, whose corners index `positions` (m).
    ///
    /// A vertex and an edge each have a third of the area of every adjacent triangle (Li et al.,
    /// *Incremental Potential Contact*, 2020).
    pub fn new(triangles: &[[u32; 3]], positions: &[DVec3]) -> Self {
        let mut sides: Vec<([u32; 2], f64)> = Vec::with_capacity(3 * triangles.len());
        let mut corners: Vec<(u32, f64)> = Vec::with_capacity(3 * triangles.len());
        for t in triangles {
            let third = triangle_area(t, positions) / 3.0;
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                sides.push(([a.min(b), a.max(b)], third));
                corners.push((a, third));
            }
        }
        let (edges, edge_areas) = sums(sides);
        let (vertices, vertex_areas) = sums(corners);
        Self {
            triangles: triangles.to_vec(),
            edges,
            vertices,
            vertex_areas,
            edge_areas,
        }
    }

    /// Triangles, counter-clockwise seen from outside.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Unique edges, lower node first, sorted.
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// Nodes of the surface, ascending.
    pub fn vertices(&self) -> &[u32] {
        &self.vertices
    }

    /// Rest area of each of [`Surface::vertices`] in m².
    pub fn vertex_areas(&self) -> &[f64] {
        &self.vertex_areas
    }

    /// Rest area of each of [`Surface::edges`] in m².
    pub fn edge_areas(&self) -> &[f64] {
        &self.edge_areas
    }
}

/// Sorted distinct keys, each with the sum of its values in the given order.
fn sums<K: Ord + Copy>(mut items: Vec<(K, f64)>) -> (Vec<K>, Vec<f64>) {
    items.sort_by_key(|(key, _)| *key);
    items
        .chunk_by(|a, b| a.0 == b.0)
        .map(|run| (run[0].0, run.iter().map(|(_, value)| value).sum::<f64>()))
        .unzip()
}

/// Area in m².
pub(super) fn triangle_area(triangle: &[u32; 3], positions: &[DVec3]) -> f64 {
    let [a, b, c] = triangle.map(|v| positions[v as usize]);
    0.5 * (b - a).cross(c - a).length()
}

/// Faces of positively oriented tetrahedra that belong to only one of them, counter-clockwise seen
/// from outside, sorted by nodes.
pub(super) fn boundary_triangles(tets: &[[u32; 4]]) -> Vec<[u32; 3]> {
    let mut faces: Vec<([u32; 3], [u32; 3])> = Vec::with_capacity(4 * tets.len());
    for &[a, b, c, d] in tets {
        for face in [[a, c, b], [a, b, d], [a, d, c], [b, c, d]] {
            let mut key = face;
            key.sort_unstable();
            faces.push((key, face));
        }
    }
    faces.sort_unstable();
    faces
        .chunk_by(|a, b| a.0 == b.0)
        .filter(|run| run.len() == 1)
        .map(|run| run[0].1)
        .collect()
}
