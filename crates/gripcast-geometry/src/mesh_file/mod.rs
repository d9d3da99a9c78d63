//! Meshes in files: OBJ, STL, PLY and glTF in, OBJ and PLY out.
//!
//! Polygons become fans of triangles, and vertices with equal coordinates become one. Colours,
//! normals, materials and texture coordinates are left out.

mod appearance;
mod glb;
mod glb_material;
mod mtl;
mod obj;
mod ply;
mod stl;
mod textured;

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use glam::DVec3;

pub use appearance::{ImageSource, MeshMaterial};
pub use textured::{MeshPart, TexturedMesh, load_textured_mesh, read_textured_mesh};

use super::mesh::TriangleMesh;
use super::weld::weld;
use gripcast_base::error::{Error, Result, nearest_name};
use gripcast_base::files::{FileKind, companions, read_regular, save};

const SUFFIXES: [&str; 5] = ["obj", "stl", "ply", "glb", "gltf"];

/// Unit of the coordinates in a mesh file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LengthUnit {
    /// `mm`
    Millimetre,
    /// `cm`
    Centimetre,
    /// `m`, the unit of glTF and of all that gripcast writes.
    #[default]
    Metre,
    /// `in`, 25.4 mm
    Inch,
}

impl LengthUnit {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Millimetre, Self::Centimetre, Self::Metre, Self::Inch];

    /// Length of one unit, m.
    pub fn in_metres(self) -> f64 {
        match self {
            Self::Millimetre => 1e-3,
            Self::Centimetre => 1e-2,
            Self::Metre => 1.0,
            Self::Inch => 25.4e-3,
        }
    }
}

impl fmt::Display for LengthUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Millimetre => "mm",
            Self::Centimetre => "cm",
            Self::Metre => "m",
            Self::Inch => "in",
        })
    }
}

impl FromStr for LengthUnit {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|unit| unit.to_string() == text);
        known.ok_or_else(|| {
            Error::usage(format!("{text:?} is not a length unit that is known"))
                .remedy("use mm, cm, m or in")
        })
    }
}

/// Format of a mesh file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// Wavefront OBJ.
    Obj,
    /// STL, binary or text.
    Stl,
    /// PLY, binary or text.
    Ply,
    /// glTF 2.0, binary (`.glb`) or text (`.gltf`).
    Gltf,
}

impl MeshFormat {
    /// Format by the suffix of a path, in upper or lower case.
    ///
    /// # Errors
    /// `Input` for an unknown suffix.
    pub fn of_path(path: &Path) -> Result<Self> {
        let suffix = path.extension().unwrap_or_default().to_string_lossy();
        match suffix.to_ascii_lowercase().as_str() {
            "obj" => Ok(Self::Obj),
            "stl" => Ok(Self::Stl),
            "ply" => Ok(Self::Ply),
            "glb" | "gltf" => Ok(Self::Gltf),
            other => Err(unknown_suffix(other).at(path.display())),
        }
    }
}

fn unknown_suffix(suffix: &str) -> Error {
    let nearest = nearest_name(suffix, SUFFIXES).filter(|_| !suffix.is_empty());
    let hint = nearest.map_or(String::new(), |n| format!("did you mean .{n}? "));
    Error::input(format!(
        "a mesh file must end in a known suffix, found {suffix:?}"
    ))
    .remedy(format!(
        "{hint}convert it to one of: .{}",
        SUFFIXES.join(" .")
    ))
}

/// Reads a mesh file whose coordinates are in `unit`; the result is in metres.
///
/// # Errors
/// `NotFound`, `Permission`, `Io` if the file cannot be read; `Input` if the suffix is unknown
/// or the content is no mesh: empty, cut off, indices out of range, coordinates that are not
/// finite.
pub fn load_mesh(path: &Path, unit: LengthUnit) -> Result<TriangleMesh> {
    let format = MeshFormat::of_path(path)?;
    let bytes = file_bytes(path)?;
    read_mesh(&bytes, format, &companions(path))
        .map(|mesh| mesh.scaled(unit.in_metres()))
        .map_err(|e| e.at(path.display()))
}

/// The bytes of a mesh file.
fn file_bytes(path: &Path) -> Result<Vec<u8>> {
    read_regular(path, FileKind::Mesh).map_err(|e| {
        Error::io("cannot read the mesh", e)
            .at(path.display())
            .remedy("check the path and its permissions")
    })
}

/// Parses a mesh; coordinates stay in the unit of the file. `beside` reads a file that a glTF
/// text refers to by a relative path.
///
/// # Errors
/// `Input` if the content is no mesh.
pub fn read_mesh(
    bytes: &[u8],
    format: MeshFormat,
    beside: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
) -> Result<TriangleMesh> {
    refuse_placeholders(bytes)?;
    let mesh = match format {
        MeshFormat::Obj => obj::read(bytes),
        MeshFormat::Stl => stl::read(bytes),
        MeshFormat::Ply => ply::read(bytes),
        MeshFormat::Gltf => glb::read(bytes, beside),
    }?;
    mesh.validate()
        .map_err(|e| e.remedy("check that the file was copied whole, or export the mesh again"))?;
    Ok(weld(&mesh, 0.0))
}

/// Refuses an empty file and the text that Git LFS leaves in the place of a file.
fn refuse_placeholders(bytes: &[u8]) -> Result<()> {
    if bytes.is_empty() {
        return Err(Error::input("the file is empty").remedy("export or download the mesh again"));
    }
    if bytes.starts_with(b"version https://git-lfs") {
        return Err(
            Error::input("the file is a Git LFS pointer, not the mesh itself")
                .remedy("fetch the mesh with `git lfs pull`"),
        );
    }
    Ok(())
}

/// Writes a mesh in metres as `.obj` or binary `.ply`, by the suffix. Coordinates read back bit
/// for bit.
///
/// # Errors
/// `Input` for another suffix; the error of the operating system if the file cannot be written.
pub fn save_mesh(path: &Path, mesh: &TriangleMesh) -> Result<()> {
    let bytes = match MeshFormat::of_path(path)? {
        MeshFormat::Obj => obj::write(mesh),
        MeshFormat::Ply => ply::write(mesh),
        other => {
            return Err(
                Error::input(format!("meshes cannot be written as {other:?}"))
                    .at(path.display())
                    .remedy("name the file .ply or .obj"),
            );
        }
    };
    save(path, &bytes)
}

/// A mesh as binary PLY. Coordinates read back bit for bit.
#[must_use]
pub fn ply_bytes(mesh: &TriangleMesh) -> Vec<u8> {
    ply::write(mesh)
}

/// An error of the content, with the usual remedy.
fn malformed(what: impl Into<String>) -> Error {
    Error::input(what).remedy("check that the file was copied whole, or export the mesh again")
}

/// Appends a polygon as a fan around its first corner; fewer than three corners are no face.
fn push_polygon<T: Copy>(triangles: &mut Vec<[T; 3]>, corners: &[T]) -> Result<()> {
    let [first, rest @ ..] = corners else {
        return Err(malformed("a face must have at least 3 corners, found 0"));
    };
    if rest.len() < 2 {
        let found = corners.len();
        return Err(malformed(format!(
            "a face must have at least 3 corners, found {found}"
        )));
    }
    triangles.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
    Ok(())
}

/// Single-precision coordinates as a vector.
fn from_f32([x, y, z]: [f32; 3]) -> DVec3 {
    DVec3::new(f64::from(x), f64::from(y), f64::from(z))
}

#[cfg(test)]
#[path = "mesh_file_test.rs"]
mod tests;
