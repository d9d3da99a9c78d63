//! Mesh files. Input: format (byte 0, modulo 4), file.

use std::io::{Error, ErrorKind};

use gripcast_geometry::{MeshFormat, read_mesh, read_textured_mesh};

/// Panics where something is wrong.
pub(crate) fn check(input: &[u8]) {
    let Some((format, file)) = input.split_first() else {
        return;
    };
    let format = [
        MeshFormat::Obj,
        MeshFormat::Stl,
        MeshFormat::Ply,
        MeshFormat::Gltf,
    ][usize::from(*format) % 4];
    // Whatever a file refers to is the file itself: a buffer, a material library.
    let beside = |name: &str| match name {
        "missing" => Err(Error::from(ErrorKind::NotFound)),
        _ => Ok(file.to_vec()),
    };
    if let Ok(mesh) = read_mesh(file, format, &beside) {
        mesh.validate().expect("a mesh that was read is valid");
        let _ = mesh.scaled(0.001);
    }
    if let Ok(mesh) = read_textured_mesh(file, format, &beside) {
        for part in &mesh.parts {
            part.shape
                .validate()
                .expect("a part that was read is valid");
        }
    }
}
