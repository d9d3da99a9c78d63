//! The object of a command: a mesh file or a built-in shape.

use std::path::Path;

use serde::Serialize;

use super::flags::{above_zero, number, read_text};
use super::mesh_repair::RepairFlags;
use gripcast_base::error::Result;
use gripcast_base::number::NumberRange;
use gripcast_geometry::{
    LengthUnit, MeshOptions, Pose, PrepareOptions, PreparedMesh, Solid, TriangleMesh,
    load_object_mesh,
};
use gripcast_sim::grasp::{GraspPose, resting_pose};

/// Options that choose a mesh.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct MeshFlags {
    /// Mesh file (obj, stl, ply, glb, gltf) or builtin:NAME (box, sphere, cylinder, mug, wedge,
    /// bar, spike, ball, bottle, jack, star, dented, ring, saddle, lump)
    #[arg(long, value_name = "MESH|builtin:NAME")]
    pub(super) object: String,
    /// Unit of the mesh coordinates: mm, cm, m, in
    #[arg(long, default_value_t = LengthUnit::Metre)]
    unit: LengthUnit,
    /// Scale factor of the mesh
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = above_zero)]
    scale: f64,
    #[command(flatten)]
    repair: RepairFlags,
}

impl MeshFlags {
    /// Reads, scales and checks a mesh that has a mass.
    pub(super) fn load(&self) -> Result<PreparedMesh> {
        self.load_with(self.repair.options())
    }

    /// Reads, scales and checks a mesh of which only the surface is used.
    pub(super) fn load_surface(&self) -> Result<PreparedMesh> {
        self.load_with(self.repair.surface_options())
    }

    fn load_with(&self, prepare: PrepareOptions) -> Result<PreparedMesh> {
        let options = MeshOptions {
            prepare,
            ..MeshOptions::new(self.unit, self.scale)
        };
        load_object_mesh(&self.object, &options)
    }
}

/// Options that choose a simulated object.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Object")]
pub(super) struct ObjectFlags {
    #[command(flatten)]
    pub(super) mesh: MeshFlags,
    /// Mass of the object
    #[arg(long, value_name = "KG", default_value_t = 0.06, value_parser = above_zero)]
    pub(super) mass_kg: f64,
    /// Coulomb friction coefficient (gel–object and object–ground)
    #[arg(long, value_name = "MU", default_value_t = 0.4,
        value_parser = number(NumberRange::NOT_NEGATIVE))]
    pub(super) friction: f64,
}

/// The mesh in a result.
#[derive(Debug, Serialize)]
pub(super) struct MeshRecord {
    source: String,
    unit: String,
    scale: f64,
    repair: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    wall_thickness_mm: Option<f64>,
    sha256: String,
    pub(super) triangles: usize,
    pub(super) size_m: [f64; 3],
    #[serde(flatten)]
    pub(super) solid: Option<SolidRecord>,
}

/// The inside of a mesh in a result.
#[derive(Debug, Serialize)]
pub(super) struct SolidRecord {
    pub(super) volume_m3: f64,
    /// As a fraction of the volume.
    pub(super) volume_uncertainty: f64,
    /// Volume that several pieces share, as a fraction of the volume.
    overlap: f64,
    /// Area of the holes, as a fraction of the surface.
    hole_area: f64,
    pub(super) center_of_mass_m: [f64; 3],
}

impl From<&Solid> for SolidRecord {
    fn from(solid: &Solid) -> Self {
        Self {
            volume_m3: solid.properties.volume_m3,
            volume_uncertainty: solid.uncertainty,
            overlap: solid.overlap,
            hole_area: solid.hole_area,
            center_of_mass_m: solid.properties.center_of_mass_m.to_array(),
        }
    }
}

impl MeshRecord {
    pub(super) fn new(flags: &MeshFlags, prepared: &PreparedMesh) -> Self {
        let mesh = &prepared.mesh;
        Self {
            source: flags.object.clone(),
            unit: flags.unit.to_string(),
            scale: flags.scale,
            repair: flags.repair.repair.to_string(),
            wall_thickness_mm: flags.repair.wall_thickness_mm,
            sha256: mesh.content_hash(),
            triangles: mesh.triangles.len(),
            size_m: mesh.bounds().extent().to_array(),
            solid: prepared.solid.as_ref().map(SolidRecord::from),
        }
    }
}

/// The object in a result.
#[derive(Debug, Serialize)]
pub(super) struct ObjectRecord {
    #[serde(flatten)]
    mesh: MeshRecord,
    mass_kg: f64,
    friction: f64,
}

impl ObjectRecord {
    pub(super) fn new(flags: &ObjectFlags, prepared: &PreparedMesh) -> Self {
        Self {
            mesh: MeshRecord::new(&flags.mesh, prepared),
            mass_kg: flags.mass_kg,
            friction: flags.friction,
        }
    }
}

/// Reads a pose file with `t_object_gripper`.
pub(super) fn read_grasp_pose(path: &Path) -> Result<GraspPose> {
    GraspPose::from_json(&read_text(path, "pose")?).map_err(|e| e.at(path.display()))
}

/// Returns the default resting pose of a mesh, `t_world_object`.
pub(super) fn default_resting_pose(mesh: &TriangleMesh) -> Result<Pose> {
    Ok(resting_pose(mesh, None)?.1.t_world_object)
}
