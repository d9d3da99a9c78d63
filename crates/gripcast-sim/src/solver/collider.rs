//! Collision surface of the object in its material frame (origin: centre of mass).

use glam::DVec3;

use gripcast_geometry::{Aabb, Bvh, TriangleMesh};

/// Edges whose faces open outwards by less than this angle (rad), flat or concave, cannot touch
/// before a face does. On a 2 mm edge a gel edge would dip 50 nm, far below any contact gap.
const MIN_OPENING_RAD: f64 = 1e-4;

/// Triangles, convex edges and convex vertices of a surface, each with a BVH.
#[derive(Clone, Debug)]
pub struct Collider {
    pub(super) vertices: Vec<DVec3>,
    pub(super) vertex_areas: Vec<f64>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) triangle_tree: Bvh,
    /// Vertices at the end of at least one convex edge.
    pub(super) corners: Vec<u32>,
    pub(super) corner_tree: Bvh,
    pub(super) edges: Vec<[u32; 2]>,
    pub(super) edge_areas: Vec<f64>,
    pub(super) edge_tree: Bvh,
    pub(super) bounds: Aabb,
}

impl Collider {
    /// Collision surface of a mesh whose origin is its centre of mass (m). It may cross itself: the
    /// object is one body, so its faces do not touch each other. The back of an open mesh can be
    /// touched too, where its concave edges are convex.
    pub fn new(mesh: &TriangleMesh) -> Self {
        let all_edges = mesh.edges();
        let is_open = (0..all_edges.len()).any(|edge| all_edges.triangles(edge).len() == 1);
        let all_areas = mesh.edge_areas(&all_edges);
        let mut edges = Vec::new();
        let mut edge_areas = Vec::new();
        let mut is_corner = vec![false; mesh.vertices.len()];
        for (index, &edge) in all_edges.vertices.iter().enumerate() {
            if is_candidate(mesh, edge, all_edges.triangles(index), is_open) {
                edges.push(edge);
                edge_areas.push(all_areas[index]);
                for vertex in edge {
                    is_corner[vertex as usize] = true;
                }
            }
        }
        let corners: Vec<u32> = (0..mesh.vertices.len() as u32)
            .filter(|&vertex| is_corner[vertex as usize])
            .collect();
        let position = |vertex: u32| mesh.vertices[vertex as usize];
        let corner_boxes: Vec<Aabb> = corners
            .iter()
            .map(|&vertex| Aabb::from_points([position(vertex)]))
            .collect();
        let edge_boxes: Vec<Aabb> = edges
            .iter()
            .map(|edge| Aabb::from_points(edge.map(position)))
            .collect();
        Self {
            vertex_areas: mesh.vertex_areas(),
            triangle_tree: Bvh::build(&mesh.triangle_bounds()),
            corner_tree: Bvh::build(&corner_boxes),
            edge_tree: Bvh::build(&edge_boxes),
            bounds: mesh.bounds(),
            vertices: mesh.vertices.clone(),
            triangles: mesh.triangles.clone(),
            corners,
            edges,
            edge_areas,
        }
    }

    /// Vertices in the material frame, m.
    pub fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    /// Bounding box in the material frame, m.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }
}

/// Whether an edge can be touched before its faces: they open outwards by more than
/// [`MIN_OPENING_RAD`], on either side of an open mesh. So can edges without exactly two faces, or
/// whose faces do not agree about the outer side.
fn is_candidate(mesh: &TriangleMesh, edge: [u32; 2], faces: &[u32], is_open: bool) -> bool {
    let &[first, second] = faces else { return true };
    let runs_along = |face: u32| {
        let [a, b, c] = mesh.triangles[face as usize];
        [[a, b], [b, c], [c, a]].contains(&edge)
    };
    if runs_along(first) == runs_along(second) {
        return true;
    }
    let corners = |face: u32| mesh.triangles[face as usize].map(|v| mesh.vertices[v as usize]);
    let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).normalize_or_zero();
    let opposite = mesh.triangles[second as usize]
        .into_iter()
        .find(|vertex| !edge.contains(vertex));
    let Some(opposite) = opposite else {
        return true;
    };
    let (n1, n2) = (normal(corners(first)), normal(corners(second)));
    let start = mesh.vertices[edge[0] as usize];
    let below = n1.dot(mesh.vertices[opposite as usize] - start) < 0.0;
    (below || is_open) && n1.cross(n2).length().atan2(n1.dot(n2)) > MIN_OPENING_RAD
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::builtin;

    #[test]
    fn box_has_only_its_twelve_ridges_as_edges() {
        let mesh = builtin("box").unwrap();
        let collider = Collider::new(&mesh);
        let edge_length: f64 = collider
            .edges
            .iter()
            .map(|e| {
                let [a, b] = e.map(|v| mesh.vertices[v as usize]);
                a.distance(b)
            })
            .sum();
        assert!((edge_length - 4.0 * (0.04 + 0.04 + 0.06)).abs() < 1e-12);
        assert!(collider.corners.len() < mesh.vertices.len());
    }

    #[test]
    fn concave_edges_are_candidates_only_of_an_open_mesh() {
        // An L of two squares seen from outside, folded towards the viewer.
        let vertices = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [1.0, 0.5, 1.0],
        ];
        let mesh = |last: [u32; 3]| TriangleMesh {
            vertices: vertices.map(DVec3::from_array).to_vec(),
            triangles: vec![[0, 1, 2], last],
        };
        let edge = [1, 2];
        assert!(!is_candidate(&mesh([2, 1, 3]), edge, &[0, 1], false));
        assert!(is_candidate(&mesh([2, 1, 3]), edge, &[0, 1], true));
        // Faces that disagree about the outer side.
        assert!(is_candidate(&mesh([1, 2, 3]), edge, &[0, 1], false));
    }

    #[test]
    fn sphere_has_all_edges_but_the_flat_diagonals() {
        let mesh = builtin("sphere").unwrap();
        let collider = Collider::new(&mesh);
        let (triangles, edges) = (collider.triangles.len(), collider.edges.len());
        assert_eq!(collider.corners.len(), mesh.vertices.len());
        // A quad has two triangles and one diagonal; the caps have triangles without one.
        let all = mesh.edges().len();
        assert!(
            edges < all && edges > all - triangles / 2,
            "{edges} of {all}"
        );
    }
}
