//! Checks and repairs meshes for simulation.
//!
//! A mesh that is one closed manifold without self-intersections, or becomes one by repairs that do
//! not change its shape, is taken exactly. Any other is repaired for contact, and its inside, which
//! mass needs, follows from its winding number, with a stated uncertainty.

mod duplicates;
mod inside;
mod manifold;
mod options;
mod self_intersection;
mod slivers;
mod tolerant;
mod wall;
mod winding;

use glam::DVec3;

pub use options::{PrepareOptions, Repair};

use super::mesh::{MeshEdges, TriangleMesh};
use super::mesh_file::REEXPORT;
use super::solid::Solid;
use super::weld::{join, root, weld};
use gripcast_base::error::{Error, Result};

/// A mesh fit for simulation.
#[derive(Clone, Debug, PartialEq)]
pub struct PreparedMesh {
    /// Counter-clockwise seen from outside; cavities face inwards. With [`Repair::Strict`], and
    /// whenever the mesh allows it, two triangles meet at each edge. Vertices may coincide where the
    /// surface touches itself.
    pub mesh: TriangleMesh,
    /// Its inside; `None` if it has none and none is needed.
    pub solid: Option<Solid>,
    /// Repairs and defects, one sentence each, for the user.
    pub warnings: Vec<String>,
}

/// Checks a mesh (m) in two stages and repairs defects as [`PrepareOptions::repair`] says.
///
/// What contact needs: finite coordinates, a plausible size, triangles with an area, a consistent
/// outer side. Coincident vertices are welded, degenerate and duplicate triangles dropped, slivers
/// removed by edge flips, non-manifold edges and vertices split where it is clear how, strays
/// dropped, and all triangles oriented outwards. What mass needs: an inside ([`Solid`]).
///
/// # Errors
/// `Input`, with position and remedy, for a mesh that is invalid, of implausible size or without an
/// inside; with [`Repair::Strict`] also for one that is open, non-orientable or self-intersecting.
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
    let surface = match options.repair {
        Repair::Strict => strict(mesh, options, &mut warnings)?,
        Repair::Auto => {
            let exact = strict(mesh, options, &mut warnings);
            let mut surface = exact.or_else(|_| {
                warnings.clear();
                tolerant::repair(mesh, options, &mut warnings)
            })?;
            tolerant::drop_strays(&mut surface, &mut warnings);
            surface
        }
        Repair::None => {
            slivers::require_area(mesh)?;
            mesh.clone()
        }
    };
    let mesh = match options.wall_thickness_m {
        Some(thickness_m) => wall::thickened(&surface, thickness_m, &mut warnings)?,
        None => surface,
    };
    let solid = inside::check(&mesh, options, &mut warnings)?;
    Ok(PreparedMesh {
        mesh,
        solid,
        warnings,
    })
}

/// The mesh as a closed manifold without self-intersections.
fn strict(
    mesh: &TriangleMesh,
    options: &PrepareOptions,
    warnings: &mut Vec<String>,
) -> Result<TriangleMesh> {
    let mut mesh = weld(mesh, options.weld_tolerance_m);
    duplicates::drop_degenerate(&mut mesh, warnings);
    duplicates::drop_duplicates(&mut mesh, warnings);
    require_closed(&mesh)?;
    let mut mesh = manifold::split(&mesh, warnings)?;
    winding::orient_outwards(&mut mesh, warnings)?;
    slivers::remove(&mut mesh, options.weld_tolerance_m, warnings)?;
    check_self_intersection(&mesh, options, warnings)?;
    Ok(mesh)
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

/// Rejects a mesh of which no triangle is left.
fn require_triangles(mesh: &TriangleMesh) -> Result<()> {
    if !mesh.triangles.is_empty() {
        return Ok(());
    }
    Err(
        Error::input("the mesh has only degenerate and duplicate triangles")
            .remedy("export the mesh again as a solid body"),
    )
}

/// Rejects a mesh with boundary edges.
fn require_closed(mesh: &TriangleMesh) -> Result<()> {
    let edges = mesh.edges();
    let boundary: Vec<usize> = (0..edges.len())
        .filter(|&edge| edges.triangles(edge).len() == 1)
        .collect();
    require_triangles(mesh)?;
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
    Err(Error::input(format!(
        "the surface intersects itself: {} pair(s) of triangles, one near {}",
        found.pairs,
        position_mm(position)
    ))
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

#[cfg(test)]
#[path = "repair_test.rs"]
mod repair_tests;
