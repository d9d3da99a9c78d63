//! Poses of object, gripper and gels at the time of an image.

use glam::DVec3;

use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh};
use gripcast_sim::fem::{GelGrid, GelPad, GelResolution, Side};
use gripcast_sim::grasp::Snapshot;

/// Poses of the object, the gripper and the gels.
#[derive(Clone, Debug)]
pub struct GraspState {
    /// Pose of the object in the world.
    pub t_world_object: Pose,
    /// Pose of the gripper in the world.
    pub t_world_gripper: Pose,
    /// Distance between the undeformed gel faces, m.
    pub opening_m: f64,
    /// Deformed gels in the world, left and right; if `None`, undeformed gels are rendered.
    pub gels: Option<[TriangleMesh; 2]>,
}

impl GraspState {
    /// State at a snapshot of a trace. `grid` is the mesh of its gels; `None` for the standard
    /// pads.
    ///
    /// # Errors
    /// `Input` if the number of gel nodes matches no known mesh.
    pub fn from_snapshot(snapshot: &Snapshot, grid: Option<&GelGrid>) -> Result<Self> {
        let [left, right] = &snapshot.gels;
        Ok(Self {
            t_world_object: snapshot.t_world_object,
            t_world_gripper: snapshot.t_world_gripper,
            opening_m: snapshot.opening_m,
            gels: Some([gel_surface(left, grid)?, gel_surface(right, grid)?]),
        })
    }
}

/// Returns the closed surface of a gel from its nodes in the world.
fn gel_surface(nodes: &[[f64; 3]], grid: Option<&GelGrid>) -> Result<TriangleMesh> {
    use GelResolution::{Coarse, Default, Fine};
    let standard = || {
        let fits = |r: &GelResolution| {
            r.nodes(&GelPad::default()).iter().product::<usize>() == nodes.len()
        };
        [Coarse, Default, Fine].into_iter().find(fits)
    };
    let built;
    let grid = match (grid, standard()) {
        (Some(grid), _) if grid.positions().len() == nodes.len() => grid,
        (_, Some(resolution)) => {
            built = GelPad::default().grid(resolution)?;
            &built
        }
        _ => {
            return Err(Error::input(format!(
                "the gel of the trace has {} nodes, which matches no standard pad",
                nodes.len()
            ))
            .remedy("give the gel mesh with which the grasp was simulated"));
        }
    };
    let sides = [
        Side::Front,
        Side::XMin,
        Side::XMax,
        Side::YMin,
        Side::YMax,
        Side::Back,
    ];
    let mesh = TriangleMesh {
        vertices: nodes.iter().map(|p| DVec3::from_array(*p)).collect(),
        triangles: sides
            .iter()
            .flat_map(|side| grid.triangles(*side))
            .copied()
            .collect(),
    };
    let surface = mesh.without_unused_vertices();
    surface.validate().map(|()| surface)
}
