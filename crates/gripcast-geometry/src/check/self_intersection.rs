//! Self-intersections of a mesh, by exact orientation predicates that distinguish touching from
//! intersecting triangles.

use glam::DVec3;

use crate::bvh::Bvh;
use crate::convex_hull::orientation;
use crate::mesh::TriangleMesh;
use crate::weld::first_coincident;

/// Result of [`find`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SelfIntersections {
    /// Pairs of triangles that intersect by less than the tolerance.
    pub(super) shallow: usize,
    /// Pairs of triangles that intersect more deeply.
    pub(super) pairs: usize,
    /// A point of the first of these, m.
    pub(super) first_position: Option<DVec3>,
}

/// Finds all pairs of intersecting triangles. Touching triangles do not intersect: neighbours,
/// corners on faces, coplanar faces. A fold by 180° does. An intersection is shallow if no side
/// ends more than `tolerance_m` behind the face that it pierces.
pub(super) fn find(mesh: &TriangleMesh, tolerance_m: f64) -> SelfIntersections {
    let first_vertex = first_coincident(mesh);
    let boxes = mesh.triangle_bounds();
    let bvh = Bvh::build(&boxes);
    let mut found = SelfIntersections {
        shallow: 0,
        pairs: 0,
        first_position: None,
    };
    for (first, bounds) in boxes.iter().enumerate() {
        bvh.for_each_overlap(bounds, |second| {
            if second as usize <= first {
                return;
            }
            let pair = [first, second as usize].map(|t| {
                let triangle = mesh.triangles[t];
                Triangle {
                    corners: mesh.corners(triangle),
                    vertices: triangle.map(|v| first_vertex[v as usize]),
                }
            });
            match intersection(&pair[0], &pair[1]) {
                Some(hit) if hit.depth_m < tolerance_m => found.shallow += 1,
                Some(hit) => {
                    found.pairs += 1;
                    found.first_position.get_or_insert(hit.position);
                }
                None => {}
            }
        });
    }
    found
}

/// A triangle; coincident corners have equal `vertices`.
struct Triangle {
    corners: [DVec3; 3],
    vertices: [u32; 3],
}

impl Triangle {
    /// Which corners are also corners of the other triangle.
    fn shared_corners(&self, other: &Self) -> [bool; 3] {
        self.vertices.map(|v| other.vertices.contains(&v))
    }
}

struct Intersection {
    /// A common point, m.
    position: DVec3,
    /// Distance by which the piercing side ends behind the face, m.
    depth_m: f64,
}

/// The deepest intersection of two triangles.
fn intersection(a: &Triangle, b: &Triangle) -> Option<Intersection> {
    let (in_a, in_b) = (a.shared_corners(b), b.shared_corners(a));
    match in_a.iter().filter(|s| **s).count() {
        0 | 1 => piercing_sides(a, in_a, b)
            .chain(piercing_sides(b, in_b, a))
            .max_by(|x, y| x.depth_m.total_cmp(&y.depth_m)),
        2 => fold(a, in_a, b, in_b),
        _ => None,
    }
}

/// Intersections of sides of `a` without shared corners with `b`.
fn piercing_sides(
    a: &Triangle,
    shared: [bool; 3],
    b: &Triangle,
) -> impl Iterator<Item = Intersection> {
    [(0, 1), (1, 2), (2, 0)]
        .into_iter()
        .filter(move |&(i, j)| !shared[i] && !shared[j])
        .filter_map(|(i, j)| piercing_segment(a.corners[i], a.corners[j], &b.corners))
}

fn piercing_segment(p: DVec3, q: DVec3, &[a, b, c]: &[DVec3; 3]) -> Option<Intersection> {
    let (above, below) = (orientation(a, b, c, p), orientation(a, b, c, q));
    let strictly = (above > 0.0 && below < 0.0) || (above < 0.0 && below > 0.0);
    if !strictly {
        return None;
    }
    let sides = [
        orientation(p, q, a, b),
        orientation(p, q, b, c),
        orientation(p, q, c, a),
    ];
    let inside = sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0);
    inside.then(|| Intersection {
        position: p.lerp(q, above / (above - below)),
        depth_m: above.abs().min(below.abs()) / (b - a).cross(c - a).length(),
    })
}

/// Intersection of two triangles with a common side: they overlap if coplanar on the same side of
/// it.
fn fold(a: &Triangle, in_a: [bool; 3], b: &Triangle, in_b: [bool; 3]) -> Option<Intersection> {
    let apex = |t: &Triangle, shared: [bool; 3]| {
        let index = shared.iter().position(|s| !s);
        index.map(|k| t.corners[k])
    };
    let (p, q) = (apex(a, in_a)?, apex(b, in_b)?);
    let mut side = (0..3).filter(|&k| in_a[k]).map(|k| a.corners[k]);
    let (s, t) = (side.next()?, side.next()?);
    let along = (t - s).normalize_or_zero();
    let (over_p, over_q) = (
        (p - s).reject_from_normalized(along),
        (q - s).reject_from_normalized(along),
    );
    let overlap = orientation(s, t, p, q) == 0.0 && over_p.dot(over_q) > 0.0;
    overlap.then(|| Intersection {
        position: (s + t + p) / 3.0,
        depth_m: f64::INFINITY,
    })
}
