//! Triangles of a mesh that pass through one another.
//!
//! Decided by the signs of exact determinants, so that touching is told from crossing.

use glam::DVec3;

use crate::bvh::Bvh;
use crate::convex_hull::orientation;
use crate::mesh::TriangleMesh;
use crate::weld::first_in_place;

/// What [`find`] found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SelfIntersections {
    /// Number of pairs of triangles that cross by less than the tolerance.
    pub(super) shallow: usize,
    /// Number of the other pairs.
    pub(super) pairs: usize,
    /// Where the first of the other pairs meets, m.
    pub(super) first_place: Option<DVec3>,
}

/// Finds all pairs of triangles of which one passes through the other. Touching is no crossing:
/// neighbours, corners on faces, faces that lie on one another. A fold by 180° is one. A crossing
/// is shallow if no side ends more than `tolerance_m` behind the face that it passes through.
pub(super) fn find(mesh: &TriangleMesh, tolerance_m: f64) -> SelfIntersections {
    let place = first_in_place(mesh);
    let boxes = mesh.triangle_bounds();
    let bvh = Bvh::build(&boxes);
    let mut found = SelfIntersections {
        shallow: 0,
        pairs: 0,
        first_place: None,
    };
    for (first, bounds) in boxes.iter().enumerate() {
        bvh.for_each_overlap(bounds, |second| {
            if second as usize <= first {
                return;
            }
            let pair = [first, second as usize].map(|t| {
                let triangle = mesh.triangles[t];
                Placed {
                    corners: mesh.corners(triangle),
                    places: triangle.map(|v| place[v as usize]),
                }
            });
            match crossing(&pair[0], &pair[1]) {
                Some(crossing) if crossing.depth_m < tolerance_m => found.shallow += 1,
                Some(crossing) => {
                    found.pairs += 1;
                    found.first_place.get_or_insert(crossing.place);
                }
                None => {}
            }
        });
    }
    found
}

/// A triangle; corners with equal `places` lie in one place.
struct Placed {
    corners: [DVec3; 3],
    places: [u32; 3],
}

impl Placed {
    fn fractions(&self, other: &Self) -> [bool; 3] {
        self.places.map(|p| other.places.contains(&p))
    }
}

struct Crossing {
    /// A point of it, m.
    place: DVec3,
    /// How far the side that passes through ends behind the face, m.
    depth_m: f64,
}

/// The deepest crossing of two triangles.
fn crossing(a: &Placed, b: &Placed) -> Option<Crossing> {
    let (in_a, in_b) = (a.fractions(b), b.fractions(a));
    match in_a.iter().filter(|s| **s).count() {
        0 | 1 => sides_through(a, in_a, b)
            .chain(sides_through(b, in_b, a))
            .max_by(|x, y| x.depth_m.total_cmp(&y.depth_m)),
        2 => fold(a, in_a, b, in_b),
        _ => None,
    }
}

/// Where sides of `a` without shared corners pass through `b`.
fn sides_through(a: &Placed, shared: [bool; 3], b: &Placed) -> impl Iterator<Item = Crossing> {
    [(0, 1), (1, 2), (2, 0)]
        .into_iter()
        .filter(move |&(i, j)| !shared[i] && !shared[j])
        .filter_map(|(i, j)| segment_through(a.corners[i], a.corners[j], &b.corners))
}

fn segment_through(p: DVec3, q: DVec3, &[a, b, c]: &[DVec3; 3]) -> Option<Crossing> {
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
    inside.then(|| Crossing {
        place: p.lerp(q, above / (above - below)),
        depth_m: above.abs().min(below.abs()) / (b - a).cross(c - a).length(),
    })
}

/// Two triangles with a common side overlap if they lie in one plane on one side of it.
fn fold(a: &Placed, in_a: [bool; 3], b: &Placed, in_b: [bool; 3]) -> Option<Crossing> {
    let apex = |t: &Placed, shared: [bool; 3]| {
        let at = shared.iter().position(|s| !s);
        at.map(|k| t.corners[k])
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
    overlap.then(|| Crossing {
        place: (s + t + p) / 3.0,
        depth_m: f64::INFINITY,
    })
}
