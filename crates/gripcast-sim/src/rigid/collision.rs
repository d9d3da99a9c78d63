//! Whether two shapes overlap.

use glam::DVec3;
use rapier3d_f64::geometry::SharedShape;
use rapier3d_f64::parry::query::intersection_test;

use super::convert;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh};

/// A shape that can be tested for collisions, in its own frame, m.
pub struct CollisionShape(SharedShape);

impl CollisionShape {
    /// The surface of a mesh; what lies wholly inside it does not touch it.
    ///
    /// # Errors
    /// `Input` for a mesh without triangles.
    pub fn surface(mesh: &TriangleMesh) -> Result<Self> {
        let vertices = mesh.vertices.iter().map(|v| convert::vector(*v));
        let surface = SharedShape::trimesh(vertices.collect(), mesh.triangles.clone());
        surface
            .map(Self)
            .map_err(|e| Error::input("the mesh cannot be tested for collisions").because(e))
    }

    /// A solid by its convex hull; none for a hull without volume.
    pub fn solid(vertices: &[DVec3], triangles: &[[u32; 3]]) -> Option<Self> {
        let points = vertices.iter().map(|v| convert::vector(*v)).collect();
        SharedShape::convex_mesh(points, triangles).map(Self)
    }

    /// Whether the shape at one pose and another at another overlap.
    ///
    /// # Errors
    /// `Internal` for kinds of shapes that cannot be compared.
    pub fn intersects(&self, at: &Pose, other: &Self, other_at: &Pose) -> Result<bool> {
        let (place, other_place) = (convert::pose(at), convert::pose(other_at));
        let hit = intersection_test(&place, self.0.as_ref(), &other_place, other.0.as_ref());
        let hit =
            hit.map_err(|e| Error::internal("shapes cannot be tested for collisions").because(e))?;
        Ok(hit.intersecting)
    }
}
