//! Triangle mesh with its edges, areas and content hash.

use glam::DVec3;
use sha2::{Digest as _, Sha256};

use super::aabb::Aabb;
use super::pose::Pose;
use gripcast_base::error::{Error, Result};

/// Triangles over shared vertices. Seen from outside, the corners of a triangle run
/// counter-clockwise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Positions, m.
    pub vertices: Vec<DVec3>,
    /// Indices into `vertices`, three for each triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// Unique edges of a mesh, sorted by their vertices, with the triangles at each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MeshEdges {
    /// Vertices of each edge, the smaller index first; in ascending order.
    pub vertices: Vec<[u32; 2]>,
    /// Edge `i` belongs to `triangles[first[i]..first[i + 1]]`.
    first: Vec<u32>,
    triangles: Vec<u32>,
}

impl MeshEdges {
    /// Number of edges.
    pub fn len(&self) -> usize {
        self.vertices.len()
    }

    /// Whether there is no edge.
    pub fn is_empty(&self) -> bool {
        self.vertices.is_empty()
    }

    /// Triangles at an edge, ascending: two in a closed manifold mesh, one at a border.
    pub fn triangles(&self, edge: usize) -> &[u32] {
        &self.triangles[self.first[edge] as usize..self.first[edge + 1] as usize]
    }

    /// Whether each edge has exactly two triangles.
    pub fn is_closed(&self) -> bool {
        !self.is_empty() && (0..self.len()).all(|edge| self.triangles(edge).len() == 2)
    }
}

impl TriangleMesh {
    /// Corner positions of a triangle, m.
    #[inline]
    pub fn corners(&self, triangle: [u32; 3]) -> [DVec3; 3] {
        triangle.map(|v| self.vertices[v as usize])
    }

    /// Corner positions of all triangles in order, m.
    pub fn all_corners(&self) -> impl ExactSizeIterator<Item = [DVec3; 3]> {
        self.triangles.iter().map(|&t| self.corners(t))
    }

    /// Box around the vertices that triangles use.
    pub fn bounds(&self) -> Aabb {
        Aabb::from_points(self.all_corners().flatten())
    }

    /// Box around each triangle.
    pub fn triangle_bounds(&self) -> Vec<Aabb> {
        self.all_corners().map(Aabb::from_points).collect()
    }

    /// Area of each triangle, m².
    pub fn triangle_areas(&self) -> Vec<f64> {
        self.all_corners()
            .map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length())
            .collect()
    }

    /// Surface, m².
    pub fn area(&self) -> f64 {
        self.triangle_areas().iter().sum()
    }

    /// Area that stands for each vertex, m²: a third of the adjacent triangles.
    pub fn vertex_areas(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.vertices.len()];
        for (triangle, area) in self.triangles.iter().zip(self.triangle_areas()) {
            for &v in triangle {
                areas[v as usize] += area / 3.0;
            }
        }
        areas
    }

    /// Area that stands for each edge, m²: a third of the adjacent triangles.
    pub fn edge_areas(&self, edges: &MeshEdges) -> Vec<f64> {
        let areas = self.triangle_areas();
        (0..edges.len())
            .map(|edge| {
                let adjacent = edges.triangles(edge).iter().map(|&t| areas[t as usize]);
                adjacent.sum::<f64>() / 3.0
            })
            .collect()
    }

    /// Unique sorted edges with their triangles.
    pub fn edges(&self) -> MeshEdges {
        let mut sides: Vec<([u32; 2], u32)> = Vec::with_capacity(3 * self.triangles.len());
        for (index, [a, b, c]) in self.triangles.iter().enumerate() {
            for (p, q) in [(a, b), (b, c), (c, a)] {
                sides.push(([*p.min(q), *p.max(q)], index as u32));
            }
        }
        sides.sort_unstable();
        let mut edges = MeshEdges::default();
        for (at, (side, triangle)) in sides.into_iter().enumerate() {
            if edges.vertices.last() != Some(&side) {
                edges.vertices.push(side);
                edges.first.push(at as u32);
            }
            edges.triangles.push(triangle);
        }
        edges.first.push(edges.triangles.len() as u32);
        edges
    }

    /// Copy scaled about the origin by a positive factor.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        self.mapped(|v| v * factor)
    }

    /// Copy in frame a of a mesh in frame b.
    #[must_use]
    pub fn transformed(&self, t_a_b: &Pose) -> Self {
        self.mapped(|v| t_a_b.transform_point(v))
    }

    /// Copy with each vertex moved by `map`, which must keep the orientation.
    fn mapped(&self, map: impl Fn(DVec3) -> DVec3) -> Self {
        Self {
            vertices: self.vertices.iter().map(|&v| map(v)).collect(),
            triangles: self.triangles.clone(),
        }
    }

    /// Copy without the vertices that no triangle uses; the others keep their order.
    #[must_use]
    pub fn without_unused_vertices(&self) -> Self {
        let mut used = vec![false; self.vertices.len()];
        for &v in self.triangles.iter().flatten() {
            used[v as usize] = true;
        }
        let mut compact = Self::default();
        let mut renamed = vec![0; self.vertices.len()];
        for (v, _) in used.iter().enumerate().filter(|(_, is_used)| **is_used) {
            renamed[v] = compact.vertices.len() as u32;
            compact.vertices.push(self.vertices[v]);
        }
        compact.triangles = self
            .triangles
            .iter()
            .map(|t| t.map(|v| renamed[v as usize]))
            .collect();
        compact
    }

    /// Both meshes as one, without welding.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        let offset = self.vertices.len() as u32;
        let mut joined = self.clone();
        joined.vertices.extend(&other.vertices);
        joined
            .triangles
            .extend(other.triangles.iter().map(|t| t.map(|v| v + offset)));
        joined
    }

    /// Checks that there are triangles, that indices are in range and coordinates finite.
    ///
    /// # Errors
    /// `Input`, with the first offending vertex or triangle (counted from 0).
    pub fn validate(&self) -> Result<()> {
        let bad = |what: String| Err(Error::input(what));
        if self.triangles.is_empty() {
            return bad("the mesh has no triangles".to_string());
        }
        if let Some(v) = self.vertices.iter().position(|v| !v.is_finite()) {
            let found = self.vertices[v].to_array();
            return bad(format!(
                "vertex {v} must have finite coordinates, found {found:?}"
            ));
        }
        let count = self.vertices.len();
        let outside = |t: &[u32; 3]| t.iter().any(|&v| v as usize >= count);
        if let Some(t) = self.triangles.iter().position(outside) {
            let found = self.triangles[t];
            return bad(format!(
                "triangle {t} names vertices {found:?}, but the mesh has only {count} (0 to {})",
                count.saturating_sub(1)
            ));
        }
        Ok(())
    }

    /// SHA-256 of vertices and triangles, 64 hex digits: equal exactly if both are equal bit for
    /// bit.
    pub fn content_hash(&self) -> String {
        let mut hash = Sha256::new();
        hash.update((self.vertices.len() as u64).to_le_bytes());
        for vertex in &self.vertices {
            for value in vertex.to_array() {
                hash.update(value.to_le_bytes());
            }
        }
        for index in self.triangles.iter().flatten() {
            hash.update(index.to_le_bytes());
        }
        hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// A square of two triangles, 2 m wide, in z = 0.
    fn square() -> TriangleMesh {
        TriangleMesh {
            vertices: vec![
                DVec3::ZERO,
                DVec3::X * 2.0,
                DVec3::new(2.0, 2.0, 0.0),
                DVec3::Y * 2.0,
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    #[test]
    fn edges_are_unique_sorted_and_know_their_triangles() {
        let edges = square().edges();
        assert_eq!(edges.vertices, [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]);
        assert_eq!(edges.triangles(1), [0, 1]);
        assert_eq!(edges.triangles(3), [0]);
        assert!(!edges.is_closed());
        assert!(TriangleMesh::default().edges().is_empty());
    }

    #[test]
    fn areas_sum_to_the_surface() {
        let mesh = square();
        assert_eq!(mesh.area(), 4.0);
        let vertex: f64 = mesh.vertex_areas().iter().sum();
        let edge: f64 = mesh.edge_areas(&mesh.edges()).iter().sum();
        assert!((vertex - 4.0).abs() < 1e-15 && (edge - 4.0).abs() < 1e-15);
        assert!((mesh.vertex_areas()[0] - 4.0 / 3.0).abs() < 1e-15);
        assert!((mesh.edge_areas(&mesh.edges())[0] - 2.0 / 3.0).abs() < 1e-15);
    }

    #[test]
    fn moving_and_scaling() {
        let mesh = square();
        let pose = Pose::new(DQuat::from_rotation_x(1.0), DVec3::ONE);
        assert!((mesh.transformed(&pose).area() - 4.0).abs() < 1e-12);
        assert_eq!(mesh.scaled(0.5).bounds().max, DVec3::new(1.0, 1.0, 0.0));
        let two = mesh.joined(&mesh.scaled(0.5));
        assert_eq!(two.triangles[2], [4, 5, 6]);
        assert_eq!(two.area(), 5.0);
        let second = TriangleMesh {
            triangles: two.triangles[2..].to_vec(),
            ..two
        };
        assert_eq!(second.without_unused_vertices(), mesh.scaled(0.5));
    }

    #[test]
    fn the_hash_changes_with_the_content() {
        let mesh = square();
        let mut moved = mesh.clone();
        moved.vertices[0].z = f64::MIN_POSITIVE;
        let mut turned = mesh.clone();
        turned.triangles[0] = [1, 2, 0];
        let hash = mesh.content_hash();
        assert_eq!(hash.len(), 64);
        assert_eq!(hash, square().content_hash());
        assert_ne!(hash, moved.content_hash());
        assert_ne!(hash, turned.content_hash());
    }

    #[test]
    fn a_broken_mesh_is_explained() {
        let mut mesh = square();
        mesh.triangles[1][2] = 9;
        let text = mesh.validate().unwrap_err().to_string();
        assert!(
            text.contains("triangle 1") && text.contains("only 4"),
            "{text}"
        );
        let mut mesh = square();
        mesh.vertices[3].y = f64::NAN;
        let text = mesh.validate().unwrap_err().to_string();
        assert!(text.contains("vertex 3"), "{text}");
        let text = TriangleMesh::default().validate().unwrap_err().to_string();
        assert!(text.contains("no triangles"), "{text}");
        assert!(square().validate().is_ok());
    }
}
