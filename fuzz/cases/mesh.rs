//! Mesh files and their repair. Input: format (byte 0, modulo 4), repair (byte 0 over 4, modulo 3) and
//! wall (byte 0 from 128), file.

use std::io::{Error, ErrorKind};

use gripcast_geometry::{
    MeshFormat, PrepareOptions, Repair, prepare, read_mesh, read_textured_mesh,
};

/// Larger meshes are only read: repairs are not what makes them slow to fuzz.
const MAX_TRIANGLES: usize = 2000;

/// Panics where something is wrong.
pub(crate) fn check(input: &[u8]) {
    let Some((format_byte, file)) = input.split_first() else {
        return;
    };
    let format = [
        MeshFormat::Obj,
        MeshFormat::Stl,
        MeshFormat::Ply,
        MeshFormat::Gltf,
    ][usize::from(*format_byte) % 4];
    // Whatever a file refers to is the file itself: a buffer, a material library.
    let beside = |name: &str| match name {
        "missing" => Err(Error::from(ErrorKind::NotFound)),
        _ => Ok(file.to_vec()),
    };
    if let Ok(mesh) = read_mesh(file, format, &beside) {
        mesh.validate().expect("a mesh that was read is valid");
        let size = mesh.bounds().extent().max_element();
        if mesh.triangles.len() <= MAX_TRIANGLES && size.is_finite() && size > 0.0 {
            let options = PrepareOptions {
                repair: Repair::ALL[usize::from(*format_byte / 4) % 3],
                wall_thickness_m: (*format_byte >= 128).then_some(0.002),
                ..PrepareOptions::default()
            };
            if let Ok(prepared) = prepare(&mesh.scaled(0.08 / size), &options) {
                let solid = prepared.solid.expect("a mass needs an inside");
                assert!(solid.properties.volume_m3 > 0.0 && solid.uncertainty.is_finite());
            }
        }
    }
    if let Ok(mesh) = read_textured_mesh(file, format, &beside) {
        for part in &mesh.parts {
            part.shape
                .validate()
                .expect("a part that was read is valid");
        }
    }
}
