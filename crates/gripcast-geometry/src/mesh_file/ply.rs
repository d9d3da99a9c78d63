//! PLY, binary and text.

use std::io::Cursor;

use glam::DVec3;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{DefaultElement, ElementDef, Header, Property, PropertyAccess};
use ply_rs_bw::ply::{PropertyAccessResult, PropertyAccessResult::Ignored};

use super::{malformed, polygon};
use crate::mesh::TriangleMesh;
use gripcast_base::error::{Error, Result};

/// Parses the elements `vertex` and `face`; others are skipped.
pub(super) fn read(bytes: &[u8]) -> Result<TriangleMesh> {
    let mut reader = Reader::new(Cursor::new(bytes));
    let header = Parser::<DefaultElement>::new()
        .read_header(&mut reader)
        .map_err(invalid)?;
    let mut mesh = TriangleMesh::default();
    let mut faces: Vec<Vec<u32>> = Vec::new();
    for (name, element) in &header.elements {
        check_element(element, bytes.len())?;
        match name.as_str() {
            "vertex" => {
                let read: Vec<Vertex> = elements(&mut reader, element, &header)?;
                mesh.vertices = read.into_iter().map(|v| v.0).collect();
            }
            "face" => {
                let read: Vec<Face> = elements(&mut reader, element, &header)?;
                for (index, face) in read.into_iter().enumerate() {
                    faces.push(face.corners().ok_or_else(|| {
                        malformed(format!("face {index} must list vertices by index from 0"))
                    })?);
                }
            }
            "tristrips" => {
                let read: Vec<Face> = elements(&mut reader, element, &header)?;
                let strips = read.iter().filter_map(|strip| strip.0.as_deref());
                faces.extend(strips.flat_map(strip_triangles));
            }
            _ => {
                elements::<Skipped>(&mut reader, element, &header)?;
            }
        }
    }
    // Faces may precede vertices.
    for corners in faces {
        let triangles = polygon::triangulate(&mesh.vertices, &corners);
        mesh.triangles.extend(triangles);
    }
    Ok(mesh)
}

/// Triangles of a list of strips, which −1 separates (Stanford scans).
fn strip_triangles(indices: &[i64]) -> Vec<Vec<u32>> {
    let index = |v: i64| u32::try_from(v).unwrap_or(u32::MAX);
    indices
        .split(|&index| index < 0)
        .flat_map(|strip| {
            strip.windows(3).enumerate().map(move |(i, c)| match i % 2 {
                0 => vec![index(c[0]), index(c[1]), index(c[2])],
                _ => vec![index(c[1]), index(c[0]), index(c[2])],
            })
        })
        .collect()
}

fn elements<E: PropertyAccess>(
    reader: &mut Reader<Cursor<&[u8]>>,
    element: &ElementDef,
    header: &Header,
) -> Result<Vec<E>> {
    Parser::<E>::new()
        .read_payload_for_element(reader, element, header)
        .map_err(invalid)
}

fn invalid(error: ParseError) -> Error {
    malformed("invalid PLY file").because(error)
}

/// Rejects counts that the file cannot hold, before memory is allocated, and vertices without
/// coordinates.
fn check_element(element: &ElementDef, file_size: usize) -> Result<()> {
    let ElementDef { name, count, .. } = element;
    let properties = &element.properties;
    if *count > file_size || (*count > 0 && properties.iter().next().is_none()) {
        return Err(malformed(format!(
            "the header declares {count} of element {name:?}, more than the file holds"
        )));
    }
    let has = |key: &str| properties.iter().any(|(k, _)| k == key);
    if name == "vertex" && !["x", "y", "z"].into_iter().all(has) {
        return Err(malformed("vertices must have the properties x, y and z"));
    }
    Ok(())
}

struct Vertex(DVec3);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self(DVec3::ZERO)
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        let axis = match name {
            "x" => 0,
            "y" => 1,
            "z" => 2,
            _ => return Ignored,
        };
        self.0[axis] = match value {
            Property::Float(v) => f64::from(v),
            Property::Double(v) => v,
            Property::Char(v) => f64::from(v),
            Property::UChar(v) => f64::from(v),
            Property::Short(v) => f64::from(v),
            Property::UShort(v) => f64::from(v),
            Property::Int(v) => f64::from(v),
            Property::UInt(v) => f64::from(v),
            _ => return PropertyAccessResult::UnsupportedType,
        };
        PropertyAccessResult::Set
    }
}

/// Corner indices of a face or strips, if it has any.
struct Face(Option<Vec<i64>>);

impl Face {
    /// Corners of a face; `None` for a negative index.
    fn corners(self) -> Option<Vec<u32>> {
        let indices = self.0?.into_iter();
        indices.map(|index| u32::try_from(index).ok()).collect()
    }
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self(None)
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        if name == "vertex_indices" || name == "vertex_index" {
            self.0 = indices(value);
        }
        PropertyAccessResult::Set
    }
}

/// Integers of a list property.
fn indices(value: Property) -> Option<Vec<i64>> {
    fn wide<T: Into<i64>>(list: Vec<T>) -> Option<Vec<i64>> {
        Some(list.into_iter().map(Into::into).collect())
    }
    match value {
        Property::ListChar(list) => wide(list),
        Property::ListUChar(list) => wide(list),
        Property::ListShort(list) => wide(list),
        Property::ListUShort(list) => wide(list),
        Property::ListInt(list) => wide(list),
        Property::ListUInt(list) => wide(list),
        _ => None,
    }
}

struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}

/// Writes a binary little-endian file with double coordinates.
pub(super) fn write(mesh: &TriangleMesh) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\ncomment unit: metre\n\
         element vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.vertices.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    for value in mesh.vertices.iter().flat_map(|v| v.to_array()) {
        bytes.extend(value.to_le_bytes());
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        bytes.extend(triangle.iter().flat_map(|v| v.to_le_bytes()));
    }
    bytes
}
