//! Contact of two pressed gels and a sphere, to time its phases in isolation.
//!
//! The sphere is an icosphere of radius 20 mm. The front faces of the gels are pushed 1.5 mm into
//! it along x from both sides; front nodes nearer than 0.25 mm are projected to that distance,
//! without equilibrium. Both gels move by 0.2 mm along z over the sphere, without friction.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;
use gripcast_sim::affine::AffineState;
use gripcast_sim::fem::{GelGrid, GelPad, GelResolution, Side};
use gripcast_sim::solver::{Collider, Drive, Gel, GelMaterial, GelPhases, SolverParameters};
use serde::Serialize;

use crate::timing::{Timing, timed};

/// Radius of the sphere, m.
const RADIUS: f64 = 0.020;
/// Indentation of the rest plane of each face, m.
const DEPTH: f64 = 1.5e-3;
/// Minimum distance of the front nodes to the circumscribed sphere, m.
const GAP: f64 = 2.5e-4;
/// Motion of both gels, m.
const MOTION: DVec3 = DVec3::new(0.0, 0.0, 2e-4);

/// Times of the contact phases of both gels together, on one thread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct ContactPhases {
    /// Active contacts of the candidates, with their derivatives.
    pub(crate) find: Timing,
    /// Energy in a line search: recomputes the distances of all near candidates.
    pub(crate) energy: Timing,
    /// Gradient on the gels' nodes and on the object's 12 unknowns.
    pub(crate) gradient: Timing,
    /// Positive semidefinite stiffness, assembled into the gels' sparse matrices, the coupling
    /// rows and the object's block.
    pub(crate) hessian: Timing,
    /// Collision-free step size.
    pub(crate) ccd: Timing,
    /// Candidates from the bounding volume hierarchies.
    pub(crate) build: Timing,
    /// Candidate builds per iteration: candidates are kept until a node has moved by their margin,
    /// twice the motion of this scene.
    pub(crate) rebuilds_per_iteration: f64,
}

impl ContactPhases {
    /// Minimum time of an iteration with the amortised candidate build, ms.
    pub(crate) fn iteration_ms(&self) -> f64 {
        self.without_build_ms() + self.rebuilds_per_iteration * self.build.min
    }

    /// Minimum time of an iteration with a candidate build, ms.
    pub(crate) fn rebuild_iteration_ms(&self) -> f64 {
        self.without_build_ms() + self.build.min
    }

    fn without_build_ms(&self) -> f64 {
        [
            self.find,
            self.energy,
            self.gradient,
            self.hessian,
            self.ccd,
        ]
        .iter()
        .map(|phase| phase.min)
        .sum()
    }
}

/// State of the contacts, for comparison with a baseline.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct ContactState {
    /// Vertex-triangle pairs nearer than `d_hat`, of either side's vertices.
    pub(crate) vertex_triangle_pairs: usize,
    /// Edge-edge pairs nearer than `d_hat`.
    pub(crate) edge_edge_pairs: usize,
    /// Candidate pairs.
    pub(crate) candidates: usize,
    /// Smallest distance, m.
    pub(crate) min_distance_m: f64,
    /// Energy, J.
    pub(crate) energy_j: f64,
    /// Norm of the gradient over all gel nodes, N.
    pub(crate) gradient_n: f64,
    /// Collision-free step size, as a fraction of the motion.
    pub(crate) free_fraction: f64,
}

/// The scene's surfaces as one mesh: gels' front and sides, then the sphere.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct SceneMesh {
    /// Positions at rest, m.
    pub(crate) rest: Vec<[f64; 3]>,
    /// Positions, m.
    pub(crate) vertices: Vec<[f64; 3]>,
    /// Positions after the motion, m.
    pub(crate) moved: Vec<[f64; 3]>,
    /// Triangles.
    pub(crate) faces: Vec<[u32; 3]>,
    /// Index of the first vertex of the sphere.
    pub(crate) first_of_sphere: usize,
    /// Barrier activation distance d̂, m.
    pub(crate) d_hat_m: f64,
    /// Barrier stiffness, Pa.
    pub(crate) kappa_pa: f64,
    /// Margin of kept candidates, m.
    pub(crate) candidate_margin_m: f64,
}

/// Two gels pressed on a sphere.
pub(crate) struct ContactScene {
    gels: [GelPhases; 2],
    collider: Collider,
    sphere: TriangleMesh,
    parameters: SolverParameters,
}

/// A gel whose back is towards `-side`, at rest and pressed on the sphere.
fn pressed(grid: &GelGrid, side: DVec3, parameters: &SolverParameters) -> Result<GelPhases> {
    let rotation = DMat3::from_cols(DVec3::Z, side.cross(DVec3::Z), side);
    let back = -(RADIUS - DEPTH + grid.thickness_m());
    let (material, drive) = (GelMaterial::default(), Drive::default());
    let to_world = |p: DVec3| rotation * p + side * back;
    let gel = Gel::new(grid, &material, drive, parameters, to_world)?;
    let mut x = gel.positions().to_vec();
    for node in grid.triangles(Side::Front).iter().flatten() {
        let x = &mut x[*node as usize];
        if x.length() < RADIUS + GAP {
            *x = x.normalize() * (RADIUS + GAP);
        }
    }
    let object = AffineState::rigid(DVec3::ZERO, DMat3::IDENTITY);
    Ok(GelPhases::new(gel, x, MOTION, object, *parameters))
}

impl ContactScene {
    /// Creates the scene with a gel mesh and an icosphere of 20 · 4^`cuts` faces.
    pub(crate) fn new(resolution: GelResolution, cuts: u32) -> Result<Self> {
        let parameters = SolverParameters::default();
        let grid = GelPad::default().grid(resolution)?;
        let sphere = icosphere(RADIUS, cuts);
        let collider = Collider::new(&sphere);
        let [left, right] = [DVec3::X, DVec3::NEG_X].map(|side| pressed(&grid, side, &parameters));
        let mut gels = [left?, right?];
        for gel in &mut gels {
            gel.build_candidates(&collider);
        }
        Ok(Self {
            gels,
            collider,
            sphere,
            parameters,
        })
    }

    /// Returns the number of faces of the sphere.
    pub(crate) fn faces(&self) -> usize {
        self.sphere.triangles.len()
    }

    /// Times each phase `runs` times for both gels together.
    pub(crate) fn measure(&mut self, runs: usize) -> ContactPhases {
        let Self { gels, collider, .. } = self;
        let mut phase = |work: fn(&mut GelPhases)| {
            // Warm-up.
            gels.iter_mut().for_each(work);
            timed(runs, || gels.iter_mut().for_each(work))
        };
        let find = phase(GelPhases::find_contacts);
        let energy = phase(|gel| {
            std::hint::black_box(gel.energy());
        });
        let gradient = phase(|gel| {
            std::hint::black_box(gel.gradient());
        });
        let hessian = phase(GelPhases::hessian);
        let ccd = phase(|gel| {
            std::hint::black_box(gel.collision_free_step());
        });
        ContactPhases {
            find,
            energy,
            gradient,
            hessian,
            ccd,
            build: timed(runs, || {
                gels.iter_mut()
                    .for_each(|gel| gel.build_candidates(collider));
            }),
            rebuilds_per_iteration: MOTION.length() / self.parameters.candidate_margin_m,
        }
    }

    /// Returns the state of the contacts.
    pub(crate) fn state(&mut self) -> ContactState {
        let parts = self.gels.each_mut().map(|gel| {
            gel.find_contacts();
            let squared: f64 = gel.gradient().iter().map(|g| g.length_squared()).sum();
            (gel.energy(), squared, gel.collision_free_step())
        });
        let contacts = || self.gels.iter().flat_map(GelPhases::contacts);
        let edge_edge_pairs = contacts().filter(|(is_edge_edge, _)| *is_edge_edge).count();
        ContactState {
            vertex_triangle_pairs: contacts().count() - edge_edge_pairs,
            edge_edge_pairs,
            candidates: self.gels.iter().map(GelPhases::candidates).sum(),
            min_distance_m: contacts()
                .map(|(_, distance)| distance)
                .fold(f64::INFINITY, f64::min),
            energy_j: parts.iter().map(|part| part.0).sum(),
            gradient_n: parts.iter().map(|part| part.1).sum::<f64>().sqrt(),
            free_fraction: parts.iter().map(|part| part.2).fold(1.0, f64::min),
        }
    }

    /// Returns all surfaces as one mesh, for a baseline.
    pub(crate) fn mesh(&self) -> SceneMesh {
        let mut mesh = SceneMesh {
            rest: Vec::new(),
            vertices: Vec::new(),
            moved: Vec::new(),
            faces: Vec::new(),
            first_of_sphere: 0,
            d_hat_m: self.parameters.d_hat_m,
            kappa_pa: self.parameters.kappa_pa,
            candidate_margin_m: self.parameters.candidate_margin_m,
        };
        for gel in &self.gels {
            let first = mesh.rest.len();
            let mut number = BTreeMap::new();
            for (k, &node) in gel.surface().vertices().iter().enumerate() {
                let [rest, x] = gel.positions().map(|all| all[node as usize]);
                number.insert(node, (first + k) as u32);
                mesh.add(rest, x, x + MOTION);
            }
            let triangles = gel.surface().triangles().iter();
            mesh.faces.extend(triangles.map(|t| t.map(|v| number[&v])));
        }
        mesh.first_of_sphere = mesh.rest.len();
        let first = mesh.first_of_sphere as u32;
        for &vertex in &self.sphere.vertices {
            mesh.add(vertex, vertex, vertex);
        }
        let triangles = self.sphere.triangles.iter();
        mesh.faces.extend(triangles.map(|t| t.map(|v| first + v)));
        mesh
    }
}

impl SceneMesh {
    fn add(&mut self, rest: DVec3, x: DVec3, moved: DVec3) {
        self.rest.push(rest.to_array());
        self.vertices.push(x.to_array());
        self.moved.push(moved.to_array());
    }
}

/// Returns an icosahedron subdivided `cuts` times.
fn icosphere(radius: f64, cuts: u32) -> TriangleMesh {
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    let mut mesh = TriangleMesh::default();
    for axis in 0..3 {
        for (long, short) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            let mut corner = [0.0; 3];
            corner[(axis + 1) % 3] = short;
            corner[(axis + 2) % 3] = long * golden;
            mesh.vertices.push(DVec3::from_array(corner).normalize());
        }
    }
    let near = |a: usize, b: usize| mesh.vertices[a].dot(mesh.vertices[b]) > 0.4;
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(a, c) {
                    let [p, q, r] = [a, b, c].map(|v| mesh.vertices[v]);
                    let outward = (q - p).cross(r - p).dot(p) > 0.0;
                    let [a, b, c] = [a, b, c].map(|v| v as u32);
                    mesh.triangles
                        .push(if outward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    for _ in 0..cuts {
        cut(&mut mesh);
    }
    for vertex in &mut mesh.vertices {
        *vertex *= radius;
    }
    mesh
}

/// Subdivides every face of a unit sphere into four.
fn cut(mesh: &mut TriangleMesh) {
    let mut middles = BTreeMap::new();
    let vertices = &mut mesh.vertices;
    let mut middle = |a: u32, b: u32| {
        *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
            let point = (vertices[a as usize] + vertices[b as usize]).normalize();
            vertices.push(point);
            (vertices.len() - 1) as u32
        })
    };
    let mut triangles = Vec::with_capacity(4 * mesh.triangles.len());
    for &[a, b, c] in &mesh.triangles {
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        triangles.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
    }
    mesh.triangles = triangles;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn icosphere_is_closed_and_round() {
        let mesh = icosphere(RADIUS, 3);
        assert_eq!((mesh.triangles.len(), mesh.vertices.len()), (1280, 642));
        assert!(mesh.edges().is_closed());
        let far = |v: &DVec3| (v.length() - RADIUS).abs();
        assert!(mesh.vertices.iter().map(far).fold(0.0, f64::max) < 1e-15);
        let volume: f64 = mesh
            .all_corners()
            .map(|[a, b, c]| a.cross(b).dot(c) / 6.0)
            .sum();
        let ball = 4.0 / 3.0 * std::f64::consts::PI * RADIUS.powi(3);
        assert!((0.98..1.0).contains(&(volume / ball)), "{volume}");
    }

    #[test]
    fn scene_has_contacts_and_free_motion() {
        let mut scene = ContactScene::new(GelResolution::Coarse, 3).unwrap();
        assert_eq!(scene.faces(), 1280);
        let state = scene.state();
        assert!(
            state.vertex_triangle_pairs > 100 && state.edge_edge_pairs > 200,
            "{state:?}"
        );
        assert!(
            state.min_distance_m > 1e-4 && state.min_distance_m < 3.5e-4,
            "{state:?}"
        );
        assert!(state.energy_j > 0.0 && state.gradient_n > 0.0);
        // A tangential motion of 0.2 mm uses only a fraction of the gap of 0.25 mm.
        assert!(state.free_fraction > 0.5, "{state:?}");
        let phases = scene.measure(3);
        assert!(phases.iteration_ms() > 0.0);
        assert!(phases.rebuild_iteration_ms() > phases.iteration_ms());
        let mesh = scene.mesh();
        assert_eq!(mesh.rest.len(), mesh.first_of_sphere + 642);
        assert!(
            mesh.faces
                .iter()
                .flatten()
                .all(|&v| (v as usize) < mesh.rest.len())
        );
    }
}
