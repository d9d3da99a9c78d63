//! An object of a dataset: `OBJECTS/NAME.toml`.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::{Error, ErrorKind, Result};
use crate::files::save;
use crate::geometry::Pose;

/// What is known of an object besides its name, which is that of the file.
///
/// ```toml
/// schema = 1
/// mesh = "b1.obj"            # relative to this file, or builtin:NAME
/// unit = "mm"                # of the file's coordinates; not for builtin:NAME
/// scale = 1.0
/// mesh_sha256 = "…"          # optional: what `gripcast sim grasp --json` prints for the mesh
/// mass_kg = 0.070
/// stable_pose = 0            # or t_world_object = { t_m = [x, y, z], q_wxyz = [w, x, y, z] }
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectFile {
    /// Version of the format, 1.
    pub schema: u32,
    /// Mesh file, relative to the object file, or `builtin:NAME`.
    pub mesh: String,
    /// Unit of the mesh file's coordinates: `mm`, `cm`, `m`, `in`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Factor on the size of the mesh.
    #[serde(default = "one")]
    pub scale: f64,
    /// Hash of the mesh as simulated, in metres: a mesh that changed since is refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesh_sha256: Option<String>,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Number of the stable pose that it lies in, the most probable being 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stable_pose: Option<usize>,
    /// Its pose on the ground, z up, ground z = 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub t_world_object: Option<Pose>,
}

fn one() -> f64 {
    1.0
}

impl ObjectFile {
    /// Writes the file.
    ///
    /// # Errors
    /// That of the operating system.
    pub fn save(&self, path: &Path) -> Result<()> {
        let text = toml::to_string(self).map_err(|e| {
            Error::new(ErrorKind::Internal, "cannot write the object file").because(e)
        })?;
        save(path, text.as_bytes())
    }
}
