//! Wavefront OBJ: positions and faces.
//!
//! Read line by line here, not by a crate, so that errors name the line and vertices keep their
//! order.

use std::fmt::Write as _;

use glam::DVec3;

use super::{malformed, push_polygon};
use crate::error::{Error, Result};
use crate::geometry::mesh::TriangleMesh;

/// Parses `v` and `f` statements; the others do not change the shape.
pub(super) fn read(bytes: &[u8]) -> Result<TriangleMesh> {
    // Names and comments may be in any encoding.
    let text = String::from_utf8_lossy(bytes);
    let mut mesh = TriangleMesh::default();
    let mut lines = text.lines().enumerate();
    while let Some((index, line)) = lines.next() {
        let mut statement = line.to_string();
        while let Some(continued) = statement.trim_end().strip_suffix('\\') {
            let next = lines.next().map_or("", |(_, next)| next);
            statement = format!("{continued} {next}");
        }
        read_statement(&mut mesh, &statement).map_err(|e| e.at(format!("line {}", index + 1)))?;
    }
    Ok(mesh)
}

fn read_statement(mesh: &mut TriangleMesh, statement: &str) -> Result<()> {
    let content = statement.split('#').next().unwrap_or_default();
    let mut words = content.split_whitespace();
    match words.next() {
        Some("v") => mesh.vertices.push(position(words)?),
        Some("f") => {
            let count = mesh.vertices.len();
            let corners = words
                .map(|word| corner(word, count))
                .collect::<Result<Vec<_>>>()?;
            push_polygon(&mut mesh.triangles, &corners)?;
        }
        _ => {}
    }
    Ok(())
}

/// The first three numbers; a weight or a colour may follow.
fn position<'a>(mut words: impl Iterator<Item = &'a str>) -> Result<DVec3> {
    let mut number = || -> Result<f64> {
        let word = words.next().ok_or_else(|| {
            malformed("a vertex must have 3 coordinates, the line ends before the third")
        })?;
        word.parse().map_err(|_| bad_number(word))
    };
    let place = DVec3::new(number()?, number()?, number()?);
    if !place.is_finite() {
        let found = place.to_array();
        return Err(malformed(format!(
            "a vertex must have finite coordinates, found {found:?}"
        )));
    }
    Ok(place)
}

/// Index of `7`, `7/1`, `7//3` or `7/1/3`, from 1; −1 is the vertex defined last.
fn corner(word: &str, count: usize) -> Result<u32> {
    let index = word.split('/').next().unwrap_or_default();
    let number: i64 = index.parse().map_err(|_| bad_number(word))?;
    let from_zero = if number < 0 {
        number + count as i64
    } else {
        number - 1
    };
    u32::try_from(from_zero)
        .ok()
        .filter(|&v| (v as usize) < count)
        .ok_or_else(|| {
            malformed(format!(
                "the face names vertex {number}, but {count} are defined before it"
            ))
        })
}

fn bad_number(word: &str) -> Error {
    malformed(format!("{word:?} is not a number"))
}

/// Text of the mesh with as many digits as reading back bit for bit takes.
pub(super) fn write(mesh: &TriangleMesh) -> Vec<u8> {
    let mut text = String::from("# unit: metre\n");
    for v in &mesh.vertices {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "v {} {} {}", v.x, v.y, v.z);
    }
    for [a, b, c] in &mesh.triangles {
        let _ = writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1);
    }
    text.into_bytes()
}
