//! Contact points of flat bodies (ground, finger faces) with convex pieces.
//!
//! parry uses the first four corners of a face, which do not surround the centre of a face with
//! many corners: a cylinder tips over on the ground. Here contacts are found over the whole contact
//! patch, and the four that span it are kept.

use rapier3d_f64::geometry::{ContactData, ContactManifold, ContactManifoldData};
use rapier3d_f64::math::{Pose, Vector};
use rapier3d_f64::parry::query::details::ShapeCastOptions;
use rapier3d_f64::parry::query::{
    ClosestPoints, Contact, ContactManifoldsWorkspace, DefaultQueryDispatcher,
    NonlinearRigidMotion, PersistentQueryDispatcher, QueryDispatcher, ShapeCastHit, ShapeDistance,
    ShapeIntersection, TrackedContact, Unsupported, details::NormalConstraints,
};
use rapier3d_f64::parry::shape::{ConvexPolyhedron, Cuboid, HalfSpace, PackedFeatureId, Shape};

/// Cosine of the largest angle (2.5°) between a contact direction and the normal of a finger face.
const MIN_FACE_COSINE: f64 = 0.999;
/// Penalty of a point's distance in the choice of spanning points: each metre counts as this many
/// metres inwards.
const DISTANCE_PENALTY: f64 = 30.0;
/// Direction of the first two extreme points, oblique to avoid ties of corners.
const OBLIQUE: [f64; 2] = [0.94, 0.34];

/// Contacts of flat bodies as described above; all other queries are unsupported.
pub(super) struct FlatContacts;

type Outcome<T> = Result<T, Unsupported>;

/// A flat body's plane in its own frame.
struct Plate {
    normal: Vector,
    /// Unit vectors in the plane.
    axes: [Vector; 2],
    /// Distance of the plane from the origin along the normal, m.
    offset: f64,
    /// Half size of the plate along both axes, m; `None` for the ground.
    half: Option<[f64; 2]>,
}

/// A possible contact.
#[derive(Clone, Copy)]
struct Candidate {
    /// Coordinates along the plate's axes, m.
    uv: [f64; 2],
    /// From the plate to the piece, m.
    distance: f64,
}

impl Plate {
    fn ground(ground: &HalfSpace) -> Self {
        let normal = ground.normal;
        // Any direction that is not along the normal.
        let other = if normal.x.abs() < 0.6 {
            Vector::X
        } else {
            Vector::Y
        };
        let first = normal.cross(other).normalize();
        Self {
            normal,
            axes: [first, normal.cross(first)],
            offset: 0.0,
            half: None,
        }
    }

    /// The face of a finger towards a direction, if that is along x.
    fn finger(finger: &Cuboid, direction: Vector) -> Option<Self> {
        let half = finger.half_extents;
        (direction.x.abs() >= MIN_FACE_COSINE).then(|| Self {
            normal: Vector::X * direction.x.signum(),
            axes: [Vector::Y, Vector::Z],
            offset: half.x,
            half: Some([half.y, half.z]),
        })
    }

    fn candidate(&self, point: Vector) -> Candidate {
        Candidate {
            uv: self.axes.map(|axis| axis.dot(point)),
            distance: self.normal.dot(point) - self.offset,
        }
    }

    /// Projection of a candidate onto the plate, m.
    fn on_plate(&self, candidate: &Candidate) -> Vector {
        let [u, v] = candidate.uv;
        self.axes[0] * u + self.axes[1] * v + self.normal * self.offset
    }

    /// Corners of the contact patch with a piece, within `prediction`, in the plate's frame.
    fn candidates(&self, piece: &ConvexPolyhedron, pose: &Pose, prediction: f64) -> Vec<Candidate> {
        let corners: Vec<Candidate> = piece
            .points()
            .iter()
            .map(|p| self.candidate(pose.transform_point(*p)))
            .collect();
        let mut found = match self.half {
            None => corners,
            Some(half) => {
                let edge = |e: [u32; 2]| clipped(e.map(|i| corners[i as usize]), half);
                let edges = piece.edges().iter().filter_map(|e| edge(e.vertices));
                let mut found: Vec<Candidate> = edges.flatten().collect();
                let signs = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
                let at = |s: [f64; 2]| [s[0] * half[0], s[1] * half[1]];
                found.extend(
                    signs
                        .into_iter()
                        .filter_map(|s| self.above(at(s), piece, pose)),
                );
                found
            }
        };
        found.retain(|c| c.distance <= prediction);
        found
    }

    /// The surface of the piece above a point of the plate.
    fn above(&self, uv: [f64; 2], piece: &ConvexPolyhedron, pose: &Pose) -> Option<Candidate> {
        let start = self.on_plate(&Candidate { uv, distance: 0.0 });
        let start = pose.inverse_transform_point(start);
        let along = pose.inverse_transform_vector(self.normal);
        let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
        for face in piece.faces() {
            let corner = piece.vertices_adj_to_face()[face.first_vertex_or_edge as usize];
            let outside = face.normal.dot(start - piece.points()[corner as usize]);
            let speed = face.normal.dot(along);
            if speed < 0.0 {
                enter = enter.max(-outside / speed);
            } else if speed > 0.0 {
                leave = leave.min(-outside / speed);
            } else if outside > 0.0 {
                return None;
            }
        }
        (enter.is_finite() && enter <= leave).then_some(Candidate {
            uv,
            distance: enter,
        })
    }
}

/// Clips an edge to the area of a plate.
fn clipped([a, b]: [Candidate; 2], half: [f64; 2]) -> Option<[Candidate; 2]> {
    let (mut from, mut to) = (0.0_f64, 1.0_f64);
    for ((start, end), half) in a.uv.into_iter().zip(b.uv).zip(half) {
        let change = end - start;
        for (room, speed) in [(half - start, change), (half + start, -change)] {
            if speed > 0.0 {
                to = to.min(room / speed);
            } else if speed < 0.0 {
                from = from.max(room / speed);
            } else if room < 0.0 {
                return None;
            }
        }
    }
    let point = |t: f64| Candidate {
        uv: [0, 1].map(|i| a.uv[i] + t * (b.uv[i] - a.uv[i])),
        distance: a.distance + t * (b.distance - a.distance),
    };
    (from <= to).then(|| [point(from), point(to)])
}

/// At most four candidates that span the contact patch, preferring near ones, with their slots.
fn spanning(all: &[Candidate]) -> Vec<(usize, Candidate)> {
    let along = |c: &Candidate, d: [f64; 2]| c.uv[0] * d[0] + c.uv[1] * d[1];
    let extreme = |d: [f64; 2]| {
        let score = |c: &Candidate| along(c, d) - DISTANCE_PENALTY * c.distance;
        // The first of ties.
        let best = all
            .iter()
            .reduce(|a, b| if score(b) > score(a) { b } else { a });
        best.copied()
    };
    let opposite = OBLIQUE.map(|x| -x);
    let (Some(a), Some(b)) = (extreme(OBLIQUE), extreme(opposite)) else {
        return Vec::new();
    };
    let line = [a.uv[0] - b.uv[0], a.uv[1] - b.uv[1]];
    let length = line[0].hypot(line[1]);
    let side = if length > 0.0 {
        [-line[1] / length, line[0] / length]
    } else {
        [-OBLIQUE[1], OBLIQUE[0]]
    };
    let others = [extreme(side), extreme(side.map(|x| -x))];
    let mut found: Vec<(usize, Candidate)> = Vec::with_capacity(4);
    let chosen = [Some(a), Some(b)].into_iter().chain(others).enumerate();
    for (slot, candidate) in chosen {
        let Some(candidate) = candidate else { continue };
        if !found.iter().any(|(_, other)| other.uv == candidate.uv) {
            found.push((slot, candidate));
        }
    }
    found
}

type Manifold = ContactManifold;

/// Writes the contacts of a plate (first body, or second if `flipped`) and a piece into a manifold.
fn write_contacts(
    manifold: &mut Manifold,
    plate: &Plate,
    piece: &ConvexPolyhedron,
    pose: &Pose,
    prediction: f64,
    flipped: bool,
) {
    let old = std::mem::take(&mut manifold.points);
    let candidates = plate.candidates(piece, pose, prediction);
    for (slot, candidate) in spanning(&candidates) {
        let on_plate = plate.on_plate(&candidate);
        let on_piece = pose.inverse_transform_point(on_plate + plate.normal * candidate.distance);
        let slot = slot as u32;
        manifold.points.push(TrackedContact::flipped(
            on_plate,
            on_piece,
            PackedFeatureId::face(0),
            PackedFeatureId::vertex(slot),
            candidate.distance,
            flipped,
        ));
    }
    let back = -pose.inverse_transform_vector(plate.normal);
    (manifold.local_n1, manifold.local_n2) = if flipped {
        (back, plate.normal)
    } else {
        (plate.normal, back)
    };
    manifold.match_contacts(&old);
}

/// The plate of a flat body that faces a piece at `pose` within `prediction`.
fn plate(body: &dyn Shape, piece: &dyn Shape, pose: &Pose, prediction: f64) -> Option<Plate> {
    if let Some(ground) = body.as_shape::<HalfSpace>() {
        return Some(Plate::ground(ground));
    }
    let finger = body.as_cuboid()?;
    let contact = DefaultQueryDispatcher.contact(pose, body, piece, prediction);
    Plate::finger(finger, contact.ok()??.normal1)
}

impl PersistentQueryDispatcher<ContactManifoldData, ContactData> for FlatContacts {
    fn contact_manifolds(
        &self,
        pos12: &Pose,
        g1: &dyn Shape,
        g2: &dyn Shape,
        prediction: f64,
        manifolds: &mut Vec<Manifold>,
        _: &mut Option<ContactManifoldsWorkspace>,
    ) -> Outcome<()> {
        let pos21 = pos12.inverse();
        for (flipped, body, other, pose) in [(false, g1, g2, pos12), (true, g2, g1, &pos21)] {
            let Some(piece) = other.as_convex_polyhedron() else {
                continue;
            };
            if let Some(plate) = plate(body, other, pose, prediction) {
                if manifolds.len() != 1 {
                    manifolds.clear();
                    manifolds.push(Manifold::new());
                }
                write_contacts(&mut manifolds[0], &plate, piece, pose, prediction, flipped);
                return Ok(());
            }
        }
        Err(Unsupported)
    }

    fn contact_manifold_convex_convex(
        &self,
        _: &Pose,
        _: &dyn Shape,
        _: &dyn Shape,
        _: Option<&dyn NormalConstraints>,
        _: Option<&dyn NormalConstraints>,
        _: f64,
        _: &mut Manifold,
    ) -> Outcome<()> {
        Err(Unsupported)
    }
}

impl QueryDispatcher for FlatContacts {
    fn intersection_test(
        &self,
        _: &Pose,
        _: &dyn Shape,
        _: &dyn Shape,
    ) -> Outcome<ShapeIntersection> {
        Err(Unsupported)
    }

    fn distance(&self, _: &Pose, _: &dyn Shape, _: &dyn Shape) -> Outcome<ShapeDistance> {
        Err(Unsupported)
    }

    fn contact(&self, _: &Pose, _: &dyn Shape, _: &dyn Shape, _: f64) -> Outcome<Option<Contact>> {
        Err(Unsupported)
    }

    fn closest_points(
        &self,
        _: &Pose,
        _: &dyn Shape,
        _: &dyn Shape,
        _: f64,
    ) -> Outcome<ClosestPoints> {
        Err(Unsupported)
    }

    fn cast_shapes(
        &self,
        _: &Pose,
        _: Vector,
        _: &dyn Shape,
        _: &dyn Shape,
        _: ShapeCastOptions,
    ) -> Outcome<Option<ShapeCastHit>> {
        Err(Unsupported)
    }

    fn cast_shapes_nonlinear(
        &self,
        _: &NonlinearRigidMotion,
        _: &dyn Shape,
        _: &NonlinearRigidMotion,
        _: &dyn Shape,
        _: f64,
        _: f64,
        _: bool,
    ) -> Outcome<Option<ShapeCastHit>> {
        Err(Unsupported)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(u: f64, v: f64) -> Candidate {
        Candidate {
            uv: [u, v],
            distance: 0.0,
        }
    }

    /// Twice the area of the points in the order of their angles.
    fn area(points: &[(usize, Candidate)]) -> f64 {
        let mut corners: Vec<[f64; 2]> = points.iter().map(|p| p.1.uv).collect();
        corners.sort_by(|a, b| a[1].atan2(a[0]).total_cmp(&b[1].atan2(b[0])));
        let next = corners.iter().cycle().skip(1);
        corners
            .iter()
            .zip(next)
            .map(|(a, b)| a[0] * b[1] - a[1] * b[0])
            .sum()
    }

    #[test]
    fn spanning_points_cover_squares_and_discs() {
        for angle in 0..90 {
            let angle = f64::from(angle).to_radians();
            for (corners, fraction) in [(4, 0.999), (32, 0.6)] {
                let step = std::f64::consts::TAU / f64::from(corners);
                let all: Vec<Candidate> = (0..corners)
                    .map(|i| (angle + f64::from(i) * step).sin_cos())
                    .map(|(s, c)| at(c, s))
                    .collect();
                let whole = f64::from(corners) * step.sin();
                let found = area(&spanning(&all));
                assert!(found > fraction * whole, "{corners}: {found} of {whole}");
            }
        }
    }

    #[test]
    fn spanning_points_prefer_near_candidates() {
        let mut all = vec![at(0.0, 0.0), at(0.001, 0.0), at(0.0, 0.001)];
        all.push(Candidate {
            uv: [0.02, 0.02],
            distance: 0.002,
        });
        assert!(spanning(&all).iter().all(|(_, c)| c.distance == 0.0));
        assert!(spanning(&[]).is_empty());
        assert_eq!(spanning(&all[..1]).len(), 1);
    }

    #[test]
    fn edges_are_clipped_to_the_plate() {
        let end = Candidate {
            uv: [3.0, 0.0],
            distance: 3.0,
        };
        let [a, b] = clipped([at(0.0, 0.0), end], [1.0, 1.0]).unwrap();
        assert_eq!((a.uv, a.distance), ([0.0, 0.0], 0.0));
        assert_eq!((b.uv, b.distance), ([1.0, 0.0], 1.0));
        assert!(clipped([at(2.0, 0.0), at(2.0, 1.0)], [1.0, 1.0]).is_none());
    }

    #[test]
    fn plate_inside_a_face_touches_with_its_corners() {
        let half = Vector::new(0.02, 0.02, 0.03);
        let (points, triangles) = Cuboid::new(half).to_trimesh();
        let piece = ConvexPolyhedron::from_convex_mesh(points, &triangles).unwrap();
        let finger = Cuboid::new(Vector::new(0.002, 0.01, 0.0125));
        let plate = Plate::finger(&finger, Vector::X).unwrap();
        let pose = Pose::from_translation(Vector::new(0.0225, 0.0, 0.0));
        let found = spanning(&plate.candidates(&piece, &pose, 2e-3));
        assert_eq!(found.len(), 4);
        for (_, candidate) in found {
            assert_eq!(candidate.uv.map(f64::abs), [0.01, 0.0125]);
            assert!((candidate.distance - 5e-4).abs() < 1e-12);
        }
        assert!(plate.candidates(&piece, &pose, 1e-4).is_empty());
        assert!(Plate::finger(&finger, Vector::new(0.9, 0.4, 0.0)).is_none());
    }
}
