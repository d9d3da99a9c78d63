//! STL, binary and text.
//!
//! Parsed here, because programs write many dialects of the text form: any case and spacing, any
//! number of solids, missing names and end statements, NaN as normals, decimal commas.

use super::{from_f32, malformed, polygon, text};
use crate::mesh::TriangleMesh;
use crate::weld::weld;
use glam::DVec3;
use gripcast_base::error::Result;

/// Bytes of the header of a binary file, and of one triangle.
const HEADER: usize = 84;
const TRIANGLE: usize = 50;
/// Bytes at the start of a file in which the text form must have its first facet.
const SEARCHED_FOR_FACET: usize = 64 << 10;

/// Parses either form. The order of corners defines the orientation; normals are ignored, all
/// solids are joined.
pub(super) fn read(bytes: &[u8]) -> Result<TriangleMesh> {
    let mesh = if is_text(bytes) {
        read_text(&text::decode(bytes))?
    } else {
        read_binary(bytes)?
    };
    Ok(weld(&mesh, 0.0))
}

/// Whether a file is the text form: it has a facet near its start and no NUL before it, and its
/// size does not match the count of a binary file.
fn is_text(bytes: &[u8]) -> bool {
    if binary_count(bytes).is_some_and(|count| bytes.len() == HEADER + TRIANGLE * count) {
        return false;
    }
    let start = &bytes[..bytes.len().min(SEARCHED_FOR_FACET)];
    let decoded = text::decode(start);
    let lower = decoded.to_ascii_lowercase();
    let is_empty_solid = lower.trim_start().starts_with("solid") && lower.contains("endsolid");
    let before_facet = lower.find("facet").map(|position| &lower[..position]);
    before_facet.is_some_and(|before| !before.contains('\0')) || is_empty_solid
}

/// Number of triangles that a binary file declares.
fn binary_count(bytes: &[u8]) -> Option<usize> {
    let count: [u8; 4] = bytes.get(HEADER - 4..HEADER)?.try_into().ok()?;
    usize::try_from(u32::from_le_bytes(count)).ok()
}

fn read_binary(bytes: &[u8]) -> Result<TriangleMesh> {
    let Some(declared) = binary_count(bytes) else {
        return Err(malformed(format!(
            "neither a text STL (no facet found) nor a binary STL, which has at least {HEADER} \
             bytes; found {}",
            bytes.len()
        )));
    };
    let held = (bytes.len() - HEADER) / TRIANGLE;
    // Programs that stream their output leave the count at 0.
    let count = if declared == 0 { held } else { declared };
    if held < count {
        return Err(malformed(format!(
            "a binary STL of {count} triangles must have {} bytes, found {}",
            (TRIANGLE as u64) * (count as u64) + HEADER as u64,
            bytes.len()
        )));
    }
    let corners =
        bytes[HEADER..]
            .chunks_exact(TRIANGLE)
            .take(count)
            .flat_map(|triangle| triangle[12..48].chunks_exact(12))
            .map(|corner| {
                from_f32([0, 4, 8].map(|offset| {
                    f32::from_le_bytes([0, 1, 2, 3].map(|byte| corner[offset + byte]))
                }))
            });
    Ok(TriangleMesh {
        vertices: corners.collect(),
        triangles: (0..count as u32)
            .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
            .collect(),
    })
}

/// Reads all facets; other statements (solids, normals, loops) are only separators.
fn read_text(text: &str) -> Result<TriangleMesh> {
    let mut mesh = TriangleMesh::default();
    // Vertices of the facet before this index are complete.
    let mut facet = 0;
    for (index, line) in text::lines(text).enumerate() {
        let lower = line.trim_start().to_ascii_lowercase();
        let at = |e: gripcast_base::error::Error| e.at(format!("line {}", index + 1));
        let mut words = lower.split_whitespace();
        if lower.starts_with("solid") || lower.starts_with("endsolid") {
            // The rest of the line is a name, which may contain any word, unless facets follow.
            let has = |name| words.clone().any(|word| word == name);
            if !(has("loop") && has("vertex")) {
                continue;
            }
            words.find(|word| *word == "facet");
        }
        while let Some(word) = words.next() {
            match word {
                "vertex" => mesh.vertices.push(vertex(&mut words).map_err(at)?),
                "facet" | "loop" | "endloop" | "endfacet" => {
                    close_facet(&mut mesh, facet).map_err(at)?;
                    facet = mesh.vertices.len();
                }
                _ => {}
            }
        }
    }
    if facet != mesh.vertices.len() {
        return Err(malformed("the file ends within a facet"));
    }
    Ok(mesh)
}

/// Adds the triangles of the facet whose vertices begin at `first`.
fn close_facet(mesh: &mut TriangleMesh, first: usize) -> Result<()> {
    let corners: Vec<u32> = (first as u32..mesh.vertices.len() as u32).collect();
    match corners.len() {
        0 => Ok(()),
        1 | 2 => Err(malformed(format!(
            "a facet must have 3 vertices, found {}",
            corners.len()
        ))),
        _ => {
            let triangles = polygon::triangulate(&mesh.vertices, &corners);
            mesh.triangles.extend(triangles);
            Ok(())
        }
    }
}

fn vertex<'a>(words: &mut impl Iterator<Item = &'a str>) -> Result<DVec3> {
    let mut coordinate = || {
        let word = words.next().unwrap_or_default();
        text::number::<f32>(word)
            .ok_or_else(|| malformed(format!("a vertex must have 3 numbers, found {word:?}")))
    };
    Ok(from_f32([coordinate()?, coordinate()?, coordinate()?]))
}
