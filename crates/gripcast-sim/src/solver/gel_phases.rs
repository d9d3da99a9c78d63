//! Contact phases of a gel's Newton iteration, callable one at a time by benchmarks. A time step
//! runs them together.

use glam::DVec3;

use super::super::ccd::Motion;
use super::{
    AffineState, Collider, ContactState, Gel, GeneralisedForce, Obstacle, SolverParameters, Surface,
};
use crate::contact::barrier::Barrier;

/// A gel about to move along a resting object, without friction.
#[derive(Debug)]
pub struct GelPhases {
    gel: Gel,
    object: AffineState,
    barrier: Barrier,
    parameters: SolverParameters,
    direction: Vec<f64>,
}

impl GelPhases {
    /// A gel deformed to the node positions `x` (m), about to move all nodes by `motion`.
    pub fn new(
        mut gel: Gel,
        x: Vec<DVec3>,
        motion: DVec3,
        object: AffineState,
        parameters: SolverParameters,
    ) -> Self {
        gel.x = x;
        Self {
            direction: motion.to_array().repeat(gel.x.len()),
            gel,
            object,
            barrier: parameters.barrier(),
            parameters,
        }
    }

    /// Surface that can touch the object.
    pub fn surface(&self) -> &Surface {
        &self.gel.surface
    }

    /// Positions of all nodes undeformed and now, m.
    pub fn positions(&self) -> [&[DVec3]; 2] {
        [&self.gel.start, &self.gel.x]
    }

    /// Number of candidate pairs.
    pub fn candidates(&self) -> usize {
        let pairs = &self.gel.contact.candidates;
        pairs.node_triangles.len() + pairs.vertex_triangles.len() + pairs.edge_edges.len()
    }

    /// The active contacts: whether it is an edge pair, and the distance, m.
    pub fn contacts(&self) -> impl Iterator<Item = (bool, f64)> + '_ {
        let contacts = self.gel.contact.contacts.iter();
        contacts.map(|contact| (contact.stencil.count == 2, contact.distance))
    }

    /// Builds the candidates.
    pub fn build_candidates(&mut self, collider: &Collider) {
        let margin = self.parameters.candidate_margin_m;
        self.gel
            .rebuild_candidates(&self.object, collider, &self.parameters, margin);
    }

    /// Finds the active contacts among the candidates, with their derivatives.
    pub fn find_contacts(&mut self) {
        let obstacle = obstacle(&self.object, &self.barrier);
        self.gel.find_contacts(obstacle);
    }

    /// Energy (J) as in a trial of the line search: recomputes the distances of near candidates.
    pub fn energy(&mut self) -> f64 {
        self.gel.update_displacements(&self.object);
        let gel = &mut self.gel;
        gel.contact
            .energy(&state(&gel.x, obstacle(&self.object, &self.barrier)))
    }

    /// Gradient on the nodes, N; also computes that on the object's 12 unknowns.
    pub fn gradient(&mut self) -> &[DVec3] {
        let gel = &mut self.gel;
        let state = state(&gel.x, obstacle(&self.object, &self.barrier));
        gel.contact_gradient.fill(DVec3::ZERO);
        gel.object_gradient = GeneralisedForce::default();
        gel.contact
            .add_gradient(&state, &mut gel.contact_gradient, &mut gel.object_gradient);
        &gel.contact_gradient
    }

    /// Assembles the positive semidefinite stiffness into the gel's sparse matrix, the coupling
    /// rows and the object's block.
    pub fn hessian(&mut self) {
        let gel = &mut self.gel;
        gel.stiffness.fill(0.0);
        gel.coupling.clear(3 * gel.x.len());
        let state = state(&gel.x, obstacle(&self.object, &self.barrier));
        let pattern = gel.elastic.pattern();
        gel.contact
            .add_hessian(&state, pattern, &mut gel.stiffness, &mut gel.coupling);
    }

    /// Largest step size in (0, 1] of the motion without collision.
    pub fn collision_free_step(&mut self) -> f64 {
        let gel = &mut self.gel;
        gel.update_displacements(&self.object);
        let motion = Motion {
            direction: &self.direction,
            object: &self.object,
            object_direction: &AffineState::from_array(&[0.0; 12]),
        };
        let (x, bounds) = (&gel.x, &mut gel.motion_bounds);
        motion.bound(&gel.surface, x, bounds);
        motion.collision_free_step(&gel.contact, x, bounds, 1.0, self.parameters.ccd_slack)
    }
}

/// The resting object.
fn obstacle<'a>(object: &'a AffineState, barrier: &'a Barrier) -> Obstacle<'a> {
    Obstacle {
        barrier,
        now: object,
        start: object,
    }
}

fn state<'a>(x: &'a [DVec3], obstacle: Obstacle<'a>) -> ContactState<'a> {
    ContactState {
        obstacle,
        x,
        start: x,
    }
}
