//! Makes all triangles face outwards.

use glam::DVec3;

use super::{millimetres, place_mm};
use crate::mesh::TriangleMesh;
use crate::mesh_query::MeshQuery;
use gripcast_base::error::{Error, Result};

/// Places at which it is tested whether a component lies inside of another.
const NESTING_SAMPLES: usize = 16;

/// Turns triangles of a mesh with two triangles at each edge so that neighbours agree, outer
/// surfaces face outwards, and surfaces within a solid (cavities) face into the cavity.
///
/// # Errors
/// `Input` for a one-sided surface (Möbius strip, Klein bottle) and for a component without
/// volume.
pub(super) fn face_outwards(mesh: &mut TriangleMesh, warnings: &mut Vec<String>) -> Result<()> {
    let components = components(mesh)?;
    let disagreeing: usize = components.iter().map(|c| c.disagreeing).sum();
    for &triangle in components.iter().flat_map(|c| &c.to_turn) {
        mesh.triangles[triangle as usize].swap(1, 2);
    }
    if disagreeing > 0 {
        warnings.push(format!(
            "turned {disagreeing} triangle(s) that faced against their neighbours"
        ));
    }
    let depths = nesting_depths(mesh, &components);
    let mut inverted = 0;
    for (component, depth) in components.iter().zip(depths) {
        let volume = volume(mesh, &component.triangles);
        refuse_flat(mesh, component, volume)?;
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
            "turned {inverted} of {all} component(s) that faced the wrong way (components inside \
             of another are cavities)"
        ));
    }
    Ok(())
}

/// Triangles that hang together by edges.
struct Component {
    /// Ascending.
    triangles: Vec<u32>,
    /// Triangles to turn so that all agree.
    to_turn: Vec<u32>,
    /// Size of the smaller of the two groups that disagree.
    disagreeing: usize,
}

fn components(mesh: &TriangleMesh) -> Result<Vec<Component>> {
    let edges = mesh.edges();
    let mut sides: Vec<Vec<(u32, bool)>> = vec![Vec::with_capacity(3); mesh.triangles.len()];
    for edge in 0..edges.len() {
        if let &[s, t] = edges.triangles(edge) {
            let [a, b] = edges.vertices[edge];
            let along = |t: u32| {
                let [p, q, r] = mesh.triangles[t as usize];
                [(p, q), (q, r), (r, p)].contains(&(a, b))
            };
            let agree = along(s) != along(t);
            sides[s as usize].push((t, agree));
            sides[t as usize].push((s, agree));
        }
    }
    let mut turned: Vec<Option<bool>> = vec![None; mesh.triangles.len()];
    let mut components = Vec::new();
    for seed in 0..mesh.triangles.len() as u32 {
        if turned[seed as usize].is_some() {
            continue;
        }
        turned[seed as usize] = Some(false);
        let mut open = vec![seed];
        let mut found = vec![seed];
        while let Some(t) = open.pop() {
            for &(next, agree) in &sides[t as usize] {
                let wanted = turned[t as usize].map(|turn| turn == agree);
                match turned[next as usize] {
                    None => {
                        turned[next as usize] = wanted;
                        open.push(next);
                        found.push(next);
                    }
                    is if is != wanted => return Err(one_sided(mesh, next)),
                    Some(_) => {}
                }
            }
        }
        found.sort_unstable();
        components.push(Component::new(found, &turned));
    }
    Ok(components)
}

impl Component {
    fn new(triangles: Vec<u32>, turned: &[Option<bool>]) -> Self {
        let is_turned = |t: &u32| turned[*t as usize] == Some(true);
        let count = triangles.iter().filter(|t| is_turned(t)).count();
        // The majority stays as it is.
        let turn_marked = 2 * count <= triangles.len();
        let to_turn: Vec<u32> = triangles
            .iter()
            .copied()
            .filter(|t| is_turned(t) == turn_marked)
            .collect();
        Self {
            disagreeing: to_turn.len(),
            triangles,
            to_turn,
        }
    }
}

fn one_sided(mesh: &TriangleMesh, triangle: u32) -> Error {
    let corner = mesh.corners(mesh.triangles[triangle as usize])[0];
    Error::input(format!(
        "the surface must have an inside, found it one-sided (like a Möbius strip) near {}",
        place_mm(corner)
    ))
    .remedy("remodel the part as a solid body, or remesh it by voxels")
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

/// Refuses a component that encloses less than a film of 1e-6 of its extent would.
fn refuse_flat(mesh: &TriangleMesh, component: &Component, volume: f64) -> Result<()> {
    let part = sub_mesh(mesh, &component.triangles);
    let (area, bounds) = (part.area(), part.bounds());
    if volume.abs() > 1e-6 * area * bounds.diagonal() {
        return Ok(());
    }
    Err(Error::input(format!(
        "each component must enclose a volume, found one of {} triangles without, {} mm wide \
             around {}",
        component.triangles.len(),
        millimetres(bounds.extent().max_element()),
        place_mm(bounds.center())
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

/// For each component the number of others that it lies in.
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
            // Several samples, for a component that passes through another is not inside of it.
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
