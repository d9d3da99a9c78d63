//! STL, binary and text.

use std::io::Cursor;

use super::{from_f32, malformed};
use crate::mesh::TriangleMesh;
use gripcast_base::error::Result;

/// Bytes of the header of a binary file, and of one triangle.
const HEADER: usize = 84;
const TRIANGLE: usize = 50;

/// Parses either form; the order of corners defines the orientation, normals are ignored.
pub(super) fn read(bytes: &[u8]) -> Result<TriangleMesh> {
    let mut bytes = bytes.to_vec();
    if let Some(count) = binary_count(&bytes) {
        // The parser would take a binary header that starts with "solid" for text.
        bytes[0] = 0;
        let expected = HEADER + TRIANGLE * count;
        if bytes.len() < expected {
            return Err(malformed(format!(
                "a binary STL of {count} triangles must have {expected} bytes, found {}",
                bytes.len()
            )));
        }
    }
    let parsed = stl_io::read_stl(&mut Cursor::new(bytes))
        .map_err(|e| malformed("invalid STL file").because(e))?;
    Ok(TriangleMesh {
        vertices: parsed.vertices.iter().map(|v| from_f32(v.0)).collect(),
        triangles: parsed
            .faces
            .iter()
            .map(|face| face.vertices.map(|v| v as u32))
            .collect(),
    })
}

/// Number of triangles of a binary file; `None` for text. A file that starts with `solid` is binary
/// if its size matches its count.
fn binary_count(bytes: &[u8]) -> Option<usize> {
    let count: [u8; 4] = bytes.get(HEADER - 4..HEADER)?.try_into().ok()?;
    let count = u32::from_le_bytes(count) as usize;
    let exact = bytes.len() == HEADER + TRIANGLE * count;
    (exact || !bytes.starts_with(b"solid")).then_some(count)
}
