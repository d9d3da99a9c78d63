//! The mesh of an object to simulate: a file or a built-in shape, scaled, checked and mended.

use std::path::Path;

use super::{BUILTIN_NAMES, LengthUnit, PrepareOptions, Prepared, builtin, load_mesh, prepare};
use crate::error::{Error, ErrorKind, Result};

/// Reads `builtin:NAME` or a mesh file whose coordinates are in `unit`, scales it and makes it
/// fit for simulation; in metres.
///
/// # Errors
/// `Input` for a scale that is not above 0; `NotFound`, `Io`, `Input` of reading the mesh; those
/// of [`prepare`].
pub fn load_object_mesh(source: &str, unit: LengthUnit, scale: f64) -> Result<Prepared> {
    if !(scale.is_finite() && scale > 0.0) {
        return Err(Error::new(
            ErrorKind::Input,
            format!("the scale must be a number above 0, found {scale}"),
        ));
    }
    let path = Path::new(source);
    let mesh = if source.starts_with("builtin:") {
        builtin(source)?
    } else if BUILTIN_NAMES.contains(&source) && !path.exists() {
        return Err(
            Error::new(ErrorKind::NotFound, "there is no such mesh file")
                .at(source)
                .remedy(format!("the built-in shape is builtin:{source}")),
        );
    } else {
        load_mesh(path, unit)?
    };
    prepare(&mesh.scaled(scale), &PrepareOptions::default()).map_err(|e| e.at(source))
}
