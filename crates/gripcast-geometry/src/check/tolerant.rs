//! Repairs of meshes that are not one closed manifold, for contact.

use glam::DVec3;

use super::winding::{self, Component, flip};
use super::{PrepareOptions, duplicates, manifold, require_triangles, self_intersection, slivers};
use crate::mass_properties::MassProperties;
use crate::mesh::TriangleMesh;
use crate::mesh_query::MeshQuery;
use crate::solid::hole_area;
use crate::weld::{join, root, weld};
use gripcast_base::error::Result;

/// Gap between the sides of a crack, as a fraction of the diagonal.
const CRACK: f64 = 1e-5;
/// Area of a stray, as a fraction of the surface.
const STRAY_AREA: f64 = 1e-3;
/// Distance of a stray from the rest, in its own diagonals.
const STRAY_DISTANCE: f64 = 1.0;
/// Area of the holes, as a fraction of the surface, of a surface that is closed as it faces.
const FITTING: f64 = 1e-3;
/// Area of the holes, as a fraction of the surface, of a surface whose pieces fit each other.
const NEARLY_CLOSED: f64 = 0.05;
/// Triangles of an open component whose sides are looked at.
const VISIBILITY_SAMPLES: usize = 48;
/// Height of the start of a ray over its triangle, as a fraction of the mesh's diagonal.
const RAY_START: f64 = 1e-6;

/// A mesh that contact can use: triangles with an area that face outwards as far as that can be
/// told. It may be open, cross itself and have edges of more than two triangles.
///
/// # Errors
/// `Input` if no triangle is left.
pub(super) fn repair(
    mesh: &TriangleMesh,
    options: &PrepareOptions,
    warnings: &mut Vec<String>,
) -> Result<TriangleMesh> {
    let mut mesh = weld(mesh, options.weld_tolerance_m);
    duplicates::drop_degenerate(&mut mesh, warnings);
    // What is closed as it faces, if not a manifold, needs no other orientation.
    let fits = hole_area(&mesh) < FITTING && MassProperties::of_closed(&mesh).is_ok();
    if !fits {
        duplicates::drop_duplicates(&mut mesh, warnings);
    }
    require_triangles(&mesh)?;
    close_cracks(&mut mesh, warnings);
    slivers::drop_flat(&mut mesh, f64::MIN_POSITIVE, warnings);
    require_triangles(&mesh)?;
    let mut split = Vec::new();
    if let Ok(manifold) = manifold::split(&mesh, &mut split) {
        mesh = manifold;
        warnings.append(&mut split);
    }
    orient(&mut mesh, fits, warnings);
    let crossings = self_intersection::find(&mesh, options.crossing_tolerance_m);
    if crossings.pairs > 0 {
        warnings.push(format!(
            "the surface crosses itself: {} pair(s) of triangles",
            crossings.pairs
        ));
    }
    Ok(mesh)
}

/// Number of edges with an odd number of triangles.
fn odd_edges(mesh: &TriangleMesh) -> usize {
    let edges = mesh.edges();
    let odd = |edge: &usize| edges.triangles(*edge).len() % 2 == 1;
    (0..edges.len()).filter(odd).count()
}

/// Welds vertices at the sides of cracks, if that closes some.
fn close_cracks(mesh: &mut TriangleMesh, warnings: &mut Vec<String>) {
    let open = odd_edges(mesh);
    if open == 0 {
        return;
    }
    let gap_m = CRACK * mesh.bounds().diagonal();
    let mut closed = weld(mesh, gap_m);
    let mut ignored = Vec::new();
    duplicates::drop_degenerate(&mut closed, &mut ignored);
    let left = odd_edges(&closed);
    if left < open && !closed.triangles.is_empty() {
        warnings.push(format!(
            "closed cracks: {} of {open} boundary edges had another within {:.4} mm",
            open - left,
            1e3 * gap_m
        ));
        *mesh = closed;
    }
}

/// Drops small pieces far from the rest, such as the islands of a scan.
pub(super) fn drop_strays(mesh: &mut TriangleMesh, warnings: &mut Vec<String>) {
    // Pieces are connected by vertices.
    let mut parent: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    for &[a, b, c] in &mesh.triangles {
        join(&mut parent, a, b);
        join(&mut parent, a, c);
    }
    let mut pieces: Vec<Vec<u32>> = vec![Vec::new(); mesh.vertices.len()];
    for (index, triangle) in mesh.triangles.iter().enumerate() {
        pieces[root(&mut parent, triangle[0]) as usize].push(index as u32);
    }
    pieces.retain(|piece| !piece.is_empty());
    if pieces.len() == 1 {
        return;
    }
    let areas = mesh.triangle_areas();
    let area = |piece: &Vec<u32>| piece.iter().map(|t| areas[*t as usize]).sum::<f64>();
    let total: f64 = areas.iter().sum();
    let is_small = |piece: &Vec<u32>| area(piece) < STRAY_AREA * total;
    let (small, large): (Vec<_>, Vec<_>) = pieces.into_iter().partition(is_small);
    if small.is_empty() || large.is_empty() {
        return;
    }
    let rest = MeshQuery::new(&winding::sub_mesh(mesh, &large.concat()));
    let is_far = |piece: &&Vec<u32>| {
        let part = winding::sub_mesh(mesh, piece);
        let reach = STRAY_DISTANCE * part.bounds().diagonal();
        part.vertices.iter().all(|&v| {
            let nearest = rest.closest_point(v);
            nearest.is_some_and(|p| p.distance_m > reach) && !rest.contains(v)
        })
    };
    let strays: Vec<&Vec<u32>> = small.iter().filter(is_far).collect();
    if strays.is_empty() {
        return;
    }
    let lost: f64 = strays.iter().map(|piece| area(piece)).sum();
    let mut is_stray = vec![false; mesh.triangles.len()];
    for &triangle in strays.iter().copied().flatten() {
        is_stray[triangle as usize] = true;
    }
    warnings.push(format!(
        "dropped {} stray piece(s) far from the object, {:.3} % of the surface",
        strays.len(),
        100.0 * lost / total
    ));
    let mut stray = is_stray.iter();
    mesh.triangles.retain(|_| !stray.next().unwrap_or(&false));
    *mesh = mesh.without_unused_vertices();
}

/// Orients closed components outwards and, unless the surface `fits`, neighbours alike and open
/// components towards the side that is visible from outside.
fn orient(mesh: &mut TriangleMesh, fits: bool, warnings: &mut Vec<String>) {
    let (components, _) = winding::components(mesh);
    if !fits {
        winding::flip_to_neighbours(mesh, &components, warnings);
    }
    let (closed, open): (Vec<&Component>, Vec<&Component>) =
        components.iter().partition(|c| c.is_closed);
    winding::flip_inward(mesh, &closed, components.len(), warnings);
    if fits || open.is_empty() {
        return;
    }
    // Pieces that fit each other as they are given stay as they are.
    if hole_area(mesh) < NEARLY_CLOSED {
        let all: Vec<u32> = open.iter().flat_map(|c| &c.triangles).copied().collect();
        if winding::volume_about_center(mesh, &all) < 0.0 {
            flip(mesh, &all);
            warnings.push(format!(
                "flipped {} open piece(s) that faced inwards",
                open.len()
            ));
        }
        return;
    }
    let query = MeshQuery::new(mesh);
    let hidden: Vec<&Component> = open
        .into_iter()
        .filter(|component| faces_inwards(mesh, &query, &component.triangles))
        .collect();
    for component in &hidden {
        flip(mesh, &component.triangles);
    }
    if !hidden.is_empty() {
        warnings.push(format!(
            "flipped {} open piece(s) whose back is seen from outside",
            hidden.len()
        ));
    }
}

/// Whether more rays escape from the back of some triangles than from their front (Takayama et al.,
/// *A simple method for correcting facet orientations in polygon meshes based on ray casting*, JCGT
/// 2014). Where neither side is hidden, whether they face their own middle.
fn faces_inwards(mesh: &TriangleMesh, query: &MeshQuery, triangles: &[u32]) -> bool {
    let start = RAY_START * query.bounds().diagonal();
    let step = triangles.len().div_ceil(VISIBILITY_SAMPLES).max(1);
    let mut score = 0i64;
    for &triangle in triangles.iter().step_by(step) {
        let [a, b, c] = mesh.corners(mesh.triangles[triangle as usize]);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let (u, v) = normal.any_orthonormal_pair();
        for (sign, side) in [(1, normal), (-1, -normal)] {
            let origin = (a + b + c) / 3.0 + side * start;
            for across in [DVec3::ZERO, u, -u, v, -v] {
                let escapes = query
                    .ray_cast(origin, side + across, f64::INFINITY)
                    .is_none();
                score += sign * i64::from(escapes);
            }
        }
    }
    match score {
        0 => winding::volume_about_center(mesh, triangles) < 0.0,
        score => score < 0,
    }
}
