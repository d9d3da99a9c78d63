//! Intersection tests of two shapes.

use glam::DVec3;
use rapier3d_f64::geometry::SharedShape;
use rapier3d_f64::parry::query::intersection_test;

use super::convert;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh};

/// A shape for collision tests, in its own frame, m.
pub struct CollisionShape(SharedShape);

impl CollisionShape {
    /// Surface of a mesh; a shape entirely inside it does not intersect it.
    ///
    /// # Errors
    /// `Input` for a mesh without triangles.
    pub fn surface(mesh: &TriangleMesh) -> Result<Self> {
        let vertices = mesh.vertices.iter().map(|v| convert::vector(*v));
        let surface = SharedShape::trimesh(vertices.collect(), mesh.triangles.clone());
        surface
            .map(Self)
            .map_err(|e| Error::input("cannot use the mesh for collision tests").because(e))
    }

    /// Convex solid; `None` without volume.
    pub fn solid(vertices: &[DVec3], triangles: &[[u32; 3]]) -> Option<Self> {
        let points = vertices.iter().map(|v| convert::vector(*v)).collect();
        SharedShape::convex_mesh(points, triangles).map(Self)
    }

    /// Whether this shape at `pose` intersects another one at `other_pose`.
    ///
    /// # Errors
    /// `Internal` for an unsupported pair of shapes.
    pub fn intersects(&self, pose: &Pose, other: &Self, other_pose: &Pose) -> Result<bool> {
        let (pose, other_pose) = (convert::pose(pose), convert::pose(other_pose));
        intersection_test(&pose, self.0.as_ref(), &other_pose, other.0.as_ref())
            .map(|hit| hit.intersecting)
            .map_err(|e| Error::internal("cannot test these shapes for collision").because(e))
    }
}
