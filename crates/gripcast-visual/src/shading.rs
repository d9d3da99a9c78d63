//! Shading normals and texture coordinates of meshes without them.

use std::collections::HashMap;

use glam::DVec3;

use super::scene::Mesh;
use gripcast_geometry::{TriangleMesh, corner_normals};

/// Texture projection of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// None.
    None,
    /// Box projection: along the axis nearest to each triangle's normal. The image repeats on all
    /// six sides, with seams between them.
    Box {
        /// Width of the image, m.
        width_m: f64,
        /// Position of a corner of the image, m.
        origin_m: DVec3,
    },
}

/// Mesh of one material with shading normals: smooth where triangles meet at less than
/// `crease_rad`, sharp elsewhere. Vertices at creases and seams are duplicated.
pub fn shaded_mesh(
    mesh: &TriangleMesh,
    crease_rad: f64,
    projection: Projection,
    material: usize,
) -> Mesh {
    let faces: Vec<DVec3> = mesh.all_corners().map(scaled_normal).collect();
    let corners = corner_normals(mesh, crease_rad);
    let mut vertex_ids: HashMap<(u32, [i32; 3], u8), u32> = HashMap::new();
    let mut shaded = Mesh {
        material,
        ..Mesh::default()
    };
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let side = match projection {
            Projection::None => 0,
            Projection::Box { .. } => side_of(faces[t]),
        };
        let mut renamed = [0; 3];
        for k in 0..3 {
            let (vertex, normal) = (triangle[k], corners[t][k].as_vec3());
            // Normals that agree to 1e-4 are merged.
            let rounded = normal.to_array().map(|c| (c * 1e4).round() as i32);
            renamed[k] = *vertex_ids
                .entry((vertex, rounded, side))
                .or_insert_with(|| {
                    let position = mesh.vertices[vertex as usize];
                    shaded.positions.push(position.as_vec3());
                    shaded.normals.push(normal);
                    if let Projection::Box { width_m, origin_m } = projection {
                        shaded
                            .uvs
                            .push(box_uv((position - origin_m) / width_m, side));
                    }
                    shaded.positions.len() as u32 - 1
                });
        }
        shaded.triangles.push(renamed);
    }
    shaded
}

/// Normal of a triangle scaled by twice its area.
fn scaled_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// Side of a box that a normal points to: twice the axis, plus 1 for the negative direction.
fn side_of(normal: DVec3) -> u8 {
    let size = normal.abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    2 * axis as u8 + u8::from(normal[axis] < 0.0)
}

/// Texture coordinates of a position in image widths on a side seen from outside; upright (v runs
/// along −z) on the four vertical sides.
fn box_uv(p: DVec3, side: u8) -> [f32; 2] {
    let uv = match side {
        0 => [p.y, -p.z],
        1 => [-p.y, -p.z],
        2 => [-p.x, -p.z],
        3 => [p.x, -p.z],
        4 => [p.x, -p.y],
        _ => [p.x, p.y],
    };
    uv.map(|c| c as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::{CREASE_RAD, builtin};

    #[test]
    fn box_has_sharp_edges_and_sphere_is_smooth() {
        let mesh = builtin("box").unwrap();
        let shaded = shaded_mesh(&mesh, CREASE_RAD, Projection::None, 0);
        for normal in &shaded.normals {
            assert!((normal.abs().max_element() - 1.0).abs() < 1e-5, "{normal}");
        }
        assert!(shaded.uvs.is_empty());
        let mesh = builtin("sphere").unwrap();
        let shaded = shaded_mesh(&mesh, CREASE_RAD, Projection::None, 3);
        assert_eq!(shaded.positions.len(), mesh.vertices.len());
        assert_eq!(shaded.material, 3);
        for (position, normal) in shaded.positions.iter().zip(&shaded.normals) {
            assert!(position.normalize().dot(*normal) > 0.99);
        }
    }

    #[test]
    fn box_projection_keeps_scale_and_orientation() {
        let projection = Projection::Box {
            width_m: 0.02,
            origin_m: DVec3::splat(0.3),
        };
        let mesh = builtin("box").unwrap();
        let shaded = shaded_mesh(&mesh, CREASE_RAD, projection, 0);
        assert_eq!(shaded.uvs.len(), shaded.positions.len());
        for t in &shaded.triangles {
            let [a, b, c] = t.map(|v| shaded.positions[v as usize]);
            let [p, q, r] = t.map(|v| shaded.uvs[v as usize]);
            let area = 0.5 * (b - a).cross(c - a).length() / (0.02 * 0.02);
            let signed = 0.5 * ((q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1]));
            // v runs down, so that an image seen from outside has negative area.
            assert!(
                (signed + area).abs() < 1e-3 * area.max(1.0),
                "{signed} {area}"
            );
        }
    }

    #[test]
    fn degenerate_triangle_has_unit_normals() {
        let mesh = TriangleMesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::X],
            triangles: vec![[0, 1, 2]],
        };
        let shaded = shaded_mesh(
            &mesh,
            CREASE_RAD,
            Projection::Box {
                width_m: 0.1,
                origin_m: DVec3::ZERO,
            },
            0,
        );
        assert!(
            shaded
                .normals
                .iter()
                .all(|n| (n.length() - 1.0).abs() < 1e-6)
        );
    }
}
