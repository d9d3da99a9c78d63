//! Orients all triangles outwards.

use glam::DVec3;

use super::manifold::runs_along;
use super::{millimetres, position_mm};
use crate::mesh::TriangleMesh;
use crate::mesh_query::MeshQuery;
use gripcast_base::error::{Error, Result};

/// Sample points for testing whether a component lies inside another.
const NESTING_SAMPLES: usize = 16;

/// Flips triangles of a manifold mesh so that neighbours agree and outer surfaces face outwards. A
/// component inside another keeps its orientation relative to the outermost one: it is a cavity if
/// they are opposite.
///
/// # Errors
/// `Input` for a non-orientable surface (Möbius strip, Klein bottle) and for a component without
/// volume.
pub(super) fn orient_outwards(mesh: &mut TriangleMesh, warnings: &mut Vec<String>) -> Result<()> {
    let (components, conflict) = components(mesh);
    if let Some(triangle) = conflict {
        return Err(non_orientable(mesh, triangle));
    }
    flip_to_neighbours(mesh, &components, warnings);
    for component in &components {
        let volume = volume(mesh, &component.triangles);
        require_volume(mesh, component, volume)?;
    }
    let closed: Vec<&Component> = components.iter().collect();
    flip_inward(mesh, &closed, components.len(), warnings);
    Ok(())
}

/// Flips the minority of the triangles of each component, so that neighbours agree.
pub(super) fn flip_to_neighbours(
    mesh: &mut TriangleMesh,
    components: &[Component],
    warnings: &mut Vec<String>,
) {
    let flipped: usize = components.iter().map(|c| c.to_flip.len()).sum();
    for component in components {
        flip(mesh, &component.to_flip);
    }
    if flipped > 0 {
        warnings.push(format!(
            "flipped {flipped} triangle(s) that faced against their neighbours"
        ));
    }
}

/// Flips the closed components of which the outermost one around them, or they themselves, face
/// inwards; `all` is the number of components including open ones.
pub(super) fn flip_inward(
    mesh: &mut TriangleMesh,
    closed: &[&Component],
    all: usize,
    warnings: &mut Vec<String>,
) {
    let is_inward: Vec<bool> = closed
        .iter()
        .map(|component| volume(mesh, &component.triangles) < 0.0)
        .collect();
    let outermost = outermost(mesh, closed);
    let mut inverted = 0;
    for (component, outermost) in closed.iter().zip(outermost) {
        if is_inward[outermost] {
            inverted += 1;
            flip(mesh, &component.triangles);
        }
    }
    if inverted > 0 {
        warnings.push(format!(
            "flipped {inverted} of {all} component(s) that faced inwards"
        ));
    }
}

/// Flips triangles.
pub(super) fn flip(mesh: &mut TriangleMesh, triangles: &[u32]) {
    for &triangle in triangles {
        mesh.triangles[triangle as usize].swap(1, 2);
    }
}

/// Triangles connected by edges.
pub(super) struct Component {
    /// In ascending order.
    pub(super) triangles: Vec<u32>,
    /// Triangles to flip for a consistent orientation.
    to_flip: Vec<u32>,
    /// Whether each of their edges has two triangles.
    pub(super) is_closed: bool,
}

/// Components connected by edges with two triangles, and a triangle that cannot agree with all its
/// neighbours.
pub(super) fn components(mesh: &TriangleMesh) -> (Vec<Component>, Option<u32>) {
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
    let mut conflict = None;
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
                    found if found != expected => {
                        conflict.get_or_insert(next);
                    }
                    Some(_) => {}
                }
            }
        }
        found.sort_unstable();
        let is_closed = found.iter().all(|t| sides[*t as usize].len() == 3);
        components.push(Component::new(found, &is_flipped, is_closed));
    }
    (components, conflict)
}

impl Component {
    fn new(triangles: Vec<u32>, is_flipped: &[Option<bool>], is_closed: bool) -> Self {
        let (mut to_flip, rest): (Vec<u32>, Vec<u32>) = triangles
            .iter()
            .partition(|t| is_flipped[**t as usize] == Some(true));
        // The majority keeps its orientation.
        if to_flip.len() > rest.len() {
            to_flip = rest;
        }
        Self {
            triangles,
            to_flip,
            is_closed,
        }
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

/// Signed volume of a closed component, m³.
pub(super) fn volume(mesh: &TriangleMesh, triangles: &[u32]) -> f64 {
    let origin = triangles.first().map_or(DVec3::ZERO, |&t| {
        mesh.corners(mesh.triangles[t as usize])[0]
    });
    cone_volume(mesh, triangles, origin)
}

/// Signed volume between the triangles of an open component and their mean position, m³: negative
/// if they face it.
pub(super) fn volume_about_center(mesh: &TriangleMesh, triangles: &[u32]) -> f64 {
    let corners = triangles
        .iter()
        .flat_map(|&t| mesh.corners(mesh.triangles[t as usize]));
    let mean = corners.sum::<DVec3>() / (3 * triangles.len().max(1)) as f64;
    cone_volume(mesh, triangles, mean)
}

fn cone_volume(mesh: &TriangleMesh, triangles: &[u32], origin: DVec3) -> f64 {
    let corners = |&t: &u32| mesh.corners(mesh.triangles[t as usize]);
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

pub(super) fn sub_mesh(mesh: &TriangleMesh, triangles: &[u32]) -> TriangleMesh {
    let chosen = triangles.iter().map(|&t| mesh.triangles[t as usize]);
    TriangleMesh {
        vertices: mesh.vertices.clone(),
        triangles: chosen.collect(),
    }
    .without_unused_vertices()
}

/// For each component, the outermost one that contains it; itself if none does.
fn outermost(mesh: &TriangleMesh, components: &[&Component]) -> Vec<usize> {
    let parts: Vec<MeshQuery> = components
        .iter()
        .map(|c| MeshQuery::new(&sub_mesh(mesh, &c.triangles)))
        .collect();
    let centroid = |&t: &u32| {
        let [a, b, c] = mesh.corners(mesh.triangles[t as usize]);
        (a + b + c) / 3.0
    };
    let mut containers: Vec<Vec<usize>> = Vec::with_capacity(components.len());
    for (own, component) in components.iter().enumerate() {
        // Several samples: a component that intersects another is not inside it.
        let step = component.triangles.len().div_ceil(NESTING_SAMPLES);
        let samples: Vec<DVec3> = component
            .triangles
            .iter()
            .step_by(step.max(1))
            .map(centroid)
            .collect();
        let others = parts.iter().enumerate().filter(|(other, _)| *other != own);
        let around = others.filter(|(_, part)| samples.iter().all(|&p| part.contains(p)));
        containers.push(around.map(|(other, _)| other).collect());
    }
    (0..components.len())
        .map(|own| {
            let around = containers[own].iter().copied();
            around
                .min_by_key(|&other| containers[other].len())
                .unwrap_or(own)
        })
        .collect()
}
