//! Splits edges and vertices at which the surface touches itself.

use glam::DVec3;

use super::place_mm;
use crate::mesh::{MeshEdges, TriangleMesh};
use crate::weld::root;
use gripcast_base::error::{Error, Result};

/// Smallest angle between two triangles at an edge for telling which is next, rad.
const MIN_WEDGE_RAD: f64 = 1e-6;

/// Pairs of triangles that are neighbours across an edge.
struct Pairing {
    /// Edge and its two triangles.
    pairs: Vec<(usize, [u32; 2])>,
}

/// Copy in which each edge has two triangles and the triangles at each vertex form one fan.
/// Where the surface touches itself, vertices are doubled: each solid side keeps its own.
///
/// # Errors
/// `Input` for an edge with an odd number of triangles, or where it is unclear which triangles
/// belong together.
pub(super) fn split(mesh: &TriangleMesh, warnings: &mut Vec<String>) -> Result<TriangleMesh> {
    let mut mesh = mesh.clone();
    let (before, mut crowded_edges) = (mesh.vertices.len(), None);
    loop {
        let edges = mesh.edges();
        let pairing = pair(&mesh, &edges)?;
        crowded_edges.get_or_insert_with(|| {
            (0..edges.len())
                .filter(|&e| edges.triangles(e).len() > 2)
                .count()
        });
        mesh = with_separate_fans(&mesh, &edges, &pairing);
        let edges = mesh.edges();
        // Both ends of the edge may hang together elsewhere: a vertex in its middle parts it.
        match (0..edges.len()).find(|&e| edges.triangles(e).len() > 2) {
            Some(edge) => insert_middle(&mut mesh, &edges, edge)?,
            None => break,
        }
    }
    let added = mesh.vertices.len() - before;
    if added > 0 {
        warnings.push(format!(
            "split {} edge(s) with more than two triangles and doubled {added} vertices where \
             the surface touches itself",
            crowded_edges.unwrap_or(0)
        ));
    }
    Ok(mesh)
}

fn pair(mesh: &TriangleMesh, edges: &MeshEdges) -> Result<Pairing> {
    let mut pairs = Vec::with_capacity(edges.len());
    for edge in 0..edges.len() {
        match edges.triangles(edge) {
            &[a, b] => pairs.push((edge, [a, b])),
            around => {
                let wedges = solid_wedges(mesh, edges.vertices[edge], around);
                let wedges = wedges.ok_or_else(|| unclear(mesh, edges, edge))?;
                pairs.extend(wedges.into_iter().map(|pair| (edge, pair)));
            }
        }
    }
    Ok(Pairing { pairs })
}

fn unclear(mesh: &TriangleMesh, edges: &MeshEdges, edge: usize) -> Error {
    let [a, b] = edges.vertices[edge].map(|v| mesh.vertices[v as usize]);
    Error::input(format!(
        "an edge must have two triangles, found {} near {}",
        edges.triangles(edge).len(),
        place_mm(0.5 * (a + b))
    ))
    .remedy("remove inner faces and doubled sheets in a mesh editor (\"make manifold\")")
}

/// Pairs of triangles that bound the same solid wedge at an edge; none if the triangles do not
/// alternate between facing along and against the turn about it.
fn solid_wedges(mesh: &TriangleMesh, [a, b]: [u32; 2], around: &[u32]) -> Option<Vec<[u32; 2]>> {
    let (origin, end) = (mesh.vertices[a as usize], mesh.vertices[b as usize]);
    let axis = (end - origin).normalize_or_zero();
    let (u, v) = axis.any_orthonormal_pair();
    let mut turn: Vec<(f64, bool, u32)> = around
        .iter()
        .map(|&t| {
            let corners = mesh.triangles[t as usize];
            let apex = corners.into_iter().find(|c| ![a, b].contains(c));
            let arm = apex.map_or(DVec3::ZERO, |c| mesh.vertices[c as usize] - origin);
            let angle = arm.dot(v).atan2(arm.dot(u));
            (angle, runs_along(corners, a, b), t)
        })
        .collect();
    turn.sort_unstable_by(|x, y| x.0.total_cmp(&y.0).then(x.2.cmp(&y.2)));
    // Counter-clockwise about the axis, a triangle that runs against it has the solid behind
    // itself, up to the next one, which must run along it.
    let start = turn.iter().position(|(_, along, _)| !along)?;
    turn.rotate_left(start);
    let clear = turn
        .windows(2)
        .all(|w| (w[1].0 - w[0].0).abs() > MIN_WEDGE_RAD);
    let alternates = turn.iter().enumerate().all(|(i, t)| t.1 == (i % 2 == 1));
    (clear && alternates && turn.len().is_multiple_of(2))
        .then(|| turn.chunks_exact(2).map(|w| [w[0].2, w[1].2]).collect())
}

/// Whether a triangle runs from `a` to `b`, not back.
fn runs_along(triangle: [u32; 3], a: u32, b: u32) -> bool {
    let [p, q, r] = triangle;
    [(p, q), (q, r), (r, p)].contains(&(a, b))
}

/// Copy in which corners share a vertex only if their triangles hang together around it.
fn with_separate_fans(mesh: &TriangleMesh, edges: &MeshEdges, pairing: &Pairing) -> TriangleMesh {
    let mut parent: Vec<u32> = (0..3 * mesh.triangles.len() as u32).collect();
    let corner = |t: u32, v: u32| {
        let at = mesh.triangles[t as usize].iter().position(|&c| c == v);
        3 * t + at.unwrap_or(0) as u32
    };
    for &(edge, [s, t]) in &pairing.pairs {
        for v in edges.vertices[edge] {
            let (x, y) = (
                root(&mut parent, corner(s, v)),
                root(&mut parent, corner(t, v)),
            );
            parent[x.max(y) as usize] = x.min(y);
        }
    }
    // The first fan of a vertex keeps its number, so that sound meshes stay as they are.
    const NONE: u32 = u32::MAX;
    let mut vertices = mesh.vertices.clone();
    let mut taken = vec![false; vertices.len()];
    let mut vertex_of = vec![NONE; parent.len()];
    let mut triangles = mesh.triangles.clone();
    for (t, triangle) in triangles.iter_mut().enumerate() {
        for (k, vertex) in triangle.iter_mut().enumerate() {
            let fan = root(&mut parent, (3 * t + k) as u32) as usize;
            if vertex_of[fan] == NONE {
                vertex_of[fan] = *vertex;
                if std::mem::replace(&mut taken[*vertex as usize], true) {
                    vertex_of[fan] = vertices.len() as u32;
                    vertices.push(vertices[*vertex as usize]);
                }
            }
            *vertex = vertex_of[fan];
        }
    }
    TriangleMesh {
        vertices,
        triangles,
    }
}

/// Gives one solid wedge at a crowded edge a vertex of its own in the middle.
fn insert_middle(mesh: &mut TriangleMesh, edges: &MeshEdges, edge: usize) -> Result<()> {
    let [a, b] = edges.vertices[edge];
    let wedges = solid_wedges(mesh, [a, b], edges.triangles(edge));
    let wedge = wedges.and_then(|w| w.last().copied());
    let wedge = wedge.ok_or_else(|| unclear(mesh, edges, edge))?;
    let middle = mesh.vertices.len() as u32;
    let place = 0.5 * (mesh.vertices[a as usize] + mesh.vertices[b as usize]);
    mesh.vertices.push(place);
    for t in wedge {
        let whole = mesh.triangles[t as usize];
        mesh.triangles[t as usize] = whole.map(|v| if v == b { middle } else { v });
        let rest = whole.map(|v| if v == a { middle } else { v });
        mesh.triangles.push(rest);
    }
    Ok(())
}
