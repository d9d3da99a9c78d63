//! Convex decomposition of an object.

use std::panic::AssertUnwindSafe;

use glam::DVec3;
use rapier3d_f64::geometry::SharedShape;
use rapier3d_f64::parry::transformation::vhacd::{VHACD, VHACDParameters};
use rapier3d_f64::parry::transformation::voxelization::FillMode;

use super::settings::DecompositionSettings;
use super::{convert, merge};
use gripcast_base::catch_panic::catch_panic;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{MassProperties, Pose, TriangleMesh, convex_hull};

/// Grid that coordinates are rounded to, m: voxels must not depend on where the file's origin is.
const GRID_M: f64 = 1e-9;
/// Voxel resolutions tried, each one finer than the last: the hull of voxels in [`VHACD`] panics on
/// some lattices.
const MAX_ATTEMPTS: u32 = 8;

/// An object as convex pieces, in the frame of its mesh.
pub struct Decomposition {
    pieces: Vec<TriangleMesh>,
    shapes: Vec<SharedShape>,
}

impl std::fmt::Debug for Decomposition {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Decomposition of {} pieces", self.pieces.len())
    }
}

impl Decomposition {
    /// Decomposes a closed mesh (m) into convex pieces: V-HACD on voxels, a simplified hull of the
    /// mesh in each piece, and merging of pieces that are convex together. Deterministic.
    ///
    /// # Errors
    /// `Input` if the mesh is invalid or encloses no volume.
    pub fn compute(mesh: &TriangleMesh, settings: &DecompositionSettings) -> Result<Self> {
        mesh.validate()?;
        let center = mesh.bounds().center();
        let centred = on_grid(mesh, center);
        let whole = convex_hull(&centred.vertices)?;
        let hull_m3 = MassProperties::from_mesh(&whole)?.volume_m3;
        let max_excess_m3 = settings.concavity * hull_m3;
        let mut pieces = Vec::new();
        // The voxels of a convex object are less convex than the object.
        if hull_m3 - MassProperties::from_mesh(mesh)?.volume_m3 > max_excess_m3 {
            let simplified = |points: &[DVec3]| simplified_hull(points, settings);
            let parts = points_of_parts(&centred, settings)?;
            pieces = parts.iter().filter_map(|part| simplified(part)).collect();
            pieces = merge::merged(pieces, max_excess_m3);
            let merged = pieces.iter();
            pieces = merged
                .filter_map(|piece| simplified(&piece.vertices))
                .collect();
        }
        if pieces.is_empty() {
            pieces.extend(simplified_hull(&whole.vertices, settings));
        }
        let back = Pose::from_translation(center);
        Self::from_pieces(
            pieces
                .iter()
                .map(|piece| piece.transformed(&back))
                .collect(),
        )
    }

    /// From convex pieces.
    ///
    /// # Errors
    /// `Input` if there are no pieces, or one has no volume.
    pub(super) fn from_pieces(pieces: Vec<TriangleMesh>) -> Result<Self> {
        let invalid = |what: &str| {
            Error::input(what.to_owned()).remedy("use a closed mesh with some thickness")
        };
        if pieces.is_empty() {
            return Err(invalid("the mesh has no convex pieces"));
        }
        let mut shapes = Vec::with_capacity(pieces.len());
        for piece in &pieces {
            piece.validate()?;
            let corners: Vec<_> = piece.vertices.iter().map(|v| convert::vector(*v)).collect();
            let shape = SharedShape::convex_mesh(corners, &piece.triangles)
                .ok_or_else(|| invalid("a convex piece of the mesh has no volume"))?;
            shapes.push(shape);
        }
        Ok(Self { pieces, shapes })
    }

    /// The pieces: closed convex meshes (m), which may overlap at the cuts.
    pub fn pieces(&self) -> &[TriangleMesh] {
        &self.pieces
    }

    pub(super) fn shapes(&self) -> &[SharedShape] {
        &self.shapes
    }
}

/// The mesh relative to `center`, with rounded coordinates.
fn on_grid(mesh: &TriangleMesh, center: DVec3) -> TriangleMesh {
    let vertices = mesh.vertices.iter();
    TriangleMesh {
        vertices: vertices
            .map(|v| ((*v - center) / GRID_M).round() * GRID_M)
            .collect(),
        triangles: mesh.triangles.clone(),
    }
}

/// Points of the mesh in each nearly convex part that V-HACD finds.
fn points_of_parts(
    mesh: &TriangleMesh,
    settings: &DecompositionSettings,
) -> Result<Vec<Vec<DVec3>>> {
    let points: Vec<_> = mesh.vertices.iter().map(|v| convert::vector(*v)).collect();
    let decompose = |resolution: u32| {
        let parameters = VHACDParameters {
            concavity: settings.concavity,
            alpha: settings.alpha,
            beta: settings.beta,
            resolution,
            max_convex_hulls: settings.max_pieces,
            fill_mode: FillMode::FloodFill {
                detect_cavities: false,
            },
            ..VHACDParameters::default()
        };
        let found = VHACD::decompose(&parameters, &points, &mesh.triangles, true);
        let parts = found.voxel_parts().iter();
        parts
            .map(|part| part.compute_primitive_intersections(&points, &mesh.triangles))
            .map(|inside| inside.into_iter().map(convert::from_vector).collect())
            .collect()
    };
    let resolutions = settings.resolution..settings.resolution + MAX_ATTEMPTS;
    let mut attempts =
        resolutions.map(|resolution| catch_panic(AssertUnwindSafe(|| decompose(resolution))));
    attempts.find_map(Result::ok).ok_or_else(|| {
        Error::input("V-HACD cannot divide the mesh into convex pieces")
            .remedy("simplify the mesh, or use the finite-element engine")
    })
}

/// Convex hull of greedily chosen points, each the farthest outside the hull so far; `None` for
/// coplanar points.
fn simplified_hull(points: &[DVec3], settings: &DecompositionSettings) -> Option<TriangleMesh> {
    let whole = convex_hull(points).ok()?;
    let max_corners = settings.max_corners as usize;
    // Ties must not depend on the order of the mesh.
    let mut candidates = whole.without_unused_vertices().vertices;
    candidates.sort_by(|a, b| {
        let by_axis = |axis: usize| a[axis].total_cmp(&b[axis]);
        by_axis(2).then(by_axis(1)).then(by_axis(0))
    });
    let candidates = &candidates;
    let mut chosen = first_corners(candidates);
    loop {
        let corners: Vec<DVec3> = chosen.iter().map(|&i| candidates[i]).collect();
        let hull = convex_hull(&corners).ok()?;
        if chosen.len() >= max_corners {
            return Some(hull.without_unused_vertices());
        }
        match farthest(&hull, candidates) {
            Some((index, distance)) if distance > settings.corner_tolerance_m => {
                chosen.push(index);
            }
            _ => return Some(hull.without_unused_vertices()),
        }
    }
}

/// Four corners that span a volume: two distant ones, the one farthest from their line and the one
/// farthest from the plane of the three.
fn first_corners(points: &[DVec3]) -> Vec<usize> {
    let best = |score: &dyn Fn(DVec3) -> f64| {
        let all = points.iter().map(|p| score(*p)).enumerate();
        // The first of ties.
        all.fold((0, f64::NEG_INFINITY), |best, next| {
            if next.1 > best.1 { next } else { best }
        })
        .0
    };
    let a = best(&|p| -p.x);
    let b = best(&|p| p.distance_squared(points[a]));
    let line = points[b] - points[a];
    let c = best(&|p| (p - points[a]).cross(line).length_squared());
    let normal = (points[c] - points[a]).cross(line);
    let d = best(&|p| (p - points[a]).dot(normal).abs());
    vec![a, b, c, d]
}

/// The point farthest outside a hull: its index and its distance from the farthest face plane, m.
fn farthest(hull: &TriangleMesh, points: &[DVec3]) -> Option<(usize, f64)> {
    let planes: Vec<(DVec3, f64)> = hull
        .all_corners()
        .filter_map(|[a, b, c]| {
            let normal = (b - a).cross(c - a).try_normalize()?;
            Some((normal, normal.dot(a)))
        })
        .collect();
    let outside = |p: &DVec3| {
        let distances = planes
            .iter()
            .map(|(normal, offset)| normal.dot(*p) - offset);
        distances.fold(f64::NEG_INFINITY, f64::max)
    };
    let distances = points.iter().map(outside).enumerate();
    distances.fold(None, |best: Option<(usize, f64)>, next| match best {
        Some(best) if best.1 >= next.1 => Some(best),
        _ => Some(next),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::builtin;

    fn coarse() -> DecompositionSettings {
        DecompositionSettings {
            resolution: 32,
            ..DecompositionSettings::default()
        }
    }

    /// Distance of a point outside the union of the pieces, m.
    fn outside(pieces: &Decomposition, point: DVec3) -> f64 {
        let distance = |piece: &TriangleMesh| farthest(piece, &[point]).unwrap().1;
        pieces
            .pieces()
            .iter()
            .map(distance)
            .fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn box_is_one_piece_with_eight_corners() {
        let found = Decomposition::compute(&builtin("box").unwrap(), &coarse()).unwrap();
        assert_eq!(found.pieces().len(), 1);
        assert_eq!(found.pieces()[0].vertices.len(), 8);
        let volume = MassProperties::from_mesh(&found.pieces()[0])
            .unwrap()
            .volume_m3;
        assert!((volume - 0.04 * 0.04 * 0.06).abs() < 1e-12);
    }

    #[test]
    fn pieces_of_a_mug_cover_it_and_keep_it_hollow() {
        let mug = builtin("mug").unwrap();
        let found = Decomposition::compute(&mug, &coarse()).unwrap();
        let count = found.pieces().len();
        assert!((6..=32).contains(&count), "{count} pieces");
        let worst = mug
            .vertices
            .iter()
            .map(|v| outside(&found, *v))
            .fold(0.0, f64::max);
        assert!(worst < 1e-3, "the mug protrudes by {worst} m");
        let inside = outside(&found, DVec3::new(0.0, 0.0, 0.02));
        assert!(inside > 5e-3, "the mug is filled: {inside}");
        let volume: f64 = found
            .pieces()
            .iter()
            .map(|piece| MassProperties::from_mesh(piece).unwrap().volume_m3)
            .sum();
        let exact = MassProperties::from_mesh(&mug).unwrap().volume_m3;
        assert!(volume < 1.8 * exact, "{volume} of {exact}");
    }

    #[test]
    fn round_pieces_have_few_corners_and_keep_their_size() {
        let ball = builtin("ball").unwrap();
        let found = Decomposition::compute(&ball, &coarse()).unwrap();
        assert_eq!(found.pieces().len(), 1);
        assert_eq!(found.pieces()[0].vertices.len(), 64);
        let worst = ball
            .vertices
            .iter()
            .map(|v| outside(&found, *v))
            .fold(0.0, f64::max);
        assert!(worst < 1.6e-3, "{worst}");
    }

    #[test]
    fn flat_and_invalid_meshes_are_rejected() {
        let mut flat = builtin("box").unwrap();
        for v in &mut flat.vertices {
            v.z = 0.0;
        }
        let error = Decomposition::compute(&flat, &coarse()).unwrap_err();
        assert!(error.to_string().contains("thickness"), "{error}");
        assert!(Decomposition::compute(&TriangleMesh::default(), &coarse()).is_err());
        flat.vertices[0].x = f64::NAN;
        assert!(Decomposition::compute(&flat, &coarse()).is_err());
    }
}
