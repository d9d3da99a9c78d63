//! Wavefront OBJ: positions and faces with texture coordinates, normals and materials.
//!
//! Parsed here instead of by a crate, so that errors state the line and vertices keep their order.

use std::fmt::Write as _;

use glam::DVec3;

use super::{malformed, polygon, text};
use crate::mesh::TriangleMesh;
use gripcast_base::error::{Error, Result};

/// A corner of a face: indices of its position and, if valid, of its texture coordinate and normal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Corner {
    pub(super) position: u32,
    pub(super) uv: Option<u32>,
    pub(super) normal: Option<u32>,
}

/// Shape and appearance of an OBJ file.
#[derive(Default)]
pub(super) struct ObjFile {
    pub(super) positions: Vec<DVec3>,
    /// u to the right, v upwards; not finite for an invalid line.
    pub(super) uvs: Vec<[f64; 2]>,
    /// Not finite for an invalid line.
    pub(super) normals: Vec<DVec3>,
    pub(super) triangles: Vec<[Corner; 3]>,
    /// Index into `material_names` of each triangle.
    pub(super) materials: Vec<Option<u32>>,
    /// Names of `usemtl`, in the order of their first use.
    pub(super) material_names: Vec<String>,
    /// File names of `mtllib`.
    pub(super) libraries: Vec<String>,
    /// Number of corners with an invalid texture coordinate or normal.
    pub(super) dangling: usize,
    material: Option<u32>,
}

/// Reads the shape: `v` and `f` statements.
pub(super) fn read(bytes: &[u8]) -> Result<TriangleMesh> {
    let file = parse(bytes)?;
    Ok(TriangleMesh {
        triangles: file
            .triangles
            .iter()
            .map(|corners| corners.map(|c| c.position))
            .collect(),
        vertices: file.positions,
    })
}

/// Reads all statements; invalid appearance is not an error.
pub(super) fn parse(bytes: &[u8]) -> Result<ObjFile> {
    let text = text::decode(bytes);
    let mut file = ObjFile::default();
    let mut lines = text::lines(&text).enumerate();
    while let Some((index, line)) = lines.next() {
        let mut statement = line.to_string();
        while let Some(continued) = statement.trim_end().strip_suffix('\\') {
            let next = lines.next().map_or("", |(_, next)| next);
            statement = format!("{continued} {next}");
        }
        file.read_statement(&statement)
            .map_err(|e| e.at(format!("line {}", index + 1)))?;
    }
    Ok(file)
}

impl ObjFile {
    fn read_statement(&mut self, statement: &str) -> Result<()> {
        let statement = statement.trim();
        let (keyword, rest) = statement
            .split_once(char::is_whitespace)
            .unwrap_or((statement, ""));
        let data = rest.split('#').next().unwrap_or_default();
        match keyword {
            "v" => self.positions.push(position(data.split_whitespace())?),
            "vt" => {
                let [u, v, _] = numbers(data);
                self.uvs.push([u, if v.is_nan() { 0.0 } else { v }]);
            }
            "vn" => self.normals.push(DVec3::from_array(numbers(data))),
            // `fo` is the face statement of the first version of the format.
            "f" | "fo" => self.face(data)?,
            "usemtl" => self.use_material(text::without_comment(rest)),
            "mtllib" => self.libraries.push(text::without_comment(rest).to_string()),
            _ => {}
        }
        Ok(())
    }

    /// Adds a face; one of fewer than three corners has no area.
    fn face(&mut self, words: &str) -> Result<()> {
        let corners = words
            .split_whitespace()
            .map(|word| self.corner(word))
            .collect::<Result<Vec<_>>>()?;
        let positions: Vec<DVec3> = corners
            .iter()
            .map(|corner| self.positions[corner.position as usize])
            .collect();
        let all: Vec<u32> = (0..corners.len() as u32).collect();
        let triangles = polygon::triangulate(&positions, &all);
        self.triangles.extend(
            triangles
                .into_iter()
                .map(|triangle| triangle.map(|i| corners[i as usize])),
        );
        self.materials.resize(self.triangles.len(), self.material);
        Ok(())
    }

    /// Parses `7`, `7/1`, `7//3` or `7/1/3`, each from 1; −1 is the last one defined.
    fn corner(&mut self, word: &str) -> Result<Corner> {
        let mut parts = word.split('/');
        let first = parts.next().unwrap_or_default();
        let number = index(first).ok_or_else(|| bad_number(word))?;
        let count = self.positions.len();
        let position = resolve_index(number, count).ok_or_else(|| match number {
            0 => Error::input("the face refers to vertex 0, but OBJ counts vertices from 1")
                .remedy("export the mesh again with a program that writes valid OBJ"),
            _ => malformed(format!(
                "the face refers to vertex {number}, but {count} are defined before it"
            )),
        })?;
        let mut optional = |count: usize, is_usable: &dyn Fn(u32) -> bool| {
            let part = parts.next().filter(|part| !part.is_empty())?;
            let index = index(part).and_then(|n| resolve_index(n, count));
            let usable = index.filter(|&index| is_usable(index));
            self.dangling += usize::from(usable.is_none());
            usable
        };
        let uv = optional(self.uvs.len(), &|i| {
            self.uvs[i as usize].iter().all(|c| c.is_finite())
        });
        let normal = optional(self.normals.len(), &|i| {
            self.normals[i as usize].try_normalize().is_some()
        });
        Ok(Corner {
            position,
            uv,
            normal,
        })
    }

    fn use_material(&mut self, name: &str) {
        let index = self.material_names.iter().position(|n| n == name);
        let index = index.unwrap_or_else(|| {
            self.material_names.push(name.to_string());
            self.material_names.len() - 1
        });
        self.material = Some(index as u32);
    }
}

/// Parses an index; some programs write `1.0`.
fn index(word: &str) -> Option<i64> {
    word.parse().ok().or_else(|| {
        let number: f64 = word.parse().ok()?;
        (number.fract() == 0.0 && number.abs() < 2e9).then_some(number as i64)
    })
}

/// Zero-based index of an index from 1 or from the end, if below `count`.
fn resolve_index(number: i64, count: usize) -> Option<u32> {
    let shift = if number < 0 { count as i64 } else { -1 };
    let index = u32::try_from(number + shift).ok()?;
    ((index as usize) < count).then_some(index)
}

/// Parses the first three numbers; NaN for missing or invalid ones.
fn numbers(words: &str) -> [f64; 3] {
    let mut words = words.split_whitespace();
    std::array::from_fn(|_| words.next().and_then(text::number).unwrap_or(f64::NAN))
}

/// Parses a position; a weight or a colour may follow.
fn position<'a>(mut words: impl Iterator<Item = &'a str>) -> Result<DVec3> {
    let mut number = || -> Result<f64> {
        let word = words
            .next()
            .ok_or_else(|| malformed("a vertex must have 3 coordinates"))?;
        text::number(word).ok_or_else(|| bad_number(word))
    };
    let position = DVec3::new(number()?, number()?, number()?);
    if !position.is_finite() {
        let found = position.to_array();
        return Err(Error::input(format!(
            "a vertex must have finite coordinates, found {found:?}"
        ))
        .remedy("export the mesh again: the program that wrote it failed at this vertex"));
    }
    Ok(position)
}

fn bad_number(word: &str) -> Error {
    malformed(format!("invalid number {word:?}"))
}

/// Writes the mesh with enough digits to round-trip bit for bit.
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
