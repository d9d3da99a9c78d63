//! The mesh of a planned object, made or read again.

use std::path::Path;

use super::family::{Category, family_shape};
use super::plan::{MeshSource, PlannedObject};
use crate::error::{Error, ErrorKind, Result};
use crate::geometry::{TriangleMesh, load_object_mesh};

/// The mesh of an object, m. `folder` is that of the plan, to which relative paths are relative.
///
/// # Errors
/// Those of reading the file; `Input` for a mesh that is not the planned one.
pub fn planned_mesh(object: &PlannedObject, folder: &Path) -> Result<TriangleMesh> {
    let mesh = match &object.mesh {
        MeshSource::Family { category, seed } => {
            family_shape(Category::parse(category)?, *seed)?.mesh
        }
        MeshSource::File { path, unit, scale } => {
            let source = if path.starts_with("builtin:") {
                path.clone()
            } else {
                folder.join(path).to_string_lossy().into_owned()
            };
            load_object_mesh(&source, unit.parse()?, *scale)?.mesh
        }
    };
    let found = mesh.content_hash();
    if found == object.mesh_sha256 {
        return Ok(mesh);
    }
    Err(Error::new(
        ErrorKind::Input,
        format!(
            "the mesh of {} changed: expected {}, found {found}",
            object.name, object.mesh_sha256
        ),
    )
    .remedy("restore the mesh file, or make a new plan in another folder"))
}
