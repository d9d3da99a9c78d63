//! The contact phases of a gel's Newton iteration one by one, for benchmarks. A step runs them
//! together, on state that nobody else should see.

use glam::DVec3;

use super::ccd;
use super::collider::Collider;
use super::coupling::{Coupling, GeneralisedForce};
use super::gel::GelMaterial;
use super::gel_contact::{GelContact, Situation};
use super::parameters::SolverParameters;
use crate::affine::AffineState;
use crate::contact::barrier::Barrier;
use crate::fem::{Elastic, GelGrid, NeoHookean, Surface};
use gripcast_base::error::Result;

/// A gel about to move along a resting object, without friction.
#[derive(Debug)]
pub struct GelPhases {
    surface: Surface,
    elastic: Elastic,
    rest: Vec<DVec3>,
    x: Vec<DVec3>,
    object: AffineState,
    barrier: Barrier,
    parameters: SolverParameters,
    contact: GelContact,
    gradient: Vec<DVec3>,
    values: Vec<f64>,
    coupling: Coupling,
    motion: Vec<f64>,
    direction: Vec<f64>,
}

impl GelPhases {
    /// A gel of nodes with positions at rest and now (m), before `motion` of all nodes.
    ///
    /// # Errors
    /// `Input` for a grid with an inverted tetrahedron.
    pub fn new(
        grid: &GelGrid,
        (rest, x): (Vec<DVec3>, Vec<DVec3>),
        motion: DVec3,
        object: AffineState,
        parameters: SolverParameters,
    ) -> Result<Self> {
        let material = GelMaterial::default();
        let law = NeoHookean::new(material.young_pa, material.poisson)?;
        let elastic = Elastic::new(grid.positions(), grid.tets(), law)?;
        let nodes = x.len();
        Ok(Self {
            surface: grid.contact_surface().clone(),
            values: elastic.pattern().zeros(),
            elastic,
            rest,
            x,
            object,
            barrier: parameters.barrier(),
            parameters,
            contact: GelContact::new(nodes),
            gradient: vec![DVec3::ZERO; nodes],
            coupling: Coupling::default(),
            motion: vec![0.0; nodes],
            direction: motion.to_array().repeat(nodes),
        })
    }

    /// The surface that can touch.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Positions of all nodes at rest and now, m.
    pub fn positions(&self) -> [&[DVec3]; 2] {
        [&self.rest, &self.x]
    }

    /// Number of candidate pairs.
    pub fn candidates(&self) -> usize {
        let pairs = &self.contact.candidates;
        pairs.node_triangles.len() + pairs.vertex_triangles.len() + pairs.edge_edges.len()
    }

    /// The active contacts: whether it is one of two edges, and the distance, m.
    pub fn contacts(&self) -> impl Iterator<Item = (bool, f64)> + '_ {
        let contacts = self.contact.contacts.iter();
        contacts.map(|contact| (contact.stencil.count == 2, contact.distance))
    }

    /// Gathers the candidates.
    pub fn gather(&mut self, collider: &Collider) {
        let limits = (self.parameters.d_hat_m, self.parameters.candidate_margin_m);
        let (rest, x) = (&self.rest, &self.x);
        let candidates = &mut self.contact.candidates;
        candidates.gather(&self.surface, rest, x, &self.object, collider, limits);
    }

    /// Notes how far the nodes have moved since the candidates were gathered.
    fn moved(&mut self) -> (&mut GelContact, Situation<'_>) {
        let GelContact {
            candidates, moved, ..
        } = &mut self.contact;
        candidates.moved(&self.surface, &self.x, &self.object, moved);
        let now = Situation {
            barrier: &self.barrier,
            x: &self.x,
            object: &self.object,
        };
        (&mut self.contact, now)
    }

    /// Finds the active contacts among the candidates, with their derivatives.
    pub fn find(&mut self) {
        let (contact, now) = self.moved();
        contact.update(&now);
    }

    /// Energy (J) as a trial of the line search needs it: distances of all near candidates again.
    pub fn energy(&mut self) -> f64 {
        let (contact, now) = self.moved();
        contact.energy(&now)
    }

    /// Gradient on the nodes, N; also computes that on the object's 12 unknowns.
    pub fn gradient(&mut self) -> &[DVec3] {
        let mut on_object = GeneralisedForce::default();
        self.gradient.fill(DVec3::ZERO);
        let (x, object) = (&self.x, &self.object);
        let now = Situation {
            barrier: &self.barrier,
            x,
            object,
        };
        let contact = &self.contact;
        contact.add_gradient(&now, x, object, &mut self.gradient, &mut on_object);
        std::hint::black_box(on_object);
        &self.gradient
    }

    /// Positive semidefinite stiffness, assembled into the gel's sparse matrix, the coupling rows
    /// and the object's block.
    pub fn hessian(&mut self) {
        self.values.fill(0.0);
        self.coupling.clear(3 * self.x.len());
        let (x, object) = (&self.x, &self.object);
        let now = Situation {
            barrier: &self.barrier,
            x,
            object,
        };
        let pattern = self.elastic.pattern();
        let (values, coupling) = (&mut self.values, &mut self.coupling);
        self.contact
            .add_hessian(&now, x, object, pattern, values, coupling);
    }

    /// Largest fraction of the motion that is free of contact.
    pub fn free_fraction(&mut self) -> f64 {
        self.moved();
        let still = AffineState::from_array(&[0.0; 12]);
        let (x, direction, object) = (&self.x, &self.direction, &self.object);
        let motion = &mut self.motion;
        ccd::relative_motion(&self.surface, x, direction, object, &still, motion);
        let limits = (1.0, self.parameters.ccd_slack);
        ccd::free_fraction(&self.contact, x, direction, object, &still, motion, limits)
    }
}
