//! Gives an open surface a wall.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};

use crate::mesh::TriangleMesh;
use crate::solid::Solid;
use crate::weld::weld;
use gripcast_base::error::{Error, Result};

/// Largest distance of an inner corner from its outer corner, in wall thicknesses: sharper edges get
/// a thinner wall.
const MAX_MITER: f64 = 4.0;

/// The shell between an open surface and its copy behind it, closed along the boundary. The outer
/// side stays where it is; flat and moderately bent walls are `thickness_m` thick.
///
/// # Errors
/// `Input` for a thickness that is not above 0 and below the size of the mesh.
pub(super) fn thickened(
    mesh: &TriangleMesh,
    thickness_m: f64,
    warnings: &mut Vec<String>,
) -> Result<TriangleMesh> {
    let size = mesh.bounds().extent().max_element();
    if !(thickness_m > 0.0 && thickness_m < 0.5 * size) {
        return Err(Error::input(format!(
            "the wall must be above 0 and thinner than half of the mesh, found {} mm at a size of \
             {} mm",
            super::millimetres(thickness_m),
            super::millimetres(size)
        ))
        .remedy("pass --wall-thickness-mm, for instance 2"));
    }
    let open = weld(mesh, 0.0);
    let edges = open.edges();
    let is_rim = |edge: &usize| edges.triangles(*edge).len() % 2 == 1;
    let rim: Vec<usize> = (0..edges.len()).filter(is_rim).collect();
    if rim.is_empty() {
        warnings.push("the surface is closed: the wall thickness is not used".to_owned());
        return Ok(mesh.clone());
    }
    let count = open.vertices.len() as u32;
    let mut shell = open.clone();
    let inner = open.vertices.iter().zip(inward(&open));
    shell
        .vertices
        .extend(inner.map(|(v, inward)| *v + inward * thickness_m));
    let behind = open.triangles.iter();
    shell
        .triangles
        .extend(behind.map(|[a, b, c]| [a + count, c + count, b + count]));
    for edge in rim {
        let [a, b] = edges.vertices[edge];
        let triangle = edges.triangles(edge)[0] as usize;
        let is_along = super::manifold::runs_along(open.triangles[triangle], a, b);
        let [a, b] = if is_along { [a, b] } else { [b, a] };
        shell
            .triangles
            .extend([[b, a, a + count], [b, a + count, b + count]]);
    }
    let volume_cm3 = 1e6 * Solid::of(&shell)?.properties.volume_m3;
    warnings.push(format!(
        "gave the open surface a wall of {} mm: {volume_cm3:.3} cm³ of material",
        super::millimetres(thickness_m)
    ));
    Ok(shell)
}

/// For each vertex, the shift that moves its triangles inwards by 1, as a least-squares solution
/// over their normals, weighted by area.
fn inward(mesh: &TriangleMesh) -> Vec<DVec3> {
    let mut sums: BTreeMap<u32, (DMat3, DVec3)> = BTreeMap::new();
    for triangle in &mesh.triangles {
        let [a, b, c] = mesh.corners(*triangle);
        let scaled = (b - a).cross(c - a);
        let (normal, area) = (scaled.normalize_or_zero(), scaled.length());
        for &vertex in triangle {
            let sum = sums.entry(vertex).or_insert((DMat3::ZERO, DVec3::ZERO));
            sum.0 +=
                DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z) * area;
            sum.1 -= normal * area;
        }
    }
    let shift = |(matrix, vector): &(DMat3, DVec3)| {
        let trace = matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z;
        if trace <= 0.0 {
            return DVec3::ZERO;
        }
        // The small diagonal chooses the shortest of many solutions. Divided by the trace first,
        // because the determinant of vanishing areas is 0.
        let regular = *matrix * trace.recip() + DMat3::from_diagonal(DVec3::splat(1e-6));
        let shift = regular.inverse() * (*vector / trace);
        if shift.is_finite() {
            shift.clamp_length_max(MAX_MITER)
        } else {
            DVec3::ZERO
        }
    };
    (0..mesh.vertices.len() as u32)
        .map(|v| sums.get(&v).map_or(DVec3::ZERO, shift))
        .collect()
}
