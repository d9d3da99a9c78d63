//! The mesh of an object to simulate: a file or a built-in shape, scaled, checked and repaired.

use std::path::Path;

use super::{
    BUILTIN_NAMES, LengthUnit, MeshFormat, PrepareOptions, Prepared, TriangleMesh, builtin,
    load_mesh, prepare, read_mesh,
};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Root, companions};

/// Reads `builtin:NAME` or a mesh file whose coordinates are in `unit`, scales it and makes it
/// fit for simulation; in metres.
///
/// # Errors
/// `Input` for a scale that is not above 0; `NotFound`, `Io`, `Input` of reading the mesh; those
/// of [`prepare`].
pub fn load_object_mesh(source: &str, unit: LengthUnit, scale: f64) -> Result<Prepared> {
    check_scale(scale)?;
    let path = Path::new(source);
    let mesh = if source.starts_with("builtin:") {
        builtin(source)?
    } else if BUILTIN_NAMES.contains(&source) && !path.exists() {
        return Err(bare_name(source));
    } else {
        load_mesh(path, unit)?
    };
    prepared(&mesh, scale).map_err(|e| e.at(source))
}

/// The same of a mesh that a file names: `builtin:NAME`, or a file below the `folder` of that file
/// or a folder that the user allowed.
///
/// # Errors
/// As [`load_object_mesh`]; `Input` for a path or a link that leads out of the folder.
pub fn load_object_mesh_below(
    folder: &Root,
    named: &str,
    unit: LengthUnit,
    scale: f64,
) -> Result<Prepared> {
    if named.starts_with("builtin:") {
        return load_object_mesh(named, unit, scale);
    }
    check_scale(scale)?;
    let place = folder.resolve_allowed(named).map_err(|_| {
        let what = format!("the mesh {named:?} is not below the folder of the file that names it");
        Error::input(what).remedy(
            "copy the mesh beside that file, or allow its folder with \
             GRIPCAST__FILES__LINKED_FOLDERS",
        )
    })?;
    if BUILTIN_NAMES.contains(&named) && !place.is_taken() {
        return Err(bare_name(named));
    }
    let path = place.shown();
    let read = || {
        let format = MeshFormat::of_path(&path)?;
        let bytes = place.read(FileKind::Mesh).map_err(|e| {
            Error::io("cannot read the mesh", e).remedy("check the path and its permissions")
        })?;
        let mesh = read_mesh(&bytes, format, &companions(&path))?;
        prepared(&mesh.scaled(unit.in_metres()), scale)
    };
    read().map_err(|e: Error| e.at(path.display()))
}

/// The name of a built-in shape where a file was expected.
fn bare_name(name: &str) -> Error {
    Error::not_found("there is no such mesh file")
        .at(name)
        .remedy(format!("the built-in shape is builtin:{name}"))
}

fn check_scale(scale: f64) -> Result<()> {
    if scale.is_finite() && scale > 0.0 {
        return Ok(());
    }
    Err(Error::input(format!(
        "the scale must be a number above 0, found {scale}"
    )))
}

fn prepared(mesh: &TriangleMesh, scale: f64) -> Result<Prepared> {
    prepare(&mesh.scaled(scale), &PrepareOptions::default())
}
