//! Makes a mesh fit for simulation, or says why it is not.
//!
//! A simulated object must be closed, face outwards and not pass through itself. What can be
//! repaired without changing the shape is repaired with a warning; the rest is refused with its place.

mod duplicates;
mod manifold;
mod self_intersection;
mod slivers;
mod winding;

use glam::DVec3;

use super::mesh::{MeshEdges, TriangleMesh};
use super::weld::{root, weld};
use gripcast_base::error::{Error, Result};

/// What [`prepare`] accepts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrepareOptions {
    /// Vertices up to this far apart become one, m. Default 0.1 µm: below what any scan or print
    /// resolves, above the rounding of coordinates in single precision.
    pub weld_tolerance_m: f64,
    /// Longest side of the bounding box that is accepted, m. Default 1 m.
    pub max_extent_m: f64,
    /// Longest side of the bounding box below which a mesh is refused, m. Default 2 mm.
    pub min_extent_m: f64,
    /// Depth up to which the surface may pass through itself, m. Default 1 µm: slivers of
    /// exported meshes do so, and nothing is felt of it.
    pub crossing_tolerance_m: f64,
    /// Whether a surface that passes through itself is only warned about. Default false.
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

/// A mesh that can be simulated.
#[derive(Clone, Debug, PartialEq)]
pub struct Prepared {
    /// Closed, each edge with two triangles, counter-clockwise seen from outside; cavities face
    /// inwards. Several vertices may lie in one place where the surface touches itself.
    pub mesh: TriangleMesh,
    /// What was repaired, one sentence each, for the user to read.
    pub warnings: Vec<String>,
}

/// Checks a mesh (m) and repairs what can be repaired without changing its shape:
/// vertices in one place are welded; degenerate and duplicate triangles are dropped; flat ones
/// are flipped away; edges with four or more triangles and vertices where the surface touches
/// itself are split; the winding is made to face outwards.
///
/// Several components are accepted if each is closed; one inside another is a cavity.
///
/// # Errors
/// `Input`, with place and remedy, for a mesh that is broken, of unlikely size, open,
/// non-orientable, without volume, or that passes through itself.
///
/// ```
/// use gripcast_geometry::{PrepareOptions, builtin, prepare};
/// let prepared = prepare(&builtin("mug")?, &PrepareOptions::default())?;
/// assert!(prepared.warnings.is_empty());
/// # Ok::<(), gripcast_base::error::Error>(())
/// ```
pub fn prepare(mesh: &TriangleMesh, options: &PrepareOptions) -> Result<Prepared> {
    mesh.validate()
        .map_err(|e| e.remedy("check that the file was copied whole, or export the mesh again"))?;
    check_size(mesh, options)?;
    let mut warnings = Vec::new();
    let mut mesh = weld(mesh, options.weld_tolerance_m);
    duplicates::drop_degenerate(&mut mesh, &mut warnings);
    duplicates::drop_duplicates(&mut mesh, &mut warnings);
    refuse_open(&mesh)?;
    let mut mesh = manifold::split(&mesh, &mut warnings)?;
    winding::face_outwards(&mut mesh, &mut warnings)?;
    slivers::flip_away(&mut mesh, options.weld_tolerance_m, &mut warnings)?;
    refuse_self_intersection(&mesh, options, &mut warnings)?;
    Ok(Prepared { mesh, warnings })
}

/// Refuses sizes that no gripper meets; they are mostly a matter of units.
fn check_size(mesh: &TriangleMesh, options: &PrepareOptions) -> Result<()> {
    let extent = mesh.bounds().extent().max_element();
    let refuse = |what: &str, limit: f64, remedy: String| {
        let what = format!(
            "the mesh is {} mm long, {what} than the {} mm that are accepted",
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

/// Refuses a mesh with edges that only one triangle has.
fn refuse_open(mesh: &TriangleMesh) -> Result<()> {
    let edges = mesh.edges();
    let border: Vec<usize> = (0..edges.len())
        .filter(|&edge| edges.triangles(edge).len() == 1)
        .collect();
    if mesh.triangles.is_empty() {
        return Err(
            Error::input("the mesh has no triangles but degenerate and duplicate ones")
                .remedy("export the mesh again as a solid body"),
        );
    }
    if border.is_empty() {
        return Ok(());
    }
    let holes = holes(&edges, &border, mesh.vertices.len());
    let largest = holes.iter().max_by_key(|hole| hole.len());
    let ends = largest
        .iter()
        .flat_map(|hole| hole.iter())
        .flat_map(|&e| edges.vertices[e]);
    let bounds = super::aabb::Aabb::from_points(ends.map(|v| mesh.vertices[v as usize]));
    Err(Error::input(format!(
        "the mesh must be closed, found {} boundary edges in {} hole(s); the largest is {} mm \
             wide around {}",
        border.len(),
        holes.len(),
        millimetres(bounds.extent().max_element()),
        place_mm(bounds.center()),
    ))
    .remedy("close the holes in a mesh editor (\"make manifold\", \"fill holes\")"))
}

/// Boundary edges grouped by the vertices that they share.
fn holes(edges: &MeshEdges, border: &[usize], vertex_count: usize) -> Vec<Vec<usize>> {
    let mut parent: Vec<u32> = (0..vertex_count as u32).collect();
    for &edge in border {
        let [a, b] = edges.vertices[edge].map(|v| root(&mut parent, v));
        parent[a.max(b) as usize] = a.min(b);
    }
    let mut grouped: Vec<(u32, usize)> = border
        .iter()
        .map(|&edge| (root(&mut parent, edges.vertices[edge][0]), edge))
        .collect();
    grouped.sort_unstable();
    grouped
        .chunk_by(|a, b| a.0 == b.0)
        .map(|hole| hole.iter().map(|&(_, edge)| edge).collect())
        .collect()
}

fn refuse_self_intersection(
    mesh: &TriangleMesh,
    options: &PrepareOptions,
    warnings: &mut Vec<String>,
) -> Result<()> {
    let found = self_intersection::find(mesh, options.crossing_tolerance_m);
    if found.shallow > 0 {
        warnings.push(format!(
            "tolerated {} pair(s) of triangles that cross by less than {} mm",
            found.shallow,
            options.crossing_tolerance_m * 1e3
        ));
    }
    let Some(place) = found.first_place else {
        return Ok(());
    };
    let what = format!(
        "the surface passes through itself: {} pair(s) of triangles, one near {}",
        found.pairs,
        place_mm(place)
    );
    if options.allow_self_intersection {
        warnings.push(what);
        return Ok(());
    }
    Err(Error::input(what)
        .remedy("unite the overlapping parts in a mesh editor (boolean union, voxel remesh)"))
}

/// A length as text in millimetres.
fn millimetres(metres: f64) -> String {
    format!("{:.3}", metres * 1e3)
        .trim_end_matches('0')
        .trim_end_matches('.')
        .to_string()
}

/// A place as text in millimetres.
fn place_mm(place: DVec3) -> String {
    let [x, y, z] = place.to_array().map(|c| format!("{:.2}", c * 1e3));
    format!("({x}, {y}, {z}) mm")
}

#[cfg(test)]
#[path = "check_test.rs"]
mod tests;
