//! Checks and repairs meshes for simulation.
//!
//! A simulated object must be closed, face outwards and not intersect itself. Defects that can be
//! repaired without changing the shape are repaired with a warning; others are errors with their
//! position.

mod duplicates;
mod manifold;
mod self_intersection;
mod slivers;
mod winding;

use glam::DVec3;

use super::mesh::{MeshEdges, TriangleMesh};
use super::mesh_file::REEXPORT;
use super::weld::{join, root, weld};
use gripcast_base::error::{Error, Result};

/// Limits and tolerances of [`prepare`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrepareOptions {
    /// Distance up to which vertices are merged, m. Default 0.1 µm: below the resolution of scans
    /// and prints, above the rounding of single-precision coordinates.
    pub weld_tolerance_m: f64,
    /// Maximum side of the bounding box, m. Default 1 m.
    pub max_extent_m: f64,
    /// Minimum longest side of the bounding box, m. Default 2 mm.
    pub min_extent_m: f64,
    /// Depth up to which self-intersections are tolerated, m. Default 1 µm: slivers of exported
    /// meshes cause such intersections, without effect.
    pub crossing_tolerance_m: f64,
    /// Whether a deeper self-intersection is a warning instead of an error. Default false.
    pub allow_self_intersection: bool,
}

impl Default for PrepareOptions {
    fn default() -> Self {
        Self {
            weld_tolerance_m: 1e-7,
            max_extent_m: 1.0,
            min_extent_m: 2e-3,
            crossing_tolerance_m: 1e-6,
            allow_self_intersection: false,
        }
    }
}

/// A mesh fit for simulation.
#[derive(Clone, Debug, PartialEq)]
pub struct PreparedMesh {
    /// Closed, with two triangles at each edge, counter-clockwise seen from outside; cavities face
    /// inwards. Vertices may coincide where the surface touches itself.
    pub mesh: TriangleMesh,
    /// Repairs, one sentence each, for the user.
    pub warnings: Vec<String>,
}

/// Checks a mesh (m) and repairs defects that do not affect its shape: welds coincident vertices,
/// drops degenerate and duplicate triangles, removes slivers by edge flips, splits non-manifold
/// edges and vertices, and orients all triangles outwards.
///
/// Several components are accepted if each is closed; one inside another is a cavity.
///
/// # Errors
/// `Input`, with position and remedy, for a mesh that is invalid, of implausible size, open,
/// non-orientable, without volume, or self-intersecting.
///
/// ```
/// use gripcast_geometry::{PrepareOptions, builtin, prepare};
/// let prepared = prepare(&builtin("mug")?, &PrepareOptions::default())?;
/// assert!(prepared.warnings.is_empty());
/// # Ok::<(), gripcast_base::error::Error>(())
/// ```
pub fn prepare(mesh: &TriangleMesh, options: &PrepareOptions) -> Result<PreparedMesh> {
    mesh.validate().map_err(|e| e.remedy(REEXPORT))?;
    check_size(mesh, options)?;
    let mut warnings = Vec::new();
    let mut mesh = weld(mesh, options.weld_tolerance_m);
    duplicates::drop_degenerate(&mut mesh, &mut warnings);
    duplicates::drop_duplicates(&mut mesh, &mut warnings);
    require_closed(&mesh)?;
    let mut mesh = manifold::split(&mesh, &mut warnings)?;
    winding::orient_outwards(&mut mesh, &mut warnings)?;
    slivers::remove(&mut mesh, options.weld_tolerance_m, &mut warnings)?;
    check_self_intersection(&mesh, options, &mut warnings)?;
    Ok(PreparedMesh { mesh, warnings })
}

/// Rejects sizes that no gripper can grasp, mostly due to a wrong unit.
fn check_size(mesh: &TriangleMesh, options: &PrepareOptions) -> Result<()> {
    let extent = mesh.bounds().extent().max_element();
    let refuse = |what: &str, limit: f64, remedy: String| {
        let what = format!(
            "the mesh is {} mm long, {what} than the limit of {} mm",
            millimetres(extent),
            millimetres(limit)
        );
        Err(Error::input(what).remedy(remedy))
    };
    if extent > options.max_extent_m {
        let likely = match extent {
            e if e * 1e-3 >= options.min_extent_m => "mm: pass --unit mm",
            e if e * 1e-2 >= options.min_extent_m => "cm: pass --unit cm",
            _ => "in another unit: pass --unit mm, cm or in",
        };
        let remedy = format!("its coordinates look like {likely}, or scale the mesh");
        return refuse("longer", options.max_extent_m, remedy);
    }
    if extent < options.min_extent_m {
        let remedy = "its coordinates look like m: pass --unit m, or scale the mesh";
        return refuse("shorter", options.min_extent_m, remedy.to_string());
    }
    Ok(())
}

/// Rejects a mesh with boundary edges.
fn require_closed(mesh: &TriangleMesh) -> Result<()> {
    let edges = mesh.edges();
    let boundary: Vec<usize> = (0..edges.len())
        .filter(|&edge| edges.triangles(edge).len() == 1)
        .collect();
    if mesh.triangles.is_empty() {
        return Err(
            Error::input("the mesh has only degenerate and duplicate triangles")
                .remedy("export the mesh again as a solid body"),
        );
    }
    if boundary.is_empty() {
        return Ok(());
    }
    let holes = holes(&edges, &boundary, mesh.vertices.len());
    let largest = holes.iter().max_by_key(|hole| hole.len());
    let ends = largest
        .iter()
        .flat_map(|hole| hole.iter())
        .flat_map(|&e| edges.vertices[e]);
    let bounds = super::aabb::Aabb::from_points(ends.map(|v| mesh.vertices[v as usize]));
    Err(Error::input(format!(
        "the mesh must be closed, found {} boundary edges in {} hole(s); the largest is {} mm \
             wide around {}",
        boundary.len(),
        holes.len(),
        millimetres(bounds.extent().max_element()),
        position_mm(bounds.center()),
    ))
    .remedy("close the holes in a mesh editor (\"make manifold\", \"fill holes\")"))
}

/// Groups boundary edges that are connected by vertices.
fn holes(edges: &MeshEdges, boundary: &[usize], vertex_count: usize) -> Vec<Vec<usize>> {
    let mut parent: Vec<u32> = (0..vertex_count as u32).collect();
    for &edge in boundary {
        let [a, b] = edges.vertices[edge];
        join(&mut parent, a, b);
    }
    let mut grouped: Vec<(u32, usize)> = boundary
        .iter()
        .map(|&edge| (root(&mut parent, edges.vertices[edge][0]), edge))
        .collect();
    grouped.sort_unstable();
    grouped
        .chunk_by(|a, b| a.0 == b.0)
        .map(|hole| hole.iter().map(|&(_, edge)| edge).collect())
        .collect()
}

fn check_self_intersection(
    mesh: &TriangleMesh,
    options: &PrepareOptions,
    warnings: &mut Vec<String>,
) -> Result<()> {
    let found = self_intersection::find(mesh, options.crossing_tolerance_m);
    if found.shallow > 0 {
        warnings.push(format!(
            "tolerated {} pair(s) of triangles that intersect by less than {} mm",
            found.shallow,
            options.crossing_tolerance_m * 1e3
        ));
    }
    let Some(position) = found.first_position else {
        return Ok(());
    };
    let what = format!(
        "the surface intersects itself: {} pair(s) of triangles, one near {}",
        found.pairs,
        position_mm(position)
    );
    if options.allow_self_intersection {
        warnings.push(what);
        return Ok(());
    }
    Err(Error::input(what)
        .remedy("merge the overlapping bodies in a mesh editor (boolean union, voxel remesh)"))
}

/// Formats a length in millimetres.
fn millimetres(metres: f64) -> String {
    format!("{:.3}", metres * 1e3)
        .trim_end_matches('0')
        .trim_end_matches('.')
        .to_string()
}

/// Formats a position in millimetres.
fn position_mm(position: DVec3) -> String {
    let [x, y, z] = position.to_array().map(|c| format!("{:.2}", c * 1e3));
    format!("({x}, {y}, {z}) mm")
}

#[cfg(test)]
#[path = "check_test.rs"]
mod tests;
