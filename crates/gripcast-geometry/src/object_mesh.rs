//! Loads the mesh of an object for simulation: a file or a built-in shape, scaled and prepared.

use std::path::Path;

use super::{
    BUILTIN_NAMES, LengthUnit, MeshFormat, PrepareOptions, PreparedMesh, TriangleMesh, builtin,
    load_mesh, prepare, read_mesh,
};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Root, companions};

/// How the mesh of an object is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshOptions {
    /// Unit of the coordinates of a file. Default metres.
    pub unit: LengthUnit,
    /// Scale factor, above 0. Default 1.
    pub scale: f64,
    /// Checks and repairs, applied to the scaled mesh.
    pub prepare: PrepareOptions,
}

impl Default for MeshOptions {
    fn default() -> Self {
        Self::new(LengthUnit::Metre, 1.0)
    }
}

impl MeshOptions {
    /// With the default repairs.
    pub fn new(unit: LengthUnit, scale: f64) -> Self {
        Self {
            unit,
            scale,
            prepare: PrepareOptions::default(),
        }
    }
}

/// Loads `builtin:NAME` or a mesh file, scales and prepares it; the result is in metres.
///
/// # Errors
/// `Input` for a scale that is not above 0; those of [`load_mesh`] and [`prepare`].
pub fn load_object_mesh(source: &str, options: &MeshOptions) -> Result<PreparedMesh> {
    check_scale(options.scale)?;
    let path = Path::new(source);
    let mesh = if source.starts_with("builtin:") {
        builtin(source)?
    } else if BUILTIN_NAMES.contains(&source) && !path.exists() {
        return Err(missing_prefix(source));
    } else {
        load_mesh(path, options.unit)?
    };
    prepared(&mesh, options).map_err(|e| e.at(source))
}

/// [`load_object_mesh`] for a mesh that a file refers to: `builtin:NAME`, or a file below the
/// `folder` of that file or below an allowed folder.
///
/// # Errors
/// As [`load_object_mesh`]; `Input` for a path or a link that leads out of the folder.
pub fn load_object_mesh_below(
    folder: &Root,
    name: &str,
    options: &MeshOptions,
) -> Result<PreparedMesh> {
    if name.starts_with("builtin:") {
        return load_object_mesh(name, options);
    }
    check_scale(options.scale)?;
    let file = folder.resolve_allowed(name).map_err(|_| {
        let what = format!("the mesh {name:?} is not below the folder of the file that names it");
        Error::input(what).remedy(
            "copy the mesh beside that file, or allow its folder with \
             GRIPCAST__FILES__LINKED_FOLDERS",
        )
    })?;
    if BUILTIN_NAMES.contains(&name) && !file.is_taken() {
        return Err(missing_prefix(name));
    }
    let path = file.shown();
    let read = || {
        let format = MeshFormat::from_path(&path)?;
        let bytes = file.read(FileKind::Mesh).map_err(|e| {
            Error::io("cannot read the mesh", e).remedy("check the path and its permissions")
        })?;
        let mesh = read_mesh(&bytes, format, &companions(&path))?;
        prepared(&mesh.scaled(options.unit.in_metres()), options)
    };
    // The caller reads a file that names the mesh, and has no flags for it.
    let without_flag = |e: Error| match e.remedy_text() {
        Some(remedy) if remedy.contains("--unit") => {
            e.replace_remedy("check the unit or scale in the file that names the mesh")
        }
        Some(remedy) if remedy.contains("--wall-thickness-mm") => e.replace_remedy(
            "give the open surface a thickness in a mesh editor, or in an object file with \
                 `wall_thickness_mm`",
        ),
        Some(remedy) if remedy.contains(" --") => e.replace_remedy(
            "repair the mesh in a mesh editor, or in an object file with `repair = \"auto\"`",
        ),
        _ => e,
    };
    read().map_err(|e: Error| without_flag(e).at(path.display()))
}

/// Error for the name of a built-in shape without its prefix.
fn missing_prefix(name: &str) -> Error {
    Error::not_found("mesh file not found")
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

fn prepared(mesh: &TriangleMesh, options: &MeshOptions) -> Result<PreparedMesh> {
    prepare(&mesh.scaled(options.scale), &options.prepare)
}
