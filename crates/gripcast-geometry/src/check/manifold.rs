//! Splits non-manifold edges and vertices, where the surface touches itself.

use glam::DVec3;

use super::position_mm;
use crate::mesh::{MeshEdges, TriangleMesh};
use crate::weld::{join, root};
use gripcast_base::error::{Error, Result};

/// Smallest angle between two triangles at an edge whose order is unambiguous, rad.
const MIN_WEDGE_RAD: f64 = 1e-6;

/// An edge and two triangles that are neighbours across it.
type Pair = (usize, [u32; 2]);

/// Copy in which each edge has two triangles and the triangles at each vertex form one fan.
/// Where the surface touches itself, vertices are duplicated: one for each solid side.
///
/// # Errors
/// `Input` for an edge with an odd number of triangles, or where it is unclear which triangles
/// belong together.
pub(super) fn split(mesh: &TriangleMesh, warnings: &mut Vec<String>) -> Result<TriangleMesh> {
    let mut mesh = mesh.clone();
    let (before, mut non_manifold_edges) = (mesh.vertices.len(), None);
    loop {
        let edges = mesh.edges();
        let pairs = pair(&mesh, &edges)?;
        non_manifold_edges.get_or_insert_with(|| {
            (0..edges.len())
                .filter(|&e| edges.triangles(e).len() > 2)
                .count()
        });
        mesh = with_separate_fans(&mesh, &edges, &pairs);
        let edges = mesh.edges();
        // Fans at both ends of the edge may be connected elsewhere: a new vertex splits the edge.
        match (0..edges.len()).find(|&e| edges.triangles(e).len() > 2) {
            Some(edge) => split_wedge(&mut mesh, &edges, edge)?,
            None => break,
        }
    }
    let added = mesh.vertices.len() - before;
    if added > 0 {
        warnings.push(format!(
            "split {} edge(s) with more than two triangles and duplicated {added} vertices where \
             the surface touches itself",
            non_manifold_edges.unwrap_or(0)
        ));
    }
    Ok(mesh)
}

/// Pairs the triangles at each edge that bound the same solid.
fn pair(mesh: &TriangleMesh, edges: &MeshEdges) -> Result<Vec<Pair>> {
    let mut pairs = Vec::with_capacity(edges.len());
    for edge in 0..edges.len() {
        match edges.triangles(edge) {
            &[a, b] => pairs.push((edge, [a, b])),
            around => {
                let wedges = solid_wedges(mesh, edges.vertices[edge], around);
                let wedges = wedges.ok_or_else(|| ambiguous(mesh, edges, edge))?;
                pairs.extend(wedges.into_iter().map(|pair| (edge, pair)));
            }
        }
    }
    Ok(pairs)
}

fn ambiguous(mesh: &TriangleMesh, edges: &MeshEdges, edge: usize) -> Error {
    let [a, b] = edges.vertices[edge].map(|v| mesh.vertices[v as usize]);
    Error::input(format!(
        "an edge must have two triangles, found {} near {}",
        edges.triangles(edge).len(),
        position_mm(0.5 * (a + b))
    ))
    .remedy("remove inner faces and duplicate sheets in a mesh editor (\"make manifold\")")
}

/// Pairs of triangles that bound the same solid wedge at an edge; `None` if the triangles do not
/// alternate in orientation around it.
fn solid_wedges(mesh: &TriangleMesh, [a, b]: [u32; 2], around: &[u32]) -> Option<Vec<[u32; 2]>> {
    let (origin, end) = (mesh.vertices[a as usize], mesh.vertices[b as usize]);
    let axis = (end - origin).normalize_or_zero();
    let (u, v) = axis.any_orthonormal_pair();
    let mut ordered: Vec<(f64, bool, u32)> = around
        .iter()
        .map(|&t| {
            let corners = mesh.triangles[t as usize];
            let apex = corners.into_iter().find(|c| ![a, b].contains(c));
            let arm = apex.map_or(DVec3::ZERO, |c| mesh.vertices[c as usize] - origin);
            let angle = arm.dot(v).atan2(arm.dot(u));
            (angle, runs_along(corners, a, b), t)
        })
        .collect();
    ordered.sort_unstable_by(|x, y| x.0.total_cmp(&y.0).then(x.2.cmp(&y.2)));
    // Counter-clockwise about the axis, the solid extends from a triangle that runs against the
    // edge to the next one, which must run along it.
    let start = ordered.iter().position(|(_, along, _)| !along)?;
    ordered.rotate_left(start);
    let clear = ordered
        .windows(2)
        .all(|w| (w[1].0 - w[0].0).abs() > MIN_WEDGE_RAD);
    let alternates = ordered.iter().enumerate().all(|(i, t)| t.1 == (i % 2 == 1));
    (clear && alternates && ordered.len().is_multiple_of(2))
        .then(|| ordered.chunks_exact(2).map(|w| [w[0].2, w[1].2]).collect())
}

/// Whether a triangle has the directed side from `a` to `b`.
pub(super) fn runs_along(triangle: [u32; 3], a: u32, b: u32) -> bool {
    let [p, q, r] = triangle;
    [(p, q), (q, r), (r, p)].contains(&(a, b))
}

/// Copy in which corners share a vertex only if their triangles are connected around it.
fn with_separate_fans(mesh: &TriangleMesh, edges: &MeshEdges, pairs: &[Pair]) -> TriangleMesh {
    let mut parent: Vec<u32> = (0..3 * mesh.triangles.len() as u32).collect();
    let corner = |t: u32, v: u32| {
        let corner = mesh.triangles[t as usize].iter().position(|&c| c == v);
        3 * t + corner.unwrap_or(0) as u32
    };
    for &(edge, [s, t]) in pairs {
        for v in edges.vertices[edge] {
            join(&mut parent, corner(s, v), corner(t, v));
        }
    }
    // The first fan of a vertex keeps its index, so that manifold meshes are unchanged.
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

/// Splits one solid wedge at a non-manifold edge by a new vertex at the middle of the edge.
fn split_wedge(mesh: &mut TriangleMesh, edges: &MeshEdges, edge: usize) -> Result<()> {
    let [a, b] = edges.vertices[edge];
    let wedges = solid_wedges(mesh, [a, b], edges.triangles(edge));
    let wedge = wedges.and_then(|w| w.last().copied());
    let wedge = wedge.ok_or_else(|| ambiguous(mesh, edges, edge))?;
    let middle = mesh.vertices.len() as u32;
    let position = 0.5 * (mesh.vertices[a as usize] + mesh.vertices[b as usize]);
    mesh.vertices.push(position);
    for t in wedge {
        let whole = mesh.triangles[t as usize];
        mesh.triangles[t as usize] = whole.map(|v| if v == b { middle } else { v });
        let rest = whole.map(|v| if v == a { middle } else { v });
        mesh.triangles.push(rest);
    }
    Ok(())
}
