//! Triangle mesh: edges, areas and content hash.

use glam::DVec3;
use sha2::{Digest as _, Sha256};

use super::aabb::Aabb;
use super::pose::Pose;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::hex;

/// Triangles over shared vertices, counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Positions, m.
    pub vertices: Vec<DVec3>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// Unique edges of a mesh, sorted by vertices, with their adjacent triangles.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MeshEdges {
    /// Vertex indices of each edge, smaller first, in ascending order.
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

    /// Whether there are no edges.
    pub fn is_empty(&self) -> bool {
        self.vertices.is_empty()
    }

    /// Triangles at an edge, ascending: two in a closed manifold mesh, one at a boundary.
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

    /// Bounding box of the vertices that triangles use.
    pub fn bounds(&self) -> Aabb {
        Aabb::from_points(self.all_corners().flatten())
    }

    /// Bounding box of each triangle.
    pub fn triangle_bounds(&self) -> Vec<Aabb> {
        self.all_corners().map(Aabb::from_points).collect()
    }

    /// Area of each triangle, m².
    pub fn triangle_areas(&self) -> Vec<f64> {
        self.all_corners()
            .map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length())
            .collect()
    }

    /// Surface area, m².
    pub fn area(&self) -> f64 {
        self.triangle_areas().iter().sum()
    }

    /// Lumped area of each vertex, m²: a third of the adjacent triangles.
    pub fn vertex_areas(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.vertices.len()];
        for (triangle, area) in self.triangles.iter().zip(self.triangle_areas()) {
            for &v in triangle {
                areas[v as usize] += area / 3.0;
            }
        }
        areas
    }

    /// Lumped area of each edge, m²: a third of the adjacent triangles.
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
        for (index, (side, triangle)) in sides.into_iter().enumerate() {
            if edges.vertices.last() != Some(&side) {
                edges.vertices.push(side);
                edges.first.push(index as u32);
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

    /// Transforms a mesh from frame b into frame a.
    #[must_use]
    pub fn transformed(&self, t_a_b: &Pose) -> Self {
        self.mapped(|v| t_a_b.transform_point(v))
    }

    /// Copy with each vertex mapped by `map`, which must preserve orientation.
    fn mapped(&self, map: impl Fn(DVec3) -> DVec3) -> Self {
        Self {
            vertices: self.vertices.iter().map(|&v| map(v)).collect(),
            triangles: self.triangles.clone(),
        }
    }

    /// Copy without unused vertices; the others keep their order.
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

    /// Concatenates both meshes without welding.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        let mut joined = self.clone();
        joined.append(other);
        joined
    }

    /// Appends another mesh without welding.
    pub(super) fn append(&mut self, other: &Self) {
        let offset = self.vertices.len() as u32;
        self.vertices.extend(&other.vertices);
        let triangles = other.triangles.iter();
        self.triangles
            .extend(triangles.map(|t| t.map(|v| v + offset)));
    }

    /// Checks that there are triangles, indices are in range and coordinates finite.
    ///
    /// # Errors
    /// `Input`, with the first invalid vertex or triangle (from 0).
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
                "triangle {t} refers to vertices {found:?}, but the mesh has only {count} (0 to {})",
                count.saturating_sub(1)
            ));
        }
        Ok(())
    }

    /// SHA-256 of vertices and triangles, 64 hex digits; equal if and only if both are
    /// bit-identical.
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
        hex(&hash.finalize())
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
    fn edges_are_unique_and_sorted_with_their_triangles() {
        let edges = square().edges();
        assert_eq!(edges.vertices, [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]);
        assert_eq!(edges.triangles(1), [0, 1]);
        assert_eq!(edges.triangles(3), [0]);
        assert!(!edges.is_closed());
        assert!(TriangleMesh::default().edges().is_empty());
    }

    #[test]
    fn vertex_and_edge_areas_sum_to_the_surface() {
        let mesh = square();
        assert_eq!(mesh.area(), 4.0);
        let vertex: f64 = mesh.vertex_areas().iter().sum();
        let edge: f64 = mesh.edge_areas(&mesh.edges()).iter().sum();
        assert!((vertex - 4.0).abs() < 1e-15 && (edge - 4.0).abs() < 1e-15);
        assert!((mesh.vertex_areas()[0] - 4.0 / 3.0).abs() < 1e-15);
        assert!((mesh.edge_areas(&mesh.edges())[0] - 2.0 / 3.0).abs() < 1e-15);
    }

    #[test]
    fn transforming_scaling_and_joining() {
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
    fn hash_changes_with_content() {
        let mesh = square();
        let mut moved = mesh.clone();
        moved.vertices[0].z = f64::MIN_POSITIVE;
        let mut rotated = mesh.clone();
        rotated.triangles[0] = [1, 2, 0];
        let hash = mesh.content_hash();
        assert_eq!(hash.len(), 64);
        assert_eq!(hash, square().content_hash());
        assert_ne!(hash, moved.content_hash());
        assert_ne!(hash, rotated.content_hash());
    }

    #[test]
    fn invalid_meshes_are_rejected() {
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
