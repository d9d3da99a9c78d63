//! Orients all triangles outwards.

use glam::DVec3;

use super::manifold::runs_along;
use super::{millimetres, position_mm};
use crate::mesh::TriangleMesh;
use crate::mesh_query::MeshQuery;
use gripcast_base::error::{Error, Result};

/// Sample points for testing whether a component lies inside another.
const NESTING_SAMPLES: usize = 16;

/// Flips triangles of a manifold mesh so that neighbours agree, outer surfaces face outwards, and
/// cavities face into the cavity.
///
/// # Errors
/// `Input` for a non-orientable surface (Möbius strip, Klein bottle) and for a component without
/// volume.
pub(super) fn orient_outwards(mesh: &mut TriangleMesh, warnings: &mut Vec<String>) -> Result<()> {
    let components = components(mesh)?;
    let flipped: usize = components.iter().map(|c| c.to_flip.len()).sum();
    for &triangle in components.iter().flat_map(|c| &c.to_flip) {
        mesh.triangles[triangle as usize].swap(1, 2);
    }
    if flipped > 0 {
        warnings.push(format!(
            "flipped {flipped} triangle(s) that faced against their neighbours"
        ));
    }
    let depths = nesting_depths(mesh, &components);
    let mut inverted = 0;
    for (component, depth) in components.iter().zip(depths) {
        let volume = volume(mesh, &component.triangles);
        require_volume(mesh, component, volume)?;
        let is_cavity = depth % 2 == 1;
        if (volume < 0.0) != is_cavity {
            inverted += 1;
            for &triangle in &component.triangles {
                mesh.triangles[triangle as usize].swap(1, 2);
            }
        }
    }
    if inverted > 0 {
        let all = components.len();
        warnings.push(format!(
            "flipped {inverted} of {all} component(s) that faced the wrong way (a component inside \
             another is a cavity)"
        ));
    }
    Ok(())
}

/// Triangles connected by edges.
struct Component {
    /// In ascending order.
    triangles: Vec<u32>,
    /// Triangles to flip for a consistent orientation.
    to_flip: Vec<u32>,
}

fn components(mesh: &TriangleMesh) -> Result<Vec<Component>> {
    let edges = mesh.edges();
    let mut sides: Vec<Vec<(u32, bool)>> = vec![Vec::with_capacity(3); mesh.triangles.len()];
    for edge in 0..edges.len() {
        if let &[s, t] = edges.triangles(edge) {
            let [a, b] = edges.vertices[edge];
            let along = |t: u32| runs_along(mesh.triangles[t as usize], a, b);
            let agree = along(s) != along(t);
            sides[s as usize].push((t, agree));
            sides[t as usize].push((s, agree));
        }
    }
    let mut is_flipped: Vec<Option<bool>> = vec![None; mesh.triangles.len()];
    let mut components = Vec::new();
    for seed in 0..mesh.triangles.len() as u32 {
        if is_flipped[seed as usize].is_some() {
            continue;
        }
        is_flipped[seed as usize] = Some(false);
        let mut open = vec![seed];
        let mut found = vec![seed];
        while let Some(t) = open.pop() {
            for &(next, agree) in &sides[t as usize] {
                let expected = is_flipped[t as usize].map(|flipped| flipped == agree);
                match is_flipped[next as usize] {
                    None => {
                        is_flipped[next as usize] = expected;
                        open.push(next);
                        found.push(next);
                    }
                    found if found != expected => return Err(non_orientable(mesh, next)),
                    Some(_) => {}
                }
            }
        }
        found.sort_unstable();
        components.push(Component::new(found, &is_flipped));
    }
    Ok(components)
}

impl Component {
    fn new(triangles: Vec<u32>, is_flipped: &[Option<bool>]) -> Self {
        let (mut to_flip, rest): (Vec<u32>, Vec<u32>) = triangles
            .iter()
            .partition(|t| is_flipped[**t as usize] == Some(true));
        // The majority keeps its orientation.
        if to_flip.len() > rest.len() {
            to_flip = rest;
        }
        Self { triangles, to_flip }
    }
}

fn non_orientable(mesh: &TriangleMesh, triangle: u32) -> Error {
    let corner = mesh.corners(mesh.triangles[triangle as usize])[0];
    Error::input(format!(
        "the surface must be orientable, found it one-sided (like a Möbius strip) near {}",
        position_mm(corner)
    ))
    .remedy("remodel the object as a solid body, or remesh it by voxels")
}

/// Signed volume of a component, m³.
fn volume(mesh: &TriangleMesh, triangles: &[u32]) -> f64 {
    let corners = |&t: &u32| mesh.corners(mesh.triangles[t as usize]);
    let origin = triangles.first().map_or(DVec3::ZERO, |t| corners(t)[0]);
    let sixfold: f64 = triangles
        .iter()
        .map(corners)
        .map(|[a, b, c]| (a - origin).dot((b - origin).cross(c - origin)))
        .sum();
    sixfold / 6.0
}

/// Rejects a component that encloses less than a film as thick as 1e-6 of its extent.
fn require_volume(mesh: &TriangleMesh, component: &Component, volume: f64) -> Result<()> {
    let part = sub_mesh(mesh, &component.triangles);
    let (area, bounds) = (part.area(), part.bounds());
    if volume.abs() > 1e-6 * area * bounds.diagonal() {
        return Ok(());
    }
    Err(Error::input(format!(
        "each component must enclose a volume, found a flat one of {} triangles, {} mm wide \
             around {}",
        component.triangles.len(),
        millimetres(bounds.extent().max_element()),
        position_mm(bounds.center())
    ))
    .remedy("remove the sheet, or give it thickness"))
}

fn sub_mesh(mesh: &TriangleMesh, triangles: &[u32]) -> TriangleMesh {
    let chosen = triangles.iter().map(|&t| mesh.triangles[t as usize]);
    TriangleMesh {
        vertices: mesh.vertices.clone(),
        triangles: chosen.collect(),
    }
    .without_unused_vertices()
}

/// For each component, the number of others that contain it.
fn nesting_depths(mesh: &TriangleMesh, components: &[Component]) -> Vec<usize> {
    if components.len() == 1 {
        return vec![0];
    }
    let parts: Vec<MeshQuery> = components
        .iter()
        .map(|c| MeshQuery::new(&sub_mesh(mesh, &c.triangles)))
        .collect();
    let centroid = |&t: &u32| {
        let [a, b, c] = mesh.corners(mesh.triangles[t as usize]);
        (a + b + c) / 3.0
    };
    components
        .iter()
        .enumerate()
        .map(|(own, component)| {
            // Several samples: a component that intersects another is not inside it.
            let step = component.triangles.len().div_ceil(NESTING_SAMPLES);
            let samples: Vec<DVec3> = component
                .triangles
                .iter()
                .step_by(step)
                .map(centroid)
                .collect();
            let others = parts.iter().enumerate().filter(|(other, _)| *other != own);
            others
                .filter(|(_, part)| samples.iter().all(|&p| part.contains(p)))
                .count()
        })
        .collect()
}
