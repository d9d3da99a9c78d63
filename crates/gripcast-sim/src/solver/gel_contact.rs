//! Contact of one gel with the object: energy, forces, stiffness.
//!
//! A contact joins up to three gel nodes with one material point of the object. With the weights
//! of the closest points the relative displacement is `u = Σ w_i dx_i - (dp + dA X)`, and every
//! term here is a scalar or 3x3 function of u; only mollified edge pairs add a term in the edges'
//! directions.

use glam::{DMat3, DVec3};

use super::candidates::{Candidates, EdgeEdge, near};
use super::coupling::{Coupling, GeneralisedForce};
use crate::affine::AffineState;
use crate::contact::barrier::Barrier;
use crate::contact::distance::{Closest, edge_edge, point_triangle};
use crate::contact::friction::Friction;
use crate::contact::mollifier::{self, Mollifier};
use crate::fem::StiffnessPattern;

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

    /// Displacement of the gel's point minus that of the object's since the step's start.
    #[inline]
    fn slip(
        &self,
        x: &[DVec3],
        start: &[DVec3],
        object: &AffineState,
        from: &AffineState,
    ) -> DVec3 {
        let gel: DVec3 = self.gel().map(|(i, w)| (x[i] - start[i]) * w).sum();
        gel - (object.point(self.material) - from.point(self.material))
    }

    /// Adds a force gradient (N, with respect to u).
    #[inline]
    fn add_gradient(&self, gradient: DVec3, gel: &mut [DVec3], object: &mut GeneralisedForce) {
        for (i, w) in self.gel() {
            gel[i] += gradient * w;
        }
        object.add(-gradient, self.material);
    }

    /// Adds a stiffness (N/m, with respect to u).
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

/// The part of a mollified edge pair's energy that acts on the edges' directions.
#[derive(Clone, Copy, Debug)]
struct Turning {
    nodes: [u32; 2],
    /// Edge of the object in the material frame and in the world.
    material_edge: DVec3,
    ea: DVec3,
    eb: DVec3,
    /// Gradient of the energy with respect to both edge vectors, N.
    gradient: [DVec3; 2],
    /// Coefficient of the Gauss-Newton stiffness.
    coefficient: f64,
}

/// A contact whose friction is lagged from the start of the step.
#[derive(Clone, Copy, Debug)]
struct Rubbing {
    stencil: Stencil,
    friction: Friction,
}

/// What contact reads of the moment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Situation<'a> {
    pub(super) barrier: &'a Barrier,
    pub(super) x: &'a [DVec3],
    pub(super) object: &'a AffineState,
}

/// Contact state of one gel.
#[derive(Clone, Debug, Default)]
pub(super) struct GelContact {
    pub(super) candidates: Candidates,
    pub(super) contacts: Vec<Contact>,
    turning: Vec<Turning>,
    rubbing: Vec<Rubbing>,
    /// World positions of the candidates' object vertices.
    world: Vec<DVec3>,
    /// Motion of the nodes in the object's frame since the candidates were gathered, m.
    pub(super) moved: Vec<f64>,
}

impl GelContact {
    /// For a gel of `nodes` nodes.
    pub(super) fn new(nodes: usize) -> Self {
        Self {
            moved: vec![0.0; nodes],
            ..Self::default()
        }
    }

    fn place(&mut self, object: &AffineState) {
        self.world.clear();
        let material = self.candidates.material.iter();
        self.world.extend(material.map(|&m| object.point(m)));
    }

    fn largest_move(&self, nodes: &[u32]) -> f64 {
        nodes
            .iter()
            .fold(0.0, |largest, &node| self.moved[node as usize].max(largest))
    }

    /// Calls `visit` with each pair nearer than `d_hat`. `self.moved` must be of this moment.
    #[inline]
    fn for_each_near(&mut self, now: &Situation<'_>, mut visit: impl FnMut(Pair<'_>, &Closest)) {
        self.place(now.object);
        let (x, d_hat) = (now.x, now.barrier.d_hat);
        let limit = now.barrier.d_hat_squared();
        let corner = |v: u32| self.world[v as usize];
        for pair in &self.candidates.node_triangles {
            if pair.gathered > d_hat + self.moved[pair.node as usize] {
                continue;
            }
            let [a, b, c] = pair.triangle.map(corner);
            if let Some(closest) = near(point_triangle(x[pair.node as usize], a, b, c), limit) {
                let [_, wa, wb, wc] = closest.weights;
                let [ma, mb, mc] = pair.triangle.map(|v| self.candidates.material[v as usize]);
                let stencil = Stencil {
                    nodes: [pair.node, 0, 0],
                    weights: [1.0, 0.0, 0.0],
                    count: 1,
                    material: -(ma * wa + mb * wb + mc * wc),
                };
                visit(Pair::plain(stencil, closest.offset, pair.weight), &closest);
            }
        }
        for pair in &self.candidates.vertex_triangles {
            if pair.gathered > d_hat + self.largest_move(&pair.nodes) {
                continue;
            }
            let [a, b, c] = pair.nodes.map(|node| x[node as usize]);
            let vertex = corner(pair.vertex);
            if let Some(closest) = near(point_triangle(vertex, a, b, c), limit) {
                let [_, wa, wb, wc] = closest.weights;
                let stencil = Stencil {
                    nodes: pair.nodes,
                    weights: [-wa, -wb, -wc],
                    count: 3,
                    material: self.candidates.material[pair.vertex as usize],
                };
                visit(Pair::plain(stencil, -closest.offset, pair.weight), &closest);
            }
        }
        for pair in &self.candidates.edge_edges {
            if pair.gathered > d_hat + self.largest_move(&pair.nodes) {
                continue;
            }
            let [a0, a1] = pair.nodes.map(|node| x[node as usize]);
            let [b0, b1] = pair.vertices.map(corner);
            if let Some(closest) = near(edge_edge(a0, a1, b0, b1), limit) {
                let [w0, w1, v0, v1] = closest.weights;
                let [m0, m1] = pair.vertices.map(|v| self.candidates.material[v as usize]);
                let stencil = Stencil {
                    nodes: [pair.nodes[0], pair.nodes[1], 0],
                    weights: [w0, w1, 0.0],
                    count: 2,
                    material: -(m0 * v0 + m1 * v1),
                };
                let edges = Edges {
                    pair,
                    material_edge: m1 - m0,
                    ea: a1 - a0,
                    eb: b1 - b0,
                };
                let mut near = Pair::plain(stencil, closest.offset, pair.weight);
                near.edges = Some(edges);
                visit(near, &closest);
            }
        }
    }

    /// Energy of all contacts, J. Infinite where a pair touches.
    pub(super) fn energy(&mut self, now: &Situation<'_>) -> f64 {
        let (barrier, mut energy) = (now.barrier, 0.0);
        self.for_each_near(now, |pair, closest| {
            let scale = pair.weight * barrier.d_hat * pair.mollification();
            if scale > 0.0 {
                energy += scale * barrier.value_squared(closest.squared);
            }
        });
        energy
    }

    /// Finds the active contacts of the moment.
    pub(super) fn update(&mut self, now: &Situation<'_>) {
        let mut contacts = std::mem::take(&mut self.contacts);
        let mut turning = std::mem::take(&mut self.turning);
        contacts.clear();
        turning.clear();
        let barrier = now.barrier;
        self.for_each_near(now, |pair, closest| {
            let scale = pair.weight * barrier.d_hat;
            let derivatives = barrier.squared(closest.squared);
            let mollifier = pair.mollifier();
            let factor = mollifier.as_ref().map_or(1.0, |m| m.value);
            if let (Some(mollifier), Some(edges)) = (mollifier, pair.edges) {
                turning.push(edges.turning(&mollifier, scale * derivatives.value));
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
        self.turning = turning;
    }

    /// Takes the friction of the coming step from the present contacts.
    pub(super) fn lag_friction(&mut self, mu: f64, epsilon: f64) {
        self.rubbing.clear();
        if mu <= 0.0 {
            return;
        }
        let sticking = self.contacts.iter().filter(|c| !c.is_mollified);
        self.rubbing.extend(sticking.map(|contact| Rubbing {
            stencil: contact.stencil,
            friction: Friction {
                normal: contact.normal,
                limit: -mu * contact.first,
                epsilon,
            },
        }));
    }

    /// Potential of friction since the step's start, J.
    pub(super) fn friction_energy(
        &self,
        now: &Situation<'_>,
        start: &[DVec3],
        from: &AffineState,
    ) -> f64 {
        let slip = |r: &Rubbing| r.stencil.slip(now.x, start, now.object, from);
        self.rubbing.iter().map(|r| r.friction.value(slip(r))).sum()
    }

    /// Adds the gradients of contact and friction; [`GelContact::update`] comes before.
    pub(super) fn add_gradient(
        &self,
        now: &Situation<'_>,
        start: &[DVec3],
        from: &AffineState,
        gel: &mut [DVec3],
        object: &mut GeneralisedForce,
    ) {
        for contact in &self.contacts {
            let gradient = contact.normal * contact.first;
            contact.stencil.add_gradient(gradient, gel, object);
        }
        for turning in &self.turning {
            let [a, b] = turning.gradient;
            gel[turning.nodes[1] as usize] += a;
            gel[turning.nodes[0] as usize] -= a;
            object.add_edge(b, turning.material_edge);
        }
        for rubbing in &self.rubbing {
            let slip = rubbing.stencil.slip(now.x, start, now.object, from);
            let gradient = rubbing.friction.gradient(slip);
            rubbing.stencil.add_gradient(gradient, gel, object);
        }
    }

    /// Adds a positive semidefinite stiffness: of contacts the part along the normal, of
    /// mollified edges the Gauss-Newton part, of friction all.
    pub(super) fn add_hessian(
        &self,
        now: &Situation<'_>,
        start: &[DVec3],
        from: &AffineState,
        pattern: &StiffnessPattern,
        values: &mut [f64],
        coupling: &mut Coupling,
    ) {
        for contact in &self.contacts {
            let n = contact.normal;
            let scaled = n * contact.second.max(0.0);
            let hessian = DMat3::from_cols(scaled * n.x, scaled * n.y, scaled * n.z);
            let stencil = &contact.stencil;
            stencil.add_hessian(&hessian, pattern, values, coupling);
        }
        for turning in &self.turning {
            turning.add_hessian(pattern, values, coupling);
        }
        for rubbing in &self.rubbing {
            let slip = rubbing.stencil.slip(now.x, start, now.object, from);
            let hessian = rubbing.friction.hessian(slip);
            let stencil = &rubbing.stencil;
            stencil.add_hessian(&hessian, pattern, values, coupling);
        }
    }

    /// Mean distance among the active contacts, weighted by their forces, m.
    pub(super) fn mean_gap(&self) -> Option<f64> {
        let sums = self.contacts.iter().fold((0.0, 0.0), |(force, moment), c| {
            (force - c.first, moment - c.first * c.distance)
        });
        (sums.0 > 0.0).then(|| sums.1 / sums.0)
    }

    /// Smallest distance among the active contacts, m.
    pub(super) fn min_gap(&self) -> Option<f64> {
        self.contacts.iter().map(|c| c.distance).reduce(f64::min)
    }
}

/// A near pair.
struct Pair<'a> {
    stencil: Stencil,
    /// From the object to the gel.
    offset: DVec3,
    weight: f64,
    edges: Option<Edges<'a>>,
}

impl Pair<'_> {
    fn plain(stencil: Stencil, offset: DVec3, weight: f64) -> Self {
        Self {
            stencil,
            offset,
            weight,
            edges: None,
        }
    }

    fn mollification(&self) -> f64 {
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
    fn turning(&self, mollifier: &Mollifier, energy: f64) -> Turning {
        // m = 2 c/eps - (c/eps)^2 with c = |ea x eb|^2, so dm/dc = 2 (1 - c/eps) / eps.
        let epsilon = self.pair.mollifier_threshold;
        let ratio = self.ea.cross(self.eb).length_squared() / epsilon;
        Turning {
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

impl Turning {
    /// Gauss-Newton in `ea x eb`, without the terms between gel and object: what is left is
    /// positive semidefinite.
    fn add_hessian(&self, pattern: &StiffnessPattern, values: &mut [f64], coupling: &mut Coupling) {
        let [i, j] = self.nodes.map(|node| node as usize);
        let gel = across(self.eb, self.coefficient);
        pattern.add_diagonal_block(i, &gel, values);
        pattern.add_diagonal_block(j, &gel, values);
        pattern.add_pair_block(i, j, &-gel, values);
        let object = across(self.ea, self.coefficient);
        coupling.object.add_edge_block(&object, self.material_edge);
    }
}

/// `coefficient (|e|^2 I - e e^T)`.
fn across(e: DVec3, coefficient: f64) -> DMat3 {
    let identity = DMat3::from_diagonal(DVec3::splat(e.length_squared()));
    (identity - DMat3::from_cols(e * e.x, e * e.y, e * e.z)) * coefficient
}

#[cfg(test)]
#[path = "gel_contact_probe.rs"]
mod probe;
