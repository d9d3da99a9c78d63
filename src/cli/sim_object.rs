//! The object of a simulation: a mesh file or a built-in shape, checked and at rest.

use serde::Serialize;

use gripcast_base::error::{Error, Result};
use gripcast_geometry::{LengthUnit, PreparedMesh, TriangleMesh, load_object_mesh};

/// Flags that choose the object.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "What is grasped")]
pub(super) struct ObjectFlags {
    /// Mesh file (obj, stl, ply, glb, gltf) or builtin:NAME (box, sphere, cylinder, mug, wedge,
    /// bar, spike, ball, bottle, jack, star, dented, ring, saddle, lump)
    #[arg(long, value_name = "MESH|builtin:NAME")]
    pub(super) object: String,
    /// Unit of the coordinates in the mesh file: mm, cm, m, in
    #[arg(long, default_value_t = LengthUnit::Metre, value_parser = unit)]
    pub(super) unit: LengthUnit,
    /// Factor on the size of the mesh
    #[arg(long, default_value_t = 1.0)]
    pub(super) scale: f64,
    /// Mass of the object
    #[arg(long, value_name = "KG", default_value_t = 0.06)]
    pub(super) mass_kg: f64,
    /// Coulomb friction coefficient of gel and object, and of object and ground
    #[arg(long, value_name = "MU", default_value_t = 0.4)]
    pub(super) friction: f64,
}

pub(super) fn unit(text: &str) -> Result<LengthUnit, String> {
    text.parse()
        .map_err(|_| "must be mm, cm, m or in".to_owned())
}

/// A mesh that can be simulated.
pub(super) struct SimObject {
    pub(super) mesh: TriangleMesh,
    pub(super) warnings: Vec<String>,
}

/// What is said about the object in a result.
#[derive(Debug, Serialize)]
pub(super) struct ObjectRecord {
    source: String,
    unit: String,
    scale: f64,
    sha256: String,
    triangles: usize,
    size_m: [f64; 3],
    mass_kg: f64,
    friction: f64,
}

impl SimObject {
    /// Reads, scales and checks the object.
    pub(super) fn load(flags: &ObjectFlags) -> Result<Self> {
        Self::read(&flags.object, flags.unit, flags.scale)
    }

    /// The same of a mesh file or `builtin:NAME`.
    pub(super) fn read(name: &str, unit: LengthUnit, scale: f64) -> Result<Self> {
        if !(scale.is_finite() && scale > 0.0) {
            return Err(Error::input(format!(
                "`--scale` must be a number above 0, found {scale}"
            )));
        }
        let PreparedMesh { mesh, warnings } = load_object_mesh(name, unit, scale)?;
        Ok(Self { mesh, warnings })
    }

    /// What is said about it in a result.
    pub(super) fn record(&self, flags: &ObjectFlags) -> ObjectRecord {
        ObjectRecord {
            source: flags.object.clone(),
            unit: flags.unit.to_string(),
            scale: flags.scale,
            sha256: self.mesh.content_hash(),
            triangles: self.mesh.triangles.len(),
            size_m: self.mesh.bounds().extent().to_array(),
            mass_kg: flags.mass_kg,
            friction: flags.friction,
        }
    }
}
