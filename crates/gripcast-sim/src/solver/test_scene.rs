//! Small scenes and brute-force geometry for solver tests.

use glam::{DMat3, DVec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::{Collider, Drive, Gel, GelMaterial, Object, SolverParameters, System};
use crate::affine::{AffineBody, AffineState};
use crate::contact::distance::{edge_edge, point_triangle};
use crate::fem::GelGrid;
use gripcast_geometry::{MassProperties, Pose, TriangleMesh, builtin};

const MASS_KG: f64 = 0.06;
const MU: f64 = 0.4;

/// Two gels around an object that stands on the ground.
pub(super) struct Grip {
    pub(super) grid: GelGrid,
    /// Gripper pose: closing along x, the gels' long sides along z.
    pub(super) pose: Pose,
    pub(super) opening_m: f64,
}

/// A pad of 10 x 8 x 4 mm with 5 x 5 x 3 nodes.
pub(super) fn small_pad() -> GelGrid {
    GelGrid::uniform([5, 5, 3], [0.010, 0.008, 0.004]).unwrap()
}

/// A built-in mesh around its centre of mass, rotated in its own frame.
pub(super) fn centred(name: &str, rotation: DMat3) -> TriangleMesh {
    let mut mesh = builtin(name).unwrap();
    let center = MassProperties::from_mesh(&mesh).unwrap().center_of_mass_m;
    for vertex in &mut mesh.vertices {
        *vertex = rotation * (*vertex - center);
    }
    mesh
}

pub(super) fn closing(pose: &Pose) -> [DVec3; 2] {
    [DVec3::X, DVec3::NEG_X].map(|x| pose.transform_vector(x))
}

impl Grip {
    fn to_world(&self, side: DVec3, p: DVec3) -> DVec3 {
        let rotation = DMat3::from_cols(DVec3::Z, side.cross(DVec3::Z), side);
        let back = -(0.5 * self.opening_m + self.grid.thickness_m());
        self.pose.transform_point(rotation * p + side * back)
    }

    /// Builds the scene with the object at the height at which the ground carries it.
    pub(super) fn system(&self, mesh: &TriangleMesh, parameters: &SolverParameters) -> System {
        let properties = MassProperties::from_mesh(mesh).unwrap();
        let body = AffineBody::new(
            MASS_KG,
            properties.volume_m3,
            properties.second_moment_m5,
            parameters.affine_stiffness_pa,
        )
        .unwrap();
        let collider = Collider::new(mesh);
        let state = AffineState::rigid(DVec3::ZERO, DMat3::IDENTITY);
        let mut object = Object::new(body, state, &collider).with_ground(MU);
        let barrier = parameters.barrier();
        let gap = object.resting_height(&collider, &barrier, MASS_KG * 9.81);
        object.raise(gap - object.lowest(&collider));
        let gels = [DVec3::X, DVec3::NEG_X].map(|side| {
            let to_world = |p| self.to_world(side, p);
            let material = GelMaterial::default();
            Gel::new(
                &self.grid,
                &material,
                Drive::default(),
                parameters,
                to_world,
            )
            .unwrap()
        });
        System::new(gels.into(), object, collider, MU, *parameters).unwrap()
    }
}

/// A random point of a cube with this half width.
pub(super) fn random_point(rng: &mut Pcg64, half: f64) -> DVec3 {
    DVec3::from_array([(); 3].map(|()| rng.random_range(-half..half)))
}

/// Distances below `limit` over all pairs, by brute force: gel nodes and triangles, convex vertices
/// and gel triangles, convex edges and gel edges.
pub(super) fn near_distances(
    gel: &Gel,
    object: &AffineState,
    collider: &Collider,
    limit: f64,
) -> [Vec<f64>; 3] {
    let surface = gel.surface();
    let x = |node: u32| gel.positions()[node as usize];
    let world: Vec<DVec3> = collider.vertices.iter().map(|&v| object.point(v)).collect();
    let body = |vertex: u32| world[vertex as usize];
    let mut found = [Vec::new(), Vec::new(), Vec::new()];
    let mut take = |kind: usize, distance: f64| {
        if distance < limit {
            found[kind].push(distance);
        }
    };
    for &node in surface.vertices() {
        for triangle in &collider.triangles {
            let [a, b, c] = triangle.map(body);
            take(0, point_triangle(x(node), a, b, c).distance());
        }
    }
    for triangle in surface.triangles() {
        let [a, b, c] = triangle.map(x);
        for &vertex in &collider.corners {
            take(1, point_triangle(body(vertex), a, b, c).distance());
        }
    }
    for gel_edge in surface.edges() {
        let [a0, a1] = gel_edge.map(x);
        for edge in &collider.edges {
            let [b0, b1] = edge.map(body);
            take(2, edge_edge(a0, a1, b0, b1).distance());
        }
    }
    found
}

/// Whether any edge of a gel triangle pierces a triangle of the object, or the reverse; considers
/// flat and concave edges too.
pub(super) fn crosses(gel: &Gel, object: &AffineState, collider: &Collider) -> bool {
    let inverse = object.a.inverse();
    let x: Vec<DVec3> = gel
        .positions()
        .iter()
        .map(|&x| inverse * (x - object.p))
        .collect();
    gel.surface().triangles().iter().any(|triangle| {
        let pad = triangle.map(|node| x[node as usize]);
        let bounds = gripcast_geometry::Aabb::from_points(pad);
        let mut found = false;
        collider.triangle_tree.for_each_overlap(&bounds, |other| {
            let body = collider.triangles[other as usize].map(|v| collider.vertices[v as usize]);
            found |= side_through(&pad, &body) || side_through(&body, &pad);
        });
        found
    })
}

fn side_through(a: &[DVec3; 3], &[t0, t1, t2]: &[DVec3; 3]) -> bool {
    let volume = |p: DVec3, q: DVec3, r: DVec3, s: DVec3| (q - p).cross(r - p).dot(s - p);
    [(0, 1), (1, 2), (2, 0)].into_iter().any(|(i, j)| {
        let (p, q) = (a[i], a[j]);
        let apart = volume(t0, t1, t2, p) * volume(t0, t1, t2, q) < 0.0;
        let sides = [(t0, t1), (t1, t2), (t2, t0)].map(|(u, v)| volume(p, q, u, v));
        apart && (sides.iter().all(|t| *t > 0.0) || sides.iter().all(|t| *t < 0.0))
    })
}

#[test]
fn piercing_side_is_detected() {
    let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
    let through = DVec3::new(0.2, 0.2, 0.0);
    let other = |dz: f64| {
        [
            through + DVec3::Z * dz,
            through + DVec3::new(0.1, 0.0, 1.0),
            through + 2.0 * DVec3::Z,
        ]
    };
    assert!(side_through(&other(-1.0), &triangle));
    assert!(!side_through(&other(0.5), &triangle));
    let beside = other(-1.0).map(|p| p + DVec3::X);
    assert!(!side_through(&beside, &triangle));
}
