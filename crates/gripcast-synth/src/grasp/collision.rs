//! Collisions of the open gripper with the object or the ground.

use std::sync::OnceLock;

use glam::DVec3;

use gripcast_base::error::Result;
use gripcast_geometry::{Pose, TriangleMesh, convex_hull};
use gripcast_sim::grasp::GripperState;
use gripcast_sim::rigid::CollisionShape;
use gripcast_visual::{GripperPart, gripper_parts};

/// An object as an obstacle for the gripper.
pub struct Obstacle {
    surface: CollisionShape,
    t_world_object: Pose,
}

impl Obstacle {
    /// Creates an obstacle: the object (m, its own frame) at `t_world_object` on the ground z = 0.
    ///
    /// # Errors
    /// `Input` for a mesh without triangles.
    pub fn new(object: &TriangleMesh, t_world_object: Pose) -> Result<Self> {
        Ok(Self {
            surface: CollisionShape::surface(object)?,
            t_world_object,
        })
    }
}

/// Finds a part of the gripper that is inside the object or below the ground. Parts are replaced by
/// their convex hulls.
///
/// # Errors
/// `Input` for an opening out of the gripper's range.
pub fn find_collision(placed: &GripperState, obstacle: &Obstacle) -> Result<Option<String>> {
    let t_world_gripper = placed.t_world_gripper;
    for (part, solid) in gripper_parts(placed.opening_m)?.iter().zip(solids()?) {
        // Parts move with the opening but keep their shape.
        let moved_m = part.shape.vertices[0] - solid.reference_m;
        let t_world_solid = t_world_gripper * Pose::from_translation(moved_m);
        let height = |v: &DVec3| t_world_solid.transform_point(*v).z;
        if solid.corners.iter().any(|v| height(v) < 0.0) {
            return Ok(Some(part.name.clone()));
        }
        let Some(shape) = &solid.shape else {
            continue;
        };
        let surface = &obstacle.surface;
        if surface.intersects(&obstacle.t_world_object, shape, &t_world_solid)? {
            return Ok(Some(part.name.clone()));
        }
    }
    Ok(None)
}

/// Convex hull of a part of the gripper at [`REFERENCE_M`].
struct Solid {
    /// First vertex of the part, m.
    reference_m: DVec3,
    corners: Vec<DVec3>,
    /// None for a hull without volume.
    shape: Option<CollisionShape>,
}

/// Opening at which the hulls are computed, m.
const REFERENCE_M: f64 = 0.08;

/// Returns the hulls of all parts, in the order of [`gripper_parts`].
fn solids() -> Result<&'static [Solid]> {
    static SOLIDS: OnceLock<Vec<Solid>> = OnceLock::new();
    if let Some(solids) = SOLIDS.get() {
        return Ok(solids);
    }
    let parts = gripper_parts(REFERENCE_M)?;
    let solids: Vec<Solid> = parts.iter().map(solid).collect::<Result<_>>()?;
    Ok(SOLIDS.get_or_init(|| solids))
}

fn solid(part: &GripperPart) -> Result<Solid> {
    let hull = convex_hull(&part.shape.vertices)?;
    Ok(Solid {
        reference_m: part.shape.vertices[0],
        shape: CollisionShape::solid(&hull.vertices, &hull.triangles),
        corners: hull.vertices,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::builtin;
    use gripcast_sim::grasp::Placement;

    fn placed(height_m: f64, opening_m: f64) -> GripperState {
        GripperState {
            t_world_gripper: Pose::new(
                glam::DQuat::from_rotation_x(std::f64::consts::PI),
                DVec3::Z * height_m,
            ),
            opening_m,
        }
    }

    #[test]
    fn default_grasp_is_free_and_bad_ones_collide() {
        let mesh = builtin("box").unwrap();
        let on_ground = Pose::from_translation(DVec3::Z * 0.03);
        let obstacle = Obstacle::new(&mesh, on_ground).unwrap();
        let usual = Placement::default().place(&mesh, &on_ground).unwrap();
        assert_eq!(find_collision(&usual, &obstacle).unwrap(), None);
        let narrow = find_collision(&placed(0.04, 0.03), &obstacle).unwrap();
        assert!(narrow.is_some(), "a gel is inside the box");
        let low = find_collision(&placed(0.004, 0.06), &obstacle).unwrap();
        assert!(low.is_some(), "a finger is below the ground");
        assert!(find_collision(&placed(0.04, 0.3), &obstacle).is_err());
    }

    #[test]
    fn rail_collides_with_a_tall_object() {
        let mesh = builtin("bar").unwrap();
        let upright = Pose::from_translation(DVec3::Z * 0.06);
        let obstacle = Obstacle::new(&mesh, upright).unwrap();
        assert_eq!(
            find_collision(&placed(0.11, 0.05), &obstacle).unwrap(),
            None
        );
        // The rail is 101 mm above the gel centres, the bar 120 mm high.
        let low = find_collision(&placed(0.014, 0.05), &obstacle).unwrap();
        assert_eq!(low.as_deref(), Some("rail"));
    }
}
