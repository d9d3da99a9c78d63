//! Mesh files: reads OBJ, STL, PLY and glTF, writes OBJ and PLY.
//!
//! Polygons are triangulated, and coincident vertices are welded. [`TexturedMesh`] also has
//! normals, materials and texture coordinates.

mod glb;
mod glb_material;
mod material;
mod mtl;
mod obj;
mod ply;
mod polygon;
mod stl;
mod text;
mod textured;

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use glam::DVec3;

pub use material::{ImageSource, MeshMaterial};
pub use textured::{MeshPart, TexturedMesh, load_textured_mesh, read_textured_mesh};

use super::mesh::TriangleMesh;
use super::weld::weld;
use gripcast_base::error::{Error, Result, nearest_name};
use gripcast_base::files::{FileKind, companions, file_type, read_regular, save};

/// Reads a file that the mesh file refers to by a relative path.
type Companions<'a> = &'a dyn Fn(&str) -> std::io::Result<Vec<u8>>;

/// Remedy for invalid content.
pub(super) const REEXPORT: &str =
    "check that the file was copied completely, or export the mesh again";

const SUFFIXES: [&str; 5] = ["obj", "stl", "ply", "glb", "gltf"];

/// Unit of the coordinates in a mesh file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LengthUnit {
    /// `mm`
    Millimetre,
    /// `cm`
    Centimetre,
    /// `m`, the unit of glTF and of files written by gripcast.
    #[default]
    Metre,
    /// `in`, 25.4 mm
    Inch,
}

impl LengthUnit {
    /// All units.
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
        let unit = Self::ALL.into_iter().find(|unit| unit.to_string() == text);
        unit.ok_or_else(|| {
            Error::usage(format!("unknown length unit {text:?}")).remedy("use mm, cm, m or in")
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
    /// Format by the suffix of a path, case-insensitive.
    ///
    /// # Errors
    /// `Input` for an unknown suffix.
    pub fn from_path(path: &Path) -> Result<Self> {
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
    Error::input(format!("unknown mesh file suffix {suffix:?}")).remedy(format!(
        "{hint}convert the mesh to one of: .{}",
        SUFFIXES.join(" .")
    ))
}

/// Reads a mesh file with coordinates in `unit`; the result is in metres.
///
/// # Errors
/// `NotFound`, `Permission`, `Io` if the file cannot be read; `Input` for an unknown suffix or
/// invalid content: empty, truncated, indices out of range, non-finite coordinates.
pub fn load_mesh(path: &Path, unit: LengthUnit) -> Result<TriangleMesh> {
    let format = MeshFormat::from_path(path)?;
    let bytes = file_bytes(path)?;
    read_mesh(&bytes, format, &companions(path))
        .map(|mesh| mesh.scaled(unit.in_metres()))
        .map_err(|e| e.at(path.display()))
}

/// Reads the bytes of a mesh file.
fn file_bytes(path: &Path) -> Result<Vec<u8>> {
    read_regular(path, FileKind::Mesh).map_err(|e| {
        Error::io("cannot read the mesh", e)
            .at(path.display())
            .remedy("check the path and its permissions")
    })
}

/// Parses a mesh; coordinates keep the unit of the file. `companions` reads a file that the mesh
/// refers to by a relative path.
///
/// # Errors
/// `Input` for invalid content.
pub fn read_mesh(
    bytes: &[u8],
    format: MeshFormat,
    companions: Companions<'_>,
) -> Result<TriangleMesh> {
    let read = read_as(bytes, format, companions);
    read.map_err(|error| explained(error, bytes, format))
}

fn read_as(bytes: &[u8], format: MeshFormat, companions: Companions<'_>) -> Result<TriangleMesh> {
    let mesh = match format {
        MeshFormat::Obj => obj::read(bytes),
        MeshFormat::Stl => stl::read(bytes),
        MeshFormat::Ply => ply::read(bytes),
        MeshFormat::Gltf => glb::read(bytes, companions),
    }?;
    require_triangles(&mesh)?;
    mesh.validate().map_err(|e| e.remedy(REEXPORT))?;
    Ok(weld(&mesh, 0.0))
}

/// The error of an unreadable file; of another one if the file is clearly no mesh.
fn explained(error: Error, bytes: &[u8], format: MeshFormat) -> Error {
    let could_be = |found: &&str| match *found {
        "a text file" => true,
        "a JSON file" | "a glTF binary" => format == MeshFormat::Gltf,
        _ => false,
    };
    match file_type(bytes).filter(|found| !could_be(found)) {
        Some(found) => Error::input(format!("expected a mesh, found {found}"))
            .remedy("give the mesh file itself: export or download it again"),
        None => error,
    }
}

/// Rejects a file without faces.
fn require_triangles(mesh: &TriangleMesh) -> Result<()> {
    match (mesh.triangles.len(), mesh.vertices.len()) {
        (0, 0) => Err(malformed("the file has no vertices and no faces")),
        (0, points) => Err(Error::input(format!(
            "the file has {points} points but no faces: a point cloud, not a mesh"
        ))
        .remedy("reconstruct its surface (Poisson, ball pivoting), or export the faces too")),
        _ => Ok(()),
    }
}

/// Writes a mesh in metres as `.obj` or binary `.ply`, by the suffix; coordinates round-trip bit
/// for bit.
///
/// # Errors
/// `Input` for another suffix; `Io` if the file cannot be written.
pub fn save_mesh(path: &Path, mesh: &TriangleMesh) -> Result<()> {
    let bytes = match MeshFormat::from_path(path)? {
        MeshFormat::Obj => obj::write(mesh),
        MeshFormat::Ply => ply::write(mesh),
        other => {
            return Err(Error::input(format!("cannot write a mesh as {other:?}"))
                .at(path.display())
                .remedy("name the file .ply or .obj"));
        }
    };
    save(path, &bytes)
}

/// Encodes a mesh as binary PLY; coordinates round-trip bit for bit.
pub fn ply_bytes(mesh: &TriangleMesh) -> Vec<u8> {
    ply::write(mesh)
}

/// Error for invalid content.
fn malformed(what: impl Into<String>) -> Error {
    Error::input(what).remedy(REEXPORT)
}

/// Converts single-precision coordinates.
fn from_f32([x, y, z]: [f32; 3]) -> DVec3 {
    DVec3::new(f64::from(x), f64::from(y), f64::from(z))
}

#[cfg(test)]
#[path = "mesh_file_test.rs"]
mod tests;
