//! Named procedural meshes: watertight, counter-clockwise seen from outside, centred in the
//! origin.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::mesh::TriangleMesh;
use crate::error::{Error, ErrorKind, Result, nearest_name};

/// Names that [`builtin`] knows.
pub const BUILTIN_NAMES: &[&str] = &["box", "sphere"];

/// A procedural mesh by name, with or without the prefix `builtin:`.
///
/// | name | shape | triangles |
/// | --- | --- | --- |
/// | `box` | 40 × 40 × 60 mm | 4096 |
/// | `sphere` | radius 25 mm, 36 meridians, 19 rings | 1296 |
///
/// # Errors
/// `NotFound` for another name; the remedy lists the names.
pub fn builtin(name: &str) -> Result<TriangleMesh> {
    match name.strip_prefix("builtin:").unwrap_or(name) {
        "box" => Ok(grid_box(DVec3::new(0.04, 0.04, 0.06), [16, 16, 24])),
        "sphere" => Ok(uv_sphere(0.025, 36, 19)),
        other => Err(unknown(other)),
    }
}

fn unknown(name: &str) -> Error {
    let nearest = nearest_name(name, BUILTIN_NAMES.iter().copied());
    let hint = nearest.map_or(String::new(), |n| format!("did you mean builtin:{n}? "));
    Error::new(
        ErrorKind::NotFound,
        format!("there is no built-in mesh named {name:?}"),
    )
    .remedy(format!("{hint}known are: {}", BUILTIN_NAMES.join(", ")))
}

/// Box of the given size (m), its faces cut into cells and each cell into two triangles.
pub(super) fn grid_box(size: DVec3, cells: [u32; 3]) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let mut known: BTreeMap<[u32; 3], u32> = BTreeMap::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for end in [0, cells[axis]] {
            for i in 0..cells[u] {
                for j in 0..cells[v] {
                    let mut corner = |di: u32, dj: u32| {
                        let mut at = [0; 3];
                        (at[axis], at[u], at[v]) = (end, i + di, j + dj);
                        *known.entry(at).or_insert_with(|| {
                            let t = DVec3::from_array(
                                [0, 1, 2].map(|k| f64::from(at[k]) / f64::from(cells[k]) - 0.5),
                            );
                            mesh.vertices.push(t * size);
                            mesh.vertices.len() as u32 - 1
                        })
                    };
                    let mut quad = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                    if end == 0 {
                        quad.reverse();
                    }
                    push_quad(&mut mesh.triangles, quad);
                }
            }
        }
    }
    mesh
}

/// Sphere of radius `radius` (m) with `segments` meridians and `stacks` rings of faces; the poles
/// are single vertices on the z axis.
pub(super) fn uv_sphere(radius: f64, segments: u32, stacks: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    mesh.vertices.push(DVec3::NEG_Z * radius);
    for stack in 1..stacks {
        let (r, z) = (PI * f64::from(stack) / f64::from(stacks)).sin_cos();
        for segment in 0..segments {
            let (y, x) = (TAU * f64::from(segment) / f64::from(segments)).sin_cos();
            mesh.vertices.push(DVec3::new(r * x, r * y, -z) * radius);
        }
    }
    let top = mesh.vertices.len() as u32;
    mesh.vertices.push(DVec3::Z * radius);
    let at = |ring: u32, segment: u32| 1 + ring * segments + segment % segments;
    for s in 0..segments {
        mesh.triangles.push([0, at(0, s + 1), at(0, s)]);
        for ring in 0..stacks - 2 {
            let (next, above) = (at(ring, s + 1), at(ring + 1, s + 1));
            push_quad(
                &mut mesh.triangles,
                [at(ring, s), next, above, at(ring + 1, s)],
            );
        }
        mesh.triangles
            .push([at(stacks - 2, s), at(stacks - 2, s + 1), top]);
    }
    mesh
}

/// Two triangles of a quadrilateral whose corners run counter-clockwise, cut from its first to
/// its third corner.
fn push_quad(triangles: &mut Vec<[u32; 3]>, [a, b, c, d]: [u32; 4]) {
    triangles.push([a, b, c]);
    triangles.push([a, c, d]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::MassProperties;

    #[test]
    fn every_shape_is_watertight_and_faces_outwards() {
        for name in BUILTIN_NAMES {
            let mesh = builtin(name).unwrap();
            mesh.validate().unwrap();
            assert!(mesh.edges().is_closed(), "{name}");
            assert!(MassProperties::of(&mesh).unwrap().volume_m3 > 0.0, "{name}");
            let euler = mesh.vertices.len() as i64 - mesh.edges().len() as i64
                + mesh.triangles.len() as i64;
            assert_eq!(euler, 2, "{name}");
        }
    }

    #[test]
    fn sizes_are_the_documented_ones() {
        let size = |name| builtin(name).unwrap().bounds().extent();
        assert!(size("box").distance(DVec3::new(0.04, 0.04, 0.06)) < 1e-15);
        assert!((size("sphere").z - 0.05).abs() < 1e-15);
        assert_eq!(builtin("box").unwrap().triangles.len(), 4096);
        assert_eq!(builtin("builtin:sphere").unwrap().triangles.len(), 1296);
    }

    #[test]
    fn a_misspelt_name_is_answered_with_the_nearest() {
        let text = builtin("builtin:spere").unwrap_err().to_string();
        assert!(
            text.contains("builtin:sphere") && text.contains("box"),
            "{text}"
        );
    }
}
