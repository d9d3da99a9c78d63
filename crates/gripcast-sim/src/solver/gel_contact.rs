//! Contact of one gel with the object: energy, forces, stiffness.
//!
//! A contact joins up to three gel nodes with one material point of the object. With the weights
//! of the closest points the relative displacement is `u = Σ w_i dx_i - (dp + dA X)`, and every
//! term here is a scalar or 3x3 function of u; only mollified edge pairs add a term in the
//! directions of the edges.

use glam::{DMat3, DVec3};

use super::candidates::{Candidates, EdgeEdge, within};
use super::coupling::{Coupling, GeneralisedForce};
use crate::affine::AffineState;
use crate::contact::barrier::Barrier;
use crate::contact::distance::{Closest, edge_edge, point_triangle};
use crate::contact::friction::Friction;
use crate::contact::mollifier::{self, Mollifier};
use crate::fem::{StiffnessPattern, Surface, outer};

/// Gel nodes of a contact with the weights of its closest point, and the object's material point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stencil {
    pub(super) nodes: [u32; 3],
    pub(super) weights: [f64; 3],
    pub(super) count: u8,
    pub(super) material: DVec3,
}

impl Stencil {
    #[inline]
    fn gel(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        (0..usize::from(self.count)).map(|k| (self.nodes[k] as usize, self.weights[k]))
    }

    /// Displacement of the gel's point relative to the object's since the start of the step, m.
    #[inline]
    fn slip(&self, state: &ContactState<'_>) -> DVec3 {
        let moved = |(i, w): (usize, f64)| (state.x[i] - state.start[i]) * w;
        let gel: DVec3 = self.gel().map(moved).sum();
        let Obstacle { now, start, .. } = state.obstacle;
        gel - (now.point(self.material) - start.point(self.material))
    }

    /// Adds a gradient with respect to u, N.
    #[inline]
    fn add_gradient(&self, gradient: DVec3, gel: &mut [DVec3], object: &mut GeneralisedForce) {
        for (i, w) in self.gel() {
            gel[i] += gradient * w;
        }
        object.add(-gradient, self.material);
    }

    /// Adds a Hessian with respect to u, N/m.
    fn add_hessian(
        &self,
        hessian: &DMat3,
        pattern: &StiffnessPattern,
        values: &mut [f64],
        coupling: &mut Coupling,
    ) {
        for (k, (i, wi)) in self.gel().enumerate() {
            pattern.add_diagonal_block(i, &(*hessian * (wi * wi)), values);
            for (j, wj) in self.gel().skip(k + 1) {
                pattern.add_pair_block(i, j, &(*hessian * (wi * wj)), values);
            }
            coupling.add_gel_block(i, &(*hessian * -wi), self.material);
        }
        coupling.object.add_block(hessian, self.material);
    }
}

/// An active contact.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contact {
    pub(super) stencil: Stencil,
    /// Unit vector from the object to the gel.
    pub(super) normal: DVec3,
    pub(super) distance: f64,
    /// First and second derivative of the energy with respect to the distance, N and N/m.
    first: f64,
    second: f64,
    /// Mollified edge pairs carry no friction.
    is_mollified: bool,
}

/// The term of a mollified edge pair that rotates its edges.
#[derive(Clone, Copy, Debug)]
struct MollifierRotation {
    nodes: [u32; 2],
    /// Edge of the object in the material frame, m.
    material_edge: DVec3,
    ea: DVec3,
    eb: DVec3,
    /// Gradient of the energy with respect to both edge vectors, N.
    gradient: [DVec3; 2],
    /// Coefficient of the Gauss-Newton stiffness.
    coefficient: f64,
}

/// A contact with friction lagged from the start of the step.
#[derive(Clone, Copy, Debug)]
struct FrictionContact {
    stencil: Stencil,
    friction: Friction,
}

/// The object now and at the start of the step, and the barrier around it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Obstacle<'a> {
    pub(super) barrier: &'a Barrier,
    pub(super) now: &'a AffineState,
    pub(super) start: &'a AffineState,
}

/// Positions of a gel and of the object, now and at the start of the step.
#[derive(Clone, Copy, Debug)]
pub(super) struct ContactState<'a> {
    pub(super) obstacle: Obstacle<'a>,
    pub(super) x: &'a [DVec3],
    pub(super) start: &'a [DVec3],
}

/// Contacts of one gel with the object.
#[derive(Clone, Debug, Default)]
pub(super) struct GelContact {
    pub(super) candidates: Candidates,
    pub(super) contacts: Vec<Contact>,
    mollifier_rotations: Vec<MollifierRotation>,
    friction_contacts: Vec<FrictionContact>,
    /// World positions of the candidates' object vertices, m.
    world: Vec<DVec3>,
    /// Motion of each node in the object's frame since the candidates were built, m.
    pub(super) displacements: Vec<f64>,
}

impl GelContact {
    /// For a gel of `nodes` nodes.
    pub(super) fn new(nodes: usize) -> Self {
        Self {
            displacements: vec![0.0; nodes],
            ..Self::default()
        }
    }

    /// Updates the displacements since the last build of the candidates; the largest, m.
    pub(super) fn update_displacements(
        &mut self,
        surface: &Surface,
        x: &[DVec3],
        object: &AffineState,
    ) -> f64 {
        self.candidates
            .max_displacement(surface, x, object, &mut self.displacements)
    }

    /// Whether a pair can be closer than `d_hat` after the displacements of its nodes.
    fn is_near(&self, build_distance: f64, nodes: &[u32], d_hat: f64) -> bool {
        let displacements = nodes.iter().map(|&node| self.displacements[node as usize]);
        build_distance <= d_hat + displacements.fold(0.0, |largest, d| d.max(largest))
    }

    /// Calls `visit` with each pair closer than `d_hat`; the displacements must be up to date.
    #[inline]
    fn for_each_active(
        &mut self,
        state: &ContactState<'_>,
        mut visit: impl FnMut(ActivePair<'_>, &Closest),
    ) {
        self.world.clear();
        let materials = self.candidates.materials().iter();
        let Obstacle { barrier, now, .. } = state.obstacle;
        self.world.extend(materials.map(|&m| now.point(m)));
        let (x, d_hat, limit) = (state.x, barrier.d_hat, barrier.d_hat_squared());
        let corner = |v: u32| self.world[v as usize];
        let material = |v: u32| self.candidates.material(v);
        for pair in &self.candidates.node_triangles {
            if !self.is_near(pair.build_distance, &[pair.node], d_hat) {
                continue;
            }
            let [a, b, c] = pair.triangle.map(corner);
            if let Some(closest) = within(point_triangle(x[pair.node as usize], a, b, c), limit) {
                let [_, wa, wb, wc] = closest.weights;
                let [ma, mb, mc] = pair.triangle.map(material);
                let stencil = Stencil {
                    nodes: [pair.node, 0, 0],
                    weights: [1.0, 0.0, 0.0],
                    count: 1,
                    material: -(ma * wa + mb * wb + mc * wc),
                };
                visit(
                    ActivePair::new(stencil, closest.offset, pair.weight),
                    &closest,
                );
            }
        }
        for pair in &self.candidates.vertex_triangles {
            if !self.is_near(pair.build_distance, &pair.nodes, d_hat) {
                continue;
            }
            let [a, b, c] = pair.nodes.map(|node| x[node as usize]);
            let vertex = corner(pair.vertex);
            if let Some(closest) = within(point_triangle(vertex, a, b, c), limit) {
                let [_, wa, wb, wc] = closest.weights;
                let stencil = Stencil {
                    nodes: pair.nodes,
                    weights: [-wa, -wb, -wc],
                    count: 3,
                    material: material(pair.vertex),
                };
                visit(
                    ActivePair::new(stencil, -closest.offset, pair.weight),
                    &closest,
                );
            }
        }
        for pair in &self.candidates.edge_edges {
            if !self.is_near(pair.build_distance, &pair.nodes, d_hat) {
                continue;
            }
            let [a0, a1] = pair.nodes.map(|node| x[node as usize]);
            let [b0, b1] = pair.vertices.map(corner);
            if let Some(closest) = within(edge_edge(a0, a1, b0, b1), limit) {
                let [w0, w1, v0, v1] = closest.weights;
                let [m0, m1] = pair.vertices.map(material);
                let stencil = Stencil {
                    nodes: [pair.nodes[0], pair.nodes[1], 0],
                    weights: [w0, w1, 0.0],
                    count: 2,
                    material: -(m0 * v0 + m1 * v1),
                };
                let mut active = ActivePair::new(stencil, closest.offset, pair.weight);
                active.edges = Some(Edges {
                    pair,
                    material_edge: m1 - m0,
                    ea: a1 - a0,
                    eb: b1 - b0,
                });
                visit(active, &closest);
            }
        }
    }

    /// Energy of all contacts, J; infinite where a pair touches.
    pub(super) fn energy(&mut self, state: &ContactState<'_>) -> f64 {
        let (barrier, mut energy) = (state.obstacle.barrier, 0.0);
        self.for_each_active(state, |pair, closest| {
            let scale = pair.weight * barrier.d_hat * pair.mollifier_value();
            if scale > 0.0 {
                energy += scale * barrier.value_squared(closest.squared);
            }
        });
        energy
    }

    /// Finds the active contacts.
    pub(super) fn update(&mut self, state: &ContactState<'_>) {
        let mut contacts = std::mem::take(&mut self.contacts);
        let mut rotations = std::mem::take(&mut self.mollifier_rotations);
        contacts.clear();
        rotations.clear();
        let barrier = state.obstacle.barrier;
        self.for_each_active(state, |pair, closest| {
            let scale = pair.weight * barrier.d_hat;
            let derivatives = barrier.squared(closest.squared);
            let mollifier = pair.mollifier();
            let factor = mollifier.as_ref().map_or(1.0, |m| m.value);
            if let (Some(mollifier), Some(edges)) = (mollifier, pair.edges) {
                rotations.push(edges.rotation(&mollifier, scale * derivatives.value));
            }
            let distance = closest.distance();
            let linear = derivatives.to_linear(closest.squared);
            contacts.push(Contact {
                stencil: pair.stencil,
                normal: pair.offset / distance,
                distance,
                first: scale * factor * linear.first,
                second: scale * factor * linear.second,
                is_mollified: mollifier.is_some(),
            });
        });
        self.contacts = contacts;
        self.mollifier_rotations = rotations;
    }

    /// Lags the friction of the coming step from the active contacts.
    pub(super) fn lag_friction(&mut self, mu: f64, epsilon: f64) {
        self.friction_contacts.clear();
        if mu <= 0.0 {
            return;
        }
        let contacts = self.contacts.iter().filter(|c| !c.is_mollified);
        self.friction_contacts
            .extend(contacts.map(|contact| FrictionContact {
                stencil: contact.stencil,
                friction: Friction {
                    normal: contact.normal,
                    limit: -mu * contact.first,
                    epsilon,
                },
            }));
    }

    /// Friction potential since the start of the step, J.
    pub(super) fn friction_energy(&self, state: &ContactState<'_>) -> f64 {
        let energy = |c: &FrictionContact| c.friction.value(c.stencil.slip(state));
        self.friction_contacts.iter().map(energy).sum()
    }

    /// Adds the gradients of contact and friction, N; [`GelContact::update`] comes first.
    pub(super) fn add_gradient(
        &self,
        state: &ContactState<'_>,
        gel: &mut [DVec3],
        object: &mut GeneralisedForce,
    ) {
        for contact in &self.contacts {
            let gradient = contact.normal * contact.first;
            contact.stencil.add_gradient(gradient, gel, object);
        }
        for rotation in &self.mollifier_rotations {
            let [a, b] = rotation.gradient;
            gel[rotation.nodes[1] as usize] += a;
            gel[rotation.nodes[0] as usize] -= a;
            object.add_edge(b, rotation.material_edge);
        }
        for FrictionContact { stencil, friction } in &self.friction_contacts {
            stencil.add_gradient(friction.gradient(stencil.slip(state)), gel, object);
        }
    }

    /// Adds a positive semidefinite stiffness, N/m: of contacts along the normal, of mollified
    /// edges by Gauss-Newton, and of friction.
    pub(super) fn add_hessian(
        &self,
        state: &ContactState<'_>,
        pattern: &StiffnessPattern,
        values: &mut [f64],
        coupling: &mut Coupling,
    ) {
        for contact in &self.contacts {
            let hessian = outer(contact.normal * contact.second.max(0.0), contact.normal);
            contact
                .stencil
                .add_hessian(&hessian, pattern, values, coupling);
        }
        for rotation in &self.mollifier_rotations {
            rotation.add_hessian(pattern, values, coupling);
        }
        for FrictionContact { stencil, friction } in &self.friction_contacts {
            let hessian = friction.hessian(stencil.slip(state));
            stencil.add_hessian(&hessian, pattern, values, coupling);
        }
    }

    /// Mean distance of the active contacts, weighted by their forces, m.
    pub(super) fn mean_gap(&self) -> Option<f64> {
        let sums = self.contacts.iter().fold((0.0, 0.0), |(force, moment), c| {
            (force - c.first, moment - c.first * c.distance)
        });
        (sums.0 > 0.0).then(|| sums.1 / sums.0)
    }

    /// Smallest distance of the active contacts, m.
    pub(super) fn min_gap(&self) -> Option<f64> {
        self.contacts.iter().map(|c| c.distance).reduce(f64::min)
    }
}

/// A pair closer than `d_hat`.
struct ActivePair<'a> {
    stencil: Stencil,
    /// From the object to the gel, m.
    offset: DVec3,
    weight: f64,
    edges: Option<Edges<'a>>,
}

impl ActivePair<'_> {
    fn new(stencil: Stencil, offset: DVec3, weight: f64) -> Self {
        Self {
            stencil,
            offset,
            weight,
            edges: None,
        }
    }

    fn mollifier_value(&self) -> f64 {
        self.edges.as_ref().map_or(1.0, |edges| {
            mollifier::value(edges.ea, edges.eb, edges.pair.mollifier_threshold)
        })
    }

    /// The mollifier of an edge pair where it is below one.
    fn mollifier(&self) -> Option<Mollifier> {
        let edges = self.edges.as_ref()?;
        let mollifier = mollifier::mollifier(edges.ea, edges.eb, edges.pair.mollifier_threshold);
        (!mollifier.is_one()).then_some(mollifier)
    }
}

#[derive(Clone, Copy)]
struct Edges<'a> {
    pair: &'a EdgeEdge,
    material_edge: DVec3,
    ea: DVec3,
    eb: DVec3,
}

impl Edges<'_> {
    fn rotation(&self, mollifier: &Mollifier, energy: f64) -> MollifierRotation {
        // m = 2 c/eps - (c/eps)^2 with c = |ea x eb|^2, so dm/dc = 2 (1 - c/eps) / eps.
        let epsilon = self.pair.mollifier_threshold;
        let ratio = self.ea.cross(self.eb).length_squared() / epsilon;
        MollifierRotation {
            nodes: self.pair.nodes,
            material_edge: self.material_edge,
            ea: self.ea,
            eb: self.eb,
            gradient: [
                mollifier.gradient_ea * energy,
                mollifier.gradient_eb * energy,
            ],
            coefficient: 2.0 * energy * 2.0 * (1.0 - ratio).max(0.0) / epsilon,
        }
    }
}

impl MollifierRotation {
    /// Gauss-Newton in `ea x eb` without the terms between gel and object, which leaves a positive
    /// semidefinite matrix.
    fn add_hessian(&self, pattern: &StiffnessPattern, values: &mut [f64], coupling: &mut Coupling) {
        let [i, j] = self.nodes.map(|node| node as usize);
        let gel = cross_product_hessian(self.eb, self.coefficient);
        pattern.add_diagonal_block(i, &gel, values);
        pattern.add_diagonal_block(j, &gel, values);
        pattern.add_pair_block(i, j, &-gel, values);
        let object = cross_product_hessian(self.ea, self.coefficient);
        coupling.object.add_edge_block(&object, self.material_edge);
    }
}

/// `coefficient (|e|^2 I - e e^T)`.
fn cross_product_hessian(e: DVec3, coefficient: f64) -> DMat3 {
    let identity = DMat3::from_diagonal(DVec3::splat(e.length_squared()));
    (identity - outer(e, e)) * coefficient
}

#[path = "node_contact.rs"]
mod node_contact;
pub use node_contact::NodeContact;

#[cfg(test)]
#[path = "gel_contact_probe.rs"]
mod probe;
