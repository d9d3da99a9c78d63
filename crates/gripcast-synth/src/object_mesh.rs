//! Meshes of planned objects.

use super::family::{Category, family_shape};
use super::plan::{MESHES, MeshSource, PlannedObject};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, FileName, Root};
use gripcast_geometry::{MeshFormat, TriangleMesh, read_textured_mesh};

/// Generates or reads the mesh of a planned object, m; `root` is the plan's folder.
///
/// # Errors
/// Errors of reading the file; `Input` if the mesh is not the planned one.
pub fn planned_mesh(object: &PlannedObject, root: &Root) -> Result<TriangleMesh> {
    let mesh = match &object.mesh {
        MeshSource::Family { category, seed } => family_shape(Category::parse(category)?, *seed)?,
        MeshSource::File { file } => stored_mesh(root, file)?,
    };
    let found = mesh.content_hash();
    if found == object.mesh_sha256 {
        return Ok(mesh);
    }
    Err(Error::input(format!(
        "the mesh of {} changed: expected {}, found {found}",
        object.name, object.mesh_sha256
    ))
    .remedy("restore the mesh file, or create the plan again in another folder"))
}

/// Reads a mesh file of the plan without changing a vertex.
fn stored_mesh(root: &Root, file: &FileName) -> Result<TriangleMesh> {
    let path = root.top().join(MESHES).join(file);
    let read = || {
        let bytes = path
            .read(FileKind::Mesh)
            .map_err(|e| Error::io("cannot read the mesh", e))?;
        // `read_mesh` would merge vertices that were split to make the surface manifold.
        read_textured_mesh(&bytes, MeshFormat::Ply, &|_| {
            Err(std::io::ErrorKind::NotFound.into())
        })
    };
    let mesh = read().map_err(|e: Error| e.at(path.display()))?;
    Ok(mesh
        .parts
        .into_iter()
        .next()
        .map_or_else(TriangleMesh::default, |part| part.shape))
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;
    use std::os::unix::fs::symlink;

    use super::*;
    use crate::plan::sample_plan;
    use gripcast_geometry::{builtin, ply_bytes};

    fn object(mesh: &TriangleMesh) -> PlannedObject {
        PlannedObject {
            mesh: MeshSource::File {
                file: FileName::parse("part.ply").unwrap(),
            },
            mesh_sha256: mesh.content_hash(),
            ..sample_plan(1).objects.into_values().next().unwrap()
        }
    }

    #[test]
    fn stored_mesh_reads_back_bit_identical() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join(MESHES)).unwrap();
        // Two bodies that touch at a duplicated vertex; one coordinate is -0.
        let one = builtin("box").unwrap();
        let offset = one.bounds().max - one.bounds().min;
        let mut both = one.clone();
        let first = both.vertices.len() as u32;
        both.vertices
            .extend(one.vertices.iter().map(|v| *v + offset));
        both.triangles
            .extend(one.triangles.iter().map(|t| t.map(|v| v + first)));
        both.vertices[0].x = -0.0;
        fs::write(folder.path().join("meshes/part.ply"), ply_bytes(&both)).unwrap();
        let root = Root::new(folder.path());
        let found = planned_mesh(&object(&both), &root).unwrap();
        assert_eq!(found.content_hash(), both.content_hash());
        let error = planned_mesh(&object(&one), &root).unwrap_err();
        assert!(error.to_string().contains("changed"), "{error}");
    }

    #[test]
    fn mesh_outside_of_the_plan_is_not_read() {
        let dir = tempfile::tempdir().unwrap();
        let mesh = builtin("box").unwrap();
        fs::write(dir.path().join("secret.ply"), ply_bytes(&mesh)).unwrap();
        fs::create_dir_all(dir.path().join("plan/meshes")).unwrap();
        let link = dir.path().join("plan/meshes/part.ply");
        symlink("../../secret.ply", link).unwrap();
        let root = Root::new(dir.path().join("plan"));
        let error = planned_mesh(&object(&mesh), &root).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        assert!(error.to_string().contains("leads out of"), "{error}");
    }
}
