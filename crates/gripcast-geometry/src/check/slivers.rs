//! Removes triangles without area, whose corners are collinear.

use std::collections::BTreeSet;

use glam::DVec3;

use super::position_mm;
use crate::mesh::TriangleMesh;
use gripcast_base::error::{Error, Result};

/// Rounds of edge flips; flips can create new slivers, more rounds do not help.
const MAX_ROUNDS: usize = 8;

/// Removes triangles lower than `height_m` by flipping their longest side, which moves the surface
/// by less than that height.
///
/// # Errors
/// `Input` if a triangle with zero area, and thus without a normal, remains.
pub(super) fn remove(
    mesh: &mut TriangleMesh,
    height_m: f64,
    warnings: &mut Vec<String>,
) -> Result<()> {
    let mut flipped = 0;
    for _ in 0..MAX_ROUNDS {
        match flip_round(mesh, height_m) {
            0 => break,
            count => flipped += count,
        }
    }
    if flipped > 0 {
        warnings.push(format!("flipped {flipped} triangle(s) without area"));
    }
    require_area(mesh)?;
    let thin = mesh.all_corners().filter(|c| height(c) < height_m).count();
    if thin > 0 {
        warnings.push(format!("{thin} triangle(s) have almost no area"));
    }
    Ok(())
}

/// Rejects a triangle without area, which has no normal.
///
/// # Errors
/// `Input`, with its position.
pub(super) fn require_area(mesh: &TriangleMesh) -> Result<()> {
    let mut areas = mesh.triangle_areas().into_iter();
    if let Some(flat) = areas.position(|area| area < f64::MIN_POSITIVE) {
        let position = position_mm(mesh.corners(mesh.triangles[flat])[0]);
        return Err(Error::input(format!(
            "triangles must have an area above 0, found one with area 0 near {position}"
        ))
        .remedy("dissolve degenerate faces in a mesh editor, or pass --repair auto"));
    }
    Ok(())
}

/// Drops triangles whose height over their longest side is below `height_m`.
pub(super) fn drop_flat(mesh: &mut TriangleMesh, height_m: f64, warnings: &mut Vec<String>) {
    let before = mesh.triangles.len();
    let kept = mesh.triangles.iter().copied();
    let is_wide = |t: &[u32; 3]| height(&mesh.corners(*t)) >= height_m;
    mesh.triangles = kept.filter(is_wide).collect();
    let dropped = before - mesh.triangles.len();
    if dropped > 0 {
        *mesh = mesh.without_unused_vertices();
        warnings.push(format!("dropped {dropped} triangle(s) without area"));
    }
}

/// Height over the longest side, m.
fn height(corners: &[DVec3; 3]) -> f64 {
    let [a, b, c] = *corners;
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    (b - a).cross(c - a).length() / longest
}

/// Flips each sliver once unless its neighbourhood has changed in this round; returns their number.
fn flip_round(mesh: &mut TriangleMesh, height_m: f64) -> usize {
    let slivers: Vec<usize> = (0..mesh.triangles.len())
        .filter(|&t| height(&mesh.corners(mesh.triangles[t])) < height_m)
        .collect();
    if slivers.is_empty() {
        return 0;
    }
    let edges = mesh.edges();
    let mut touched = BTreeSet::new();
    let mut made: BTreeSet<[u32; 2]> = BTreeSet::new();
    let mut flipped = 0;
    for sliver in slivers {
        let [a, apex, c] = longest_side_last(mesh, mesh.triangles[sliver]);
        let Ok(edge) = edges.vertices.binary_search(&[a.min(c), a.max(c)]) else {
            continue;
        };
        let Some(&other) = edges
            .triangles(edge)
            .iter()
            .find(|&&t| t as usize != sliver)
        else {
            continue;
        };
        let across = mesh.triangles[other as usize];
        let Some(far) = across.into_iter().find(|v| ![a, c].contains(v)) else {
            continue;
        };
        let flip = [apex.min(far), apex.max(far)];
        let exists = edges.vertices.binary_search(&flip).is_ok() || made.contains(&flip);
        let busy = touched.contains(&sliver) || touched.contains(&(other as usize));
        let pair = [[a, apex, far], [apex, c, far]];
        let worst = |pair: [[u32; 3]; 2]| {
            let heights = pair.map(|t| height(&mesh.corners(t)));
            heights[0].min(heights[1])
        };
        let better = worst(pair) > worst([mesh.triangles[sliver], across]);
        if exists || busy || !better || apex == far {
            continue;
        }
        mesh.triangles[sliver] = pair[0];
        mesh.triangles[other as usize] = pair[1];
        touched.extend([sliver, other as usize]);
        made.insert(flip);
        flipped += 1;
    }
    flipped
}

/// The corners rotated so that the longest side runs from the third to the first.
fn longest_side_last(mesh: &TriangleMesh, [a, b, c]: [u32; 3]) -> [u32; 3] {
    let length =
        |t: [u32; 3]| mesh.vertices[t[2] as usize].distance_squared(mesh.vertices[t[0] as usize]);
    let rotations = [[a, b, c], [b, c, a], [c, a, b]];
    let longest = rotations
        .into_iter()
        .max_by(|x, y| length(*x).total_cmp(&length(*y)));
    longest.unwrap_or([a, b, c])
}
