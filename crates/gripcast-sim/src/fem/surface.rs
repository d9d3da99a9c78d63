//! Boundary of a tetrahedral mesh: triangles, edges, vertices and their fractions of the area.

use glam::DVec3;

/// A triangle surface over the nodes of a mesh, with the rest areas contact weighs its pairs by.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    triangles: Vec<[u32; 3]>,
    edges: Vec<[u32; 2]>,
    vertices: Vec<u32>,
    vertex_areas: Vec<f64>,
    edge_areas: Vec<f64>,
}

impl Surface {
    /// Edges, vertices and areas of `triangles`, whose corners index `positions` (m).
    ///
    /// A vertex and an edge each get a third of the area of every triangle they belong to
    /// (the rule of Li et al., *Incremental Potential Contact*, 2020).
    #[must_use]
    pub fn new(triangles: &[[u32; 3]], positions: &[DVec3]) -> Self {
        let mut fractions: Vec<([u32; 2], f64)> = Vec::with_capacity(3 * triangles.len());
        let mut corners: Vec<(u32, f64)> = Vec::with_capacity(3 * triangles.len());
        for t in triangles {
            let third = triangle_area(t, positions) / 3.0;
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                fractions.push(([a.min(b), a.max(b)], third));
                corners.push((a, third));
            }
        }
        let (edges, edge_areas) = sums(fractions);
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
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Edges, each once, its lower node first, sorted.
    #[must_use]
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// Nodes of the surface, ascending.
    #[must_use]
    pub fn vertices(&self) -> &[u32] {
        &self.vertices
    }

    /// Rest area of each of [`Surface::vertices`] in m².
    #[must_use]
    pub fn vertex_areas(&self) -> &[f64] {
        &self.vertex_areas
    }

    /// Rest area of each of [`Surface::edges`] in m².
    #[must_use]
    pub fn edge_areas(&self) -> &[f64] {
        &self.edge_areas
    }
}

/// Sorted distinct keys, each with the sum of its values in their given order.
fn sums<K: Ord + Copy>(mut items: Vec<(K, f64)>) -> (Vec<K>, Vec<f64>) {
    items.sort_by_key(|(key, _)| *key);
    items
        .chunk_by(|a, b| a.0 == b.0)
        .map(|run| {
            (
                run[0].0,
                run.iter().map(|(_, fraction)| fraction).sum::<f64>(),
            )
        })
        .unzip()
}

/// Area in m².
pub(super) fn triangle_area(triangle: &[u32; 3], positions: &[DVec3]) -> f64 {
    let [a, b, c] = triangle.map(|v| positions[v as usize]);
    0.5 * (b - a).cross(c - a).length()
}

/// Faces of positively oriented tetrahedra that belong to one tetrahedron only, counter-clockwise
/// seen from outside, sorted by their nodes.
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
