//! Contact of two pressed gels and a sphere, to time its phases apart from all else.
//!
//! The sphere is an icosphere of radius 20 mm. The gels' front faces are pushed 1.5 mm into it
//! along x from both sides, and front nodes nearer than 0.25 mm are put at that distance, without
//! solving for equilibrium. Both gels are about to move by 0.2 mm along z, over the sphere. There
//! is no friction.

use std::collections::BTreeMap;
use std::time::Instant;

use glam::{DMat3, DVec3};
use serde::Serialize;

use super::candidates::Candidates;
use super::ccd;
use super::collider::Collider;
use super::coupling::{Coupling, GeneralisedForce};
use super::gel::GelMaterial;
use super::gel_contact::{GelContact, Situation};
use super::parameters::SolverParameters;
use crate::affine::AffineState;
use crate::contact::barrier::Barrier;
use crate::fem::{Elastic, GelGrid, GelResolution, NeoHookean, Side, Surface};
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

/// Radius of the sphere, m.
const RADIUS: f64 = 0.020;
/// Depth to which the rest plane of each face is pushed, m.
const DEPTH: f64 = 1.5e-3;
/// Least distance of the front nodes from the sphere around the mesh, m.
const GAP: f64 = 2.5e-4;
/// Motion of both gels, m.
const MOTION: DVec3 = DVec3::new(0.0, 0.0, 2e-4);

/// Shortest and median wall time of a phase, ms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PhaseMs {
    /// Shortest.
    pub min: f64,
    /// Median.
    pub median: f64,
}

/// Times of the contact phases of both gels together, on one thread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ContactPhases {
    /// Finding the active contacts among the candidates, with their derivatives.
    pub find: PhaseMs,
    /// Energy, as a trial of the line search needs it: distances of all near candidates again.
    pub energy: PhaseMs,
    /// Gradient on the gels' nodes and on the object's 12 unknowns.
    pub gradient: PhaseMs,
    /// Positive semidefinite stiffness, assembled into the gels' sparse matrices, the coupling
    /// rows and the object's block.
    pub hessian: PhaseMs,
    /// Largest share of the step that is free of contact.
    pub ccd: PhaseMs,
    /// Gathering candidates from the bounding volume hierarchies.
    pub gather: PhaseMs,
    /// The share of a gathering that falls on one iteration: candidates hold until a node has
    /// moved by their margin, twice the motion of this scene.
    pub gathers_per_iteration: f64,
}

impl ContactPhases {
    /// Shortest time of one iteration with the amortised gathering, ms.
    pub fn iteration_ms(&self) -> f64 {
        self.without_gather_ms() + self.gathers_per_iteration * self.gather.min
    }

    /// Shortest time of one iteration that gathers, ms.
    pub fn gathering_iteration_ms(&self) -> f64 {
        self.without_gather_ms() + self.gather.min
    }

    fn without_gather_ms(&self) -> f64 {
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

/// What the contacts are, to hold them against another implementation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ContactState {
    /// Vertex-triangle pairs nearer than `d_hat`, of either side's vertices.
    pub vertex_triangle_pairs: usize,
    /// Edge-edge pairs nearer than `d_hat`.
    pub edge_edge_pairs: usize,
    /// Candidate pairs.
    pub candidates: usize,
    /// Smallest distance, m.
    pub min_distance_m: f64,
    /// Energy, J.
    pub energy_j: f64,
    /// Length of the gradient over all gel nodes, N.
    pub gradient_n: f64,
    /// Largest share of the motion without contact.
    pub free_share: f64,
}

/// The scene's surfaces as one mesh: gels' front and sides, then the sphere.
#[derive(Clone, Debug, Serialize)]
pub struct LoadMesh {
    /// Positions at rest, m.
    pub rest: Vec<[f64; 3]>,
    /// Positions, m.
    pub vertices: Vec<[f64; 3]>,
    /// Positions after the motion, m.
    pub moved: Vec<[f64; 3]>,
    /// Triangles.
    pub faces: Vec<[u32; 3]>,
    /// The first vertex of the sphere.
    pub first_of_sphere: usize,
    /// Distance at which contact begins, m.
    pub d_hat_m: f64,
    /// Stiffness of the barrier, Pa.
    pub kappa_pa: f64,
    /// Margin of candidates that are kept over iterations, m.
    pub candidate_margin_m: f64,
}

struct Pressed {
    surface: Surface,
    elastic: Elastic,
    rest: Vec<DVec3>,
    x: Vec<DVec3>,
    contact: GelContact,
    gradient: Vec<DVec3>,
    values: Vec<f64>,
    coupling: Coupling,
    motion: Vec<f64>,
    direction: Vec<f64>,
}

/// Two gels pressed on a sphere.
pub struct ContactLoad {
    gels: [Pressed; 2],
    collider: Collider,
    object: AffineState,
    sphere: TriangleMesh,
    barrier: Barrier,
    parameters: SolverParameters,
}

impl std::fmt::Debug for ContactLoad {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ContactLoad")
            .field("faces", &self.sphere.triangles.len())
            .finish_non_exhaustive()
    }
}

impl Pressed {
    fn new(grid: &GelGrid, side: DVec3) -> Result<Self> {
        let material = GelMaterial::default();
        let law = NeoHookean::new(material.young_pa, material.poisson)?;
        let elastic = Elastic::new(grid.positions(), grid.tets(), law)?;
        let rotation = DMat3::from_cols(DVec3::Z, side.cross(DVec3::Z), side);
        let back = -(RADIUS - DEPTH + grid.thickness_m());
        let place = |p: &DVec3| rotation * *p + side * back;
        let rest: Vec<DVec3> = grid.positions().iter().map(place).collect();
        let mut x = rest.clone();
        for node in grid.triangles(Side::Front).iter().flatten() {
            let x = &mut x[*node as usize];
            if x.length() < RADIUS + GAP {
                *x = x.normalize() * (RADIUS + GAP);
            }
        }
        let nodes = x.len();
        Ok(Self {
            surface: grid.contact_surface().clone(),
            values: elastic.pattern().zeros(),
            elastic,
            rest,
            contact: GelContact::new(nodes),
            gradient: vec![DVec3::ZERO; nodes],
            coupling: Coupling::default(),
            motion: vec![0.0; nodes],
            direction: MOTION.to_array().repeat(nodes),
            x,
        })
    }

    fn gather(&mut self, object: &AffineState, collider: &Collider, p: &SolverParameters) {
        let limits = (p.d_hat_m, p.candidate_margin_m);
        self.contact.candidates.gather(
            &self.surface,
            &self.rest,
            &self.x,
            object,
            collider,
            limits,
        );
    }

    fn note_motion(&mut self, object: &AffineState) {
        let Self {
            contact,
            surface,
            x,
            ..
        } = self;
        let GelContact {
            candidates, moved, ..
        } = contact;
        candidates.moved(surface, x, object, moved);
    }

    fn find(&mut self, barrier: &Barrier, object: &AffineState) {
        self.note_motion(object);
        let now = Situation {
            barrier,
            x: &self.x,
            object,
        };
        self.contact.update(&now);
    }

    fn energy(&mut self, barrier: &Barrier, object: &AffineState) -> f64 {
        self.note_motion(object);
        let now = Situation {
            barrier,
            x: &self.x,
            object,
        };
        self.contact.energy(&now)
    }

    fn write_gradient(&mut self, barrier: &Barrier, object: &AffineState) -> GeneralisedForce {
        let mut on_object = GeneralisedForce::default();
        self.gradient.fill(DVec3::ZERO);
        let now = Situation {
            barrier,
            x: &self.x,
            object,
        };
        let (x, gradient) = (&self.x, &mut self.gradient);
        self.contact
            .add_gradient(&now, x, object, gradient, &mut on_object);
        on_object
    }

    fn write_hessian(&mut self, barrier: &Barrier, object: &AffineState) {
        self.values.fill(0.0);
        self.coupling.clear(3 * self.x.len());
        let now = Situation {
            barrier,
            x: &self.x,
            object,
        };
        self.contact.add_hessian(
            &now,
            &self.x,
            object,
            self.elastic.pattern(),
            &mut self.values,
            &mut self.coupling,
        );
    }

    fn free_share(&mut self, object: &AffineState, slack: f64) -> f64 {
        self.note_motion(object);
        let still = AffineState::from_array(&[0.0; 12]);
        let (x, direction) = (&self.x, &self.direction);
        ccd::relative_motion(
            &self.surface,
            x,
            direction,
            object,
            &still,
            &mut self.motion,
        );
        let motion = &self.motion;
        ccd::free_share(
            &self.contact,
            x,
            direction,
            object,
            &still,
            motion,
            (1.0, slack),
        )
    }
}

impl ContactLoad {
    /// The scene with a gel mesh and an icosphere of 20 · 4^`cuts` faces.
    ///
    /// # Errors
    /// None for the built-in gel meshes.
    pub fn new(resolution: GelResolution, cuts: u32) -> Result<Self> {
        let parameters = SolverParameters::default();
        let grid = GelGrid::pad(resolution)?;
        let sphere = icosphere(RADIUS, cuts);
        let [left, right] = [DVec3::X, DVec3::NEG_X].map(|side| Pressed::new(&grid, side));
        let mut load = Self {
            gels: [left?, right?],
            collider: Collider::new(&sphere),
            object: AffineState::rigid(DVec3::ZERO, DMat3::IDENTITY),
            sphere,
            barrier: Barrier {
                kappa: parameters.kappa_pa,
                d_hat: parameters.d_hat_m,
            },
            parameters,
        };
        load.on_gels(|gel, f| gel.gather(&f.object, f.collider, f.parameters));
        Ok(load)
    }

    /// Number of the sphere's faces.
    pub fn faces(&self) -> usize {
        self.sphere.triangles.len()
    }

    fn on_gels<R>(&mut self, mut work: impl FnMut(&mut Pressed, &Frame<'_>) -> R) -> [R; 2] {
        let frame = Frame {
            object: self.object,
            collider: &self.collider,
            barrier: self.barrier,
            parameters: &self.parameters,
        };
        let [left, right] = &mut self.gels;
        [work(left, &frame), work(right, &frame)]
    }

    /// Times each phase `runs` times for both gels together.
    pub fn measure(&mut self, runs: usize) -> ContactPhases {
        let slack = self.parameters.ccd_slack;
        let gather = self.timed(runs, |gel, f| {
            gel.gather(&f.object, f.collider, f.parameters);
        });
        let find = self.timed(runs, |gel, f| gel.find(&f.barrier, &f.object));
        let energy = self.timed(runs, |gel, f| {
            std::hint::black_box(gel.energy(&f.barrier, &f.object));
        });
        let gradient = self.timed(runs, |gel, f| {
            std::hint::black_box(gel.write_gradient(&f.barrier, &f.object));
        });
        let hessian = self.timed(runs, |gel, f| gel.write_hessian(&f.barrier, &f.object));
        let ccd = self.timed(runs, |gel, f| {
            std::hint::black_box(gel.free_share(&f.object, slack));
        });
        ContactPhases {
            find,
            energy,
            gradient,
            hessian,
            ccd,
            gather,
            gathers_per_iteration: MOTION.length() / self.parameters.candidate_margin_m,
        }
    }

    fn timed(&mut self, runs: usize, mut work: impl FnMut(&mut Pressed, &Frame<'_>)) -> PhaseMs {
        let mut took = Vec::with_capacity(runs);
        // The first one warms the caches up.
        for run in 0..=runs.max(1) {
            let began = Instant::now();
            self.on_gels(&mut work);
            if run > 0 {
                took.push(began.elapsed().as_secs_f64() * 1e3);
            }
        }
        took.sort_by(f64::total_cmp);
        PhaseMs {
            min: took[0],
            median: took[(took.len() - 1) / 2],
        }
    }

    /// The contacts of the scene.
    pub fn state(&mut self) -> ContactState {
        let slack = self.parameters.ccd_slack;
        let parts = self.on_gels(|gel, f| {
            gel.find(&f.barrier, &f.object);
            let energy = gel.energy(&f.barrier, &f.object);
            gel.write_gradient(&f.barrier, &f.object);
            let squared: f64 = gel.gradient.iter().map(|g| g.length_squared()).sum();
            (energy, squared, gel.free_share(&f.object, slack))
        });
        let contacts = || self.gels.iter().flat_map(|gel| &gel.contact.contacts);
        let edges = contacts().filter(|contact| contact.stencil.count == 2);
        let edge_edge_pairs = edges.count();
        let candidates = |gel: &Pressed| Candidates::len(&gel.contact.candidates);
        ContactState {
            vertex_triangle_pairs: contacts().count() - edge_edge_pairs,
            edge_edge_pairs,
            candidates: self.gels.iter().map(candidates).sum(),
            min_distance_m: contacts()
                .map(|contact| contact.distance)
                .fold(f64::INFINITY, f64::min),
            energy_j: parts.iter().map(|part| part.0).sum(),
            gradient_n: parts.iter().map(|part| part.1).sum::<f64>().sqrt(),
            free_share: parts.iter().map(|part| part.2).fold(1.0, f64::min),
        }
    }

    /// All surfaces as one mesh, for another implementation.
    pub fn mesh(&self) -> LoadMesh {
        let mut mesh = LoadMesh {
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
            for (k, &node) in gel.surface.vertices().iter().enumerate() {
                let (rest, x) = (gel.rest[node as usize], gel.x[node as usize]);
                number.insert(node, (first + k) as u32);
                mesh.add(rest, x, x + MOTION);
            }
            let triangles = gel.surface.triangles().iter();
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

impl LoadMesh {
    fn add(&mut self, rest: DVec3, x: DVec3, moved: DVec3) {
        self.rest.push(rest.to_array());
        self.vertices.push(x.to_array());
        self.moved.push(moved.to_array());
    }
}

/// What a phase of one gel looks at.
struct Frame<'a> {
    object: AffineState,
    collider: &'a Collider,
    barrier: Barrier,
    parameters: &'a SolverParameters,
}

/// A sphere from an icosahedron whose faces are cut in four `cuts` times.
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

/// Cuts every face of a unit sphere in four.
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
    fn the_icosphere_is_closed_and_round() {
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
    fn the_scene_touches_everywhere_it_should_and_moves_freely_or_not_at_all() {
        let mut load = ContactLoad::new(GelResolution::Coarse, 3).unwrap();
        assert_eq!(load.faces(), 1280);
        let state = load.state();
        assert!(
            state.vertex_triangle_pairs > 100 && state.edge_edge_pairs > 200,
            "{state:?}"
        );
        assert!(
            state.min_distance_m > 1e-4 && state.min_distance_m < 3.5e-4,
            "{state:?}"
        );
        assert!(state.energy_j > 0.0 && state.gradient_n > 0.0);
        // 0.2 mm along the sphere eat at most a part of a gap of 0.25 mm.
        assert!(state.free_share > 0.5, "{state:?}");
        let phases = load.measure(3);
        assert!(phases.iteration_ms() > 0.0);
        assert!(phases.gathering_iteration_ms() > phases.iteration_ms());
        let mesh = load.mesh();
        assert_eq!(mesh.rest.len(), mesh.first_of_sphere + 642);
        assert!(
            mesh.faces
                .iter()
                .flatten()
                .all(|&v| (v as usize) < mesh.rest.len())
        );
    }
}
