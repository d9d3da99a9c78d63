//! The mesh of a planned object, made or read again.

use super::family::{Category, family_shape};
use super::plan::{MESHES, MeshSource, PlannedObject};
use crate::error::{Error, ErrorKind, Result};
use crate::files::{FileKind, FileName, Root};
use crate::geometry::{MeshFormat, TriangleMesh, read_textured_mesh};

/// The mesh of an object, m; `root` is the folder of the plan.
///
/// # Errors
/// Those of reading the file; `Input` for a mesh that is not the planned one.
pub fn planned_mesh(object: &PlannedObject, root: &Root) -> Result<TriangleMesh> {
    let mesh = match &object.mesh {
        MeshSource::Family { category, seed } => {
            family_shape(Category::parse(category)?, *seed)?.mesh
        }
        MeshSource::File { file } => stored_mesh(root, file)?,
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
    .remedy("restore the mesh file, or make the plan again in another folder"))
}

/// The mesh in a file of the plan, bit for bit.
fn stored_mesh(root: &Root, file: &FileName) -> Result<TriangleMesh> {
    let place = root.top().join(MESHES).join(file);
    let read = || {
        let bytes = place
            .read(FileKind::Mesh)
            .map_err(|e| Error::io("cannot read the mesh", e))?;
        // `read_mesh` would merge vertices that were parted to make the surface manifold.
        read_textured_mesh(&bytes, MeshFormat::Ply, &|_| {
            Err(std::io::ErrorKind::NotFound.into())
        })
    };
    let mesh = read().map_err(|e: Error| e.at(place.display()))?;
    Ok(mesh.parts.into_iter().next().map_or_else(TriangleMesh::default, |part| part.shape))
}
