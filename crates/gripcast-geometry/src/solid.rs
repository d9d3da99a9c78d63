//! The inside of a surface that need not be closed or free of overlaps.

use std::collections::BTreeMap;

use glam::DVec3;

use super::mass_properties::{MassProperties, Moments};
use super::mesh::TriangleMesh;
use super::ray_integral::{ClosedSurface, Miscount};
use super::weld::{first_coincident, join, root};
use super::winding_number::WindingNumber;
use gripcast_base::error::Result;

/// Rays a side that look for overlaps of a closed surface.
const SEARCH: usize = 64;
/// Rays a side that measure them.
const MEASURE: usize = 384;
/// Rays a side, and steps along each, for a surface with holes.
const OPEN: usize = 40;
/// Thickness of a film, as a fraction of its size, that counts as flat.
const FILM: f64 = 1e-7;
/// Area of the closed holes, as a fraction of the surface, below which they are rounding.
const CLOSED_AREA: f64 = 1e-9;

/// The solid inside a surface, and how well the surface defines it.
///
/// A point is inside if its generalised winding number is above 1/2 (Jacobson et al., *Robust
/// inside-outside segmentation using generalized winding numbers*, SIGGRAPH 2013). What several
/// bodies share counts once, a body that faces inwards within another is a cavity, and holes are
/// closed smoothly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solid {
    /// Volume, centre of mass and second moment of the inside. Exact for a closed surface without
    /// overlaps.
    pub properties: MassProperties,
    /// Volume that several bodies, or one that crosses itself, count more than once; as a fraction
    /// of the volume.
    pub overlap: f64,
    /// Uncertainty of the volume as a fraction of it: the part whose winding number is neither near
    /// 0 nor near 1, and the error of the integration. 0 for a closed surface without overlaps.
    pub uncertainty: f64,
    /// Area of the holes, closed as fans, as a fraction of the surface.
    pub hole_area: f64,
}

impl Solid {
    /// Finds the inside of a surface (m) whose triangles run counter-clockwise seen from outside.
    ///
    /// The surface is closed by fans over its holes; its surface integrals count each point as often
    /// as the winding number says, and rays along the three axes measure where that is not 0 or 1.
    ///
    /// # Errors
    /// `Input` if the inside has no volume: the surface is flat or inverted.
    pub fn of(mesh: &TriangleMesh) -> Result<Self> {
        let bounds = mesh.bounds();
        let reference = bounds.center();
        let mut triangles: Vec<[DVec3; 3]> = mesh.all_corners().collect();
        let fans = closing_fans(mesh);
        let hole_area = area(&fans) / area(&triangles).max(f64::MIN_POSITIVE);
        let is_open = hole_area > CLOSED_AREA;
        let closing = is_open.then(|| WindingNumber::new(&fans));
        triangles.extend(fans);
        let surface = ClosedSurface {
            triangles: &triangles,
            closing: closing.as_ref(),
            center: reference,
            extent: bounds.extent(),
        };
        let measure = |resolution| [0, 1, 2].map(|axis| surface.miscount(axis, resolution));
        let mut miscounts = measure(if is_open { OPEN } else { SEARCH });
        let is_exact = |m: &Miscount| m.excess == Moments::ZERO && m.unclear_m3 == 0.0;
        let is_clean = miscounts.iter().all(is_exact);
        if !is_open && !is_clean {
            miscounts = measure(MEASURE);
        }
        let mut moments = Moments::of_surface(triangles.iter().copied(), reference);
        for miscount in miscounts.iter().filter(|_| !is_clean) {
            moments.add(&miscount.excess, -1.0 / 3.0);
        }
        // What rounding leaves of a flat surface is not a volume.
        if moments.volume <= FILM * area(&triangles) * bounds.diagonal() {
            moments.volume = moments.volume.min(0.0);
        }
        let properties = moments.properties(reference)?;
        let share = |of: fn(&Miscount) -> f64| {
            miscounts.iter().map(of).sum::<f64>() / 3.0 / properties.volume_m3
        };
        let volumes = miscounts.map(|m| m.excess.volume);
        let spread = volumes.iter().copied().fold(f64::NEG_INFINITY, f64::max)
            - volumes.iter().copied().fold(f64::INFINITY, f64::min);
        Ok(Self {
            properties,
            overlap: share(|m| m.repeated_m3),
            uncertainty: share(|m| m.unclear_m3) + spread / properties.volume_m3,
            hole_area,
        })
    }
}

/// Area of the holes as a fraction of the surface, as in [`Solid::hole_area`].
pub(super) fn hole_area(mesh: &TriangleMesh) -> f64 {
    area(&closing_fans(mesh)) / mesh.area().max(f64::MIN_POSITIVE)
}

fn area(triangles: &[[DVec3; 3]]) -> f64 {
    let twice = triangles.iter().map(|[a, b, c]| (*b - *a).cross(*c - *a));
    // The sum of nothing is −0.
    0.5 * twice.map(|normal| normal.length()).sum::<f64>() + 0.0
}

/// Triangles that close the surface: each group of connected boundary edges becomes a fan around its
/// mean position. The sides of a crack cancel.
fn closing_fans(mesh: &TriangleMesh) -> Vec<[DVec3; 3]> {
    let boundary = boundary(mesh);
    let mut parent: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    for &([a, b], _) in &boundary {
        join(&mut parent, a, b);
    }
    // Sums of the positions and lengths of each group.
    let mut groups: BTreeMap<u32, (DVec3, f64)> = BTreeMap::new();
    let ends = |edge: [u32; 2]| edge.map(|v| mesh.vertices[v as usize]);
    for &(edge, _) in &boundary {
        let [a, b] = ends(edge);
        let length = a.distance(b);
        let group = groups.entry(root(&mut parent, edge[0])).or_default();
        group.0 += a.midpoint(b) * length;
        group.1 += length;
    }
    let mut fans = Vec::with_capacity(boundary.len());
    for (edge, count) in boundary {
        let [a, b] = ends(edge);
        let group = groups.get(&root(&mut parent, edge[0]));
        let center = group.map_or(a, |(sum, length)| *sum / length.max(f64::MIN_POSITIVE));
        let triangle = if count > 0 {
            [b, a, center]
        } else {
            [a, b, center]
        };
        fans.extend(std::iter::repeat_n(triangle, count.unsigned_abs() as usize));
    }
    fans
}

/// Edges that triangles run along more often in one direction than in the other, smaller vertex
/// first, and how much more often in that direction. Coincident vertices count as one.
fn boundary(mesh: &TriangleMesh) -> Vec<([u32; 2], i32)> {
    let first = first_coincident(mesh);
    let mut sides: Vec<([u32; 2], i32)> = Vec::with_capacity(3 * mesh.triangles.len());
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| first[v as usize]);
        for (p, q) in [(a, b), (b, c), (c, a)] {
            sides.push(([p.min(q), p.max(q)], if p < q { 1 } else { -1 }));
        }
    }
    sides.sort_unstable();
    sides
        .chunk_by(|a, b| a.0 == b.0)
        .map(|edge| (edge[0].0, edge.iter().map(|side| side.1).sum()))
        .filter(|([a, b], count)| a != b && *count != 0)
        .collect()
}
