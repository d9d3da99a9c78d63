//! One gel in a time step: energy, gradient, stiffness and factorisation.

use glam::DVec3;

use super::ccd;
use super::collider::Collider;
use super::coupling::{Coupling, GeneralisedForce, OBJECT_DOF};
use super::gel_contact::{ContactState, GelContact, Obstacle};
use super::gel_factor::{GelFactor, NotPositiveDefinite};
use super::parameters::SolverParameters;
use crate::affine::AffineState;
use crate::fem::{Elastic, GelGrid, NeoHookean, Projection, Surface};
use gripcast_base::error::{Error, Result};

/// Longest motion of a node relative to the object in one iteration, m: bounds the candidates
/// that collision detection has to consider.
const MAX_NODE_MOTION_M: f64 = 2e-3;

/// Boundary drive: the penalty springs that move the back face of a gel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
    /// Stiffness per back area, N/m³: the same for every mesh.
    PerArea(f64),
    /// Stiffness `weight m_i / dt²` for the nodal mass m_i, as in Taccel: softens as the mesh is
    /// refined. The paper's weight is 5e4.
    PerMass(f64),
}

impl Default for Drive {
    fn default() -> Self {
        Self::PerArea(5e9)
    }
}

/// Material of a gel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GelMaterial {
    /// Young's modulus, Pa.
    pub young_pa: f64,
    /// Poisson's ratio.
    pub poisson: f64,
    /// Density, kg/m³.
    pub density_kg_m3: f64,
}

impl Default for GelMaterial {
    /// The paper's gel; 1000 kg/m³.
    fn default() -> Self {
        Self {
            young_pa: 1e6,
            poisson: 0.3,
            density_kg_m3: 1000.0,
        }
    }
}

/// A spring between a node and a fixed world position, with one stiffness per world axis.
#[derive(Clone, Copy, Debug)]
struct SpringConstraint {
    node: u32,
    anchor: DVec3,
    /// N/m.
    stiffness: DVec3,
}

/// A gel: a tetrahedral pad whose back face is driven.
#[derive(Debug)]
pub struct Gel {
    elastic: Elastic,
    surface: Surface,
    rest: Vec<DVec3>,
    driven: Vec<u32>,
    drive: Vec<f64>,
    spring_constraints: Vec<SpringConstraint>,
    /// Lumped mass over dt² of the nodes that are not driven, else 0.
    inertia: Vec<f64>,
    pub(super) x: Vec<DVec3>,
    /// Positions at the start of the step, m.
    pub(super) start: Vec<DVec3>,
    pub(super) velocity: Vec<DVec3>,
    /// Positions that inertia alone would lead to, m.
    predicted: Vec<DVec3>,
    /// Drive target of each driven node, m.
    pub(super) target: Vec<DVec3>,
    line_origin: Vec<DVec3>,
    pub(super) contact: GelContact,
    contact_gradient: Vec<DVec3>,
    gradient: Vec<DVec3>,
    pub(super) object_gradient: GeneralisedForce,
    factor: GelFactor,
    stiffness: Vec<f64>,
    coupling: Coupling,
    /// `L⁻¹ P B` of the coupling B, and the same in single precision.
    schur_rhs: Vec<[f64; OBJECT_DOF]>,
    schur_rhs_f32: Vec<[f32; OBJECT_DOF]>,
    permuted: Vec<f32>,
    scratch: Vec<f32>,
    scratch_many: Vec<[f64; OBJECT_DOF]>,
    /// Bound of each node's motion relative to the object over a whole step, m.
    motion_bounds: Vec<f64>,
    step: Vec<DVec3>,
}

impl Gel {
    /// Builds a pad at rest; `to_world` maps the node positions of `grid` into the world, m.
    ///
    /// # Errors
    /// `Config` or `Input` where the material, the drive or the grid is out of range.
    pub fn new(
        grid: &GelGrid,
        material: &GelMaterial,
        drive: Drive,
        parameters: &SolverParameters,
        to_world: impl Fn(DVec3) -> DVec3,
    ) -> Result<Self> {
        let law = NeoHookean::new(material.young_pa, material.poisson)?;
        let elastic = Elastic::new(grid.positions(), grid.tets(), law)?;
        let masses = grid.lumped_masses(material.density_kg_m3)?;
        let dt = parameters.dt_s;
        let driven = grid.driven().to_vec();
        let drive: Vec<f64> = driven
            .iter()
            .zip(grid.driven_areas())
            .map(|(&node, &area)| match drive {
                Drive::PerArea(stiffness) => stiffness * area,
                Drive::PerMass(weight) => weight * masses[node as usize] / (dt * dt),
            })
            .collect();
        if let Some(bad) = drive.iter().find(|k| !(k.is_finite() && **k > 0.0)) {
            return Err(Error::config(format!(
                "the drive stiffness must be above 0, found {bad} N/m at a node"
            )));
        }
        let mut inertia: Vec<f64> = masses.iter().map(|m| m / (dt * dt)).collect();
        for &node in &driven {
            inertia[node as usize] = 0.0;
        }
        let pattern = elastic.pattern();
        let factor = GelFactor::new(pattern.column_starts(), pattern.rows())?;
        let stiffness = pattern.zeros();
        let x: Vec<DVec3> = grid.positions().iter().map(|&p| to_world(p)).collect();
        let n = x.len();
        Ok(Self {
            surface: grid.contact_surface().clone(),
            rest: grid.positions().to_vec(),
            target: driven.iter().map(|&node| x[node as usize]).collect(),
            driven,
            drive,
            spring_constraints: Vec::new(),
            inertia,
            start: x.clone(),
            predicted: x.clone(),
            line_origin: x.clone(),
            velocity: vec![DVec3::ZERO; n],
            contact_gradient: vec![DVec3::ZERO; n],
            gradient: vec![DVec3::ZERO; n],
            object_gradient: GeneralisedForce::default(),
            contact: GelContact::new(n),
            coupling: Coupling::default(),
            schur_rhs: Vec::new(),
            schur_rhs_f32: Vec::new(),
            permuted: vec![0.0; 3 * n],
            scratch: Vec::new(),
            scratch_many: Vec::new(),
            motion_bounds: vec![0.0; n],
            step: Vec::new(),
            x,
            elastic,
            factor,
            stiffness,
        })
    }

    /// Ties nodes to their current positions by springs, N/m per world axis. A stiff spring along
    /// one axis and none along the others makes a plane of symmetry.
    #[must_use]
    pub fn with_spring_constraints(
        mut self,
        nodes: impl IntoIterator<Item = u32>,
        stiffness: DVec3,
    ) -> Self {
        let x = &self.x;
        self.spring_constraints
            .extend(nodes.into_iter().map(|node| SpringConstraint {
                node,
                anchor: x[node as usize],
                stiffness,
            }));
        self
    }

    /// Replaces the surface that can touch the object, by default front and sides.
    #[must_use]
    pub fn with_contact_surface(mut self, surface: Surface) -> Self {
        self.surface = surface;
        self
    }

    /// Positions of all nodes in the world, m.
    pub fn positions(&self) -> &[DVec3] {
        &self.x
    }

    /// Positions of all nodes at rest in the pad's own frame, m.
    pub fn rest(&self) -> &[DVec3] {
        &self.rest
    }

    /// Nodes of the driven back face.
    pub fn driven(&self) -> &[u32] {
        &self.driven
    }

    /// Drive stiffness of each of [`Gel::driven`], N/m.
    pub fn drive_stiffness(&self) -> &[f64] {
        &self.drive
    }

    /// Surface that can touch the object.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Force of contact and friction on each node, N.
    pub fn contact_forces(&self) -> impl ExactSizeIterator<Item = DVec3> + '_ {
        self.contact_gradient.iter().map(|gradient| -*gradient)
    }

    /// Smallest distance among the active contacts (closer than `d_hat`), m.
    pub fn min_gap(&self) -> Option<f64> {
        self.contact.min_gap()
    }

    /// Mean distance of the active contacts, weighted by their forces, m.
    pub fn mean_gap(&self) -> Option<f64> {
        self.contact.mean_gap()
    }

    /// Number of active contacts (closer than `d_hat`).
    pub fn contacts(&self) -> usize {
        self.contact.contacts.len()
    }

    /// Moves the drive targets, m.
    pub fn move_target(&mut self, by: DVec3) {
        for target in &mut self.target {
            *target += by;
        }
    }

    /// Translates the gel and its drive rigidly over one time step without contact.
    pub(super) fn translate_free(&mut self, by: DVec3, dt: f64) {
        self.move_target(by);
        self.start.clone_from(&self.x);
        self.translate(by);
        self.velocity.fill(by / dt);
        self.contact_gradient.fill(DVec3::ZERO);
    }

    pub(super) fn unknowns(&self) -> usize {
        3 * self.x.len()
    }

    pub(super) fn begin_step(&mut self, dt: f64) {
        self.start.clone_from(&self.x);
        for ((predicted, x), v) in self.predicted.iter_mut().zip(&self.x).zip(&self.velocity) {
            *predicted = *x + *v * dt;
        }
    }

    pub(super) fn end_step(&mut self, dt: f64) {
        for ((v, x), start) in self.velocity.iter_mut().zip(&self.x).zip(&self.start) {
            *v = (*x - *start) / dt;
        }
    }

    pub(super) fn translate(&mut self, by: DVec3) {
        for x in &mut self.x {
            *x += by;
        }
    }

    /// Lower bound of the distance to the object, m; candidates must cover the current positions.
    pub(super) fn clearance(&mut self, object: &AffineState, d_hat: f64) -> f64 {
        let moved = self.update_displacements(object);
        self.contact.candidates.min_build_distance(d_hat) - moved
    }

    /// Rebuilds the candidates unless they cover the current positions; whether it did.
    pub(super) fn ensure_candidates(
        &mut self,
        object: &AffineState,
        collider: &Collider,
        parameters: &SolverParameters,
    ) -> bool {
        if self.contact.candidates.is_built() {
            let moved = self.update_displacements(object);
            if self.contact.candidates.covers(moved) {
                return false;
            }
        }
        self.rebuild_candidates(object, collider, parameters, parameters.candidate_margin_m);
        true
    }

    /// Updates the nodes' displacements since the last build; the largest, m.
    fn update_displacements(&mut self, object: &AffineState) -> f64 {
        self.contact
            .update_displacements(&self.surface, &self.x, object)
    }

    fn rebuild_candidates(
        &mut self,
        object: &AffineState,
        collider: &Collider,
        parameters: &SolverParameters,
        margin: f64,
    ) {
        let limits = (parameters.d_hat_m, margin);
        self.contact
            .candidates
            .build(&self.surface, &self.rest, &self.x, object, collider, limits);
        self.contact.displacements.fill(0.0);
    }

    /// Finds the active contacts; candidates must cover the current positions.
    pub(super) fn find_contacts(&mut self, obstacle: Obstacle<'_>) {
        self.update_displacements(obstacle.now);
        self.contact.update(&ContactState {
            obstacle,
            x: &self.x,
            start: &self.start,
        });
    }

    /// Energy without contact at the current positions, J; infinite where an element is inverted.
    fn body_energy(&self) -> f64 {
        let elastic = self.elastic.energy(&self.x);
        if !elastic.is_finite() {
            return f64::INFINITY;
        }
        let mut energy = 0.0;
        for ((x, predicted), inertia) in self.x.iter().zip(&self.predicted).zip(&self.inertia) {
            energy += 0.5 * inertia * (*x - *predicted).length_squared();
        }
        let springs = self.driven.iter().zip(&self.drive).zip(&self.target);
        for ((&node, stiffness), target) in springs {
            energy += 0.5 * stiffness * (self.x[node as usize] - *target).length_squared();
        }
        for spring in &self.spring_constraints {
            let offset = self.x[spring.node as usize] - spring.anchor;
            energy += 0.5 * offset.dot(spring.stiffness * offset);
        }
        energy + elastic
    }

    /// Energy at the current positions, J.
    pub(super) fn energy(&mut self, obstacle: Obstacle<'_>) -> f64 {
        let body = self.body_energy();
        if !body.is_finite() {
            return body;
        }
        self.update_displacements(obstacle.now);
        let state = ContactState {
            obstacle,
            x: &self.x,
            start: &self.start,
        };
        let contact = self.contact.energy(&state);
        body + contact + self.contact.friction_energy(&state)
    }

    /// Moves to the line origin plus `step_size` times `direction`.
    pub(super) fn set_step(&mut self, direction: &[f64], step_size: f64) {
        let origins = self.line_origin.iter().zip(direction.chunks_exact(3));
        for (x, (origin, d)) in self.x.iter_mut().zip(origins) {
            *x = *origin + DVec3::new(d[0], d[1], d[2]) * step_size;
        }
    }

    pub(super) fn store_line_origin(&mut self) {
        self.line_origin.clone_from(&self.x);
    }

    /// Writes the gradient at the current positions into `flat`; contacts must be up to date.
    pub(super) fn write_gradient(&mut self, obstacle: Obstacle<'_>, flat: &mut [f64]) {
        self.contact_gradient.fill(DVec3::ZERO);
        self.object_gradient = GeneralisedForce::default();
        let state = ContactState {
            obstacle,
            x: &self.x,
            start: &self.start,
        };
        self.contact.add_gradient(
            &state,
            &mut self.contact_gradient,
            &mut self.object_gradient,
        );
        self.gradient.clone_from(&self.contact_gradient);
        self.elastic.gradient(&self.x, &mut self.gradient);
        let nodes = self.gradient.iter_mut().zip(&self.x);
        for ((g, x), (predicted, inertia)) in nodes.zip(self.predicted.iter().zip(&self.inertia)) {
            *g += (*x - *predicted) * *inertia;
        }
        let springs = self.driven.iter().zip(&self.drive).zip(&self.target);
        for ((&node, stiffness), target) in springs {
            let node = node as usize;
            self.gradient[node] += (self.x[node] - *target) * *stiffness;
        }
        for spring in &self.spring_constraints {
            let node = spring.node as usize;
            self.gradient[node] += (self.x[node] - spring.anchor) * spring.stiffness;
        }
        for (flat, g) in flat.chunks_exact_mut(3).zip(&self.gradient) {
            flat.copy_from_slice(&g.to_array());
        }
    }

    /// Assembles and factorises the stiffness at the current positions and computes the right-hand
    /// sides of the Schur complement.
    pub(super) fn factorise(
        &mut self,
        obstacle: Obstacle<'_>,
        projection: Projection,
    ) -> std::result::Result<(), NotPositiveDefinite> {
        self.stiffness.fill(0.0);
        self.elastic
            .hessian(&self.x, projection, &mut self.stiffness);
        let pattern = self.elastic.pattern();
        for (node, &inertia) in self.inertia.iter().enumerate() {
            pattern.add_diagonal(node, [inertia; 3], &mut self.stiffness);
        }
        for (&node, &stiffness) in self.driven.iter().zip(&self.drive) {
            pattern.add_diagonal(node as usize, [stiffness; 3], &mut self.stiffness);
        }
        for spring in &self.spring_constraints {
            let (node, stiffness) = (spring.node as usize, spring.stiffness.to_array());
            pattern.add_diagonal(node, stiffness, &mut self.stiffness);
        }
        self.coupling.clear(3 * self.x.len());
        let state = ContactState {
            obstacle,
            x: &self.x,
            start: &self.start,
        };
        self.contact
            .add_hessian(&state, pattern, &mut self.stiffness, &mut self.coupling);
        self.factor.factorize(&self.stiffness)?;
        self.schur_rhs.clear();
        let rows = &self.coupling.rows;
        self.schur_rhs
            .extend(self.factor.permutation().iter().map(|&row| rows[row]));
        self.factor
            .forward_substitute_many(&mut self.schur_rhs, &mut self.scratch_many);
        self.schur_rhs_f32.clear();
        self.schur_rhs_f32
            .extend(self.schur_rhs.iter().map(|w| w.map(|value| value as f32)));
        Ok(())
    }

    /// Adds this gel's part of the Schur complement on the object's unknowns.
    pub(super) fn add_schur(&self, schur: &mut [[f64; OBJECT_DOF]; OBJECT_DOF]) {
        for (row, own) in schur.iter_mut().zip(&self.coupling.object.0) {
            for (a, b) in row.iter_mut().zip(own) {
                *a += b;
            }
        }
        for w in &self.schur_rhs {
            for (row, wi) in schur.iter_mut().zip(w) {
                for (value, wj) in row.iter_mut().zip(w) {
                    *value -= wi * wj;
                }
            }
        }
    }

    /// First half of a solve: forward substitution of the right-hand side `flat`. Returns what it
    /// takes from the object's right-hand side.
    pub(super) fn forward_substitute(&mut self, flat: &[f64]) -> [f64; OBJECT_DOF] {
        self.factor.permute(flat, &mut self.permuted);
        self.factor
            .forward_substitute(&mut self.permuted, &mut self.scratch);
        pulp::Arch::new().dispatch(|| {
            let mut eliminated = [0.0; OBJECT_DOF];
            for (w, value) in self.schur_rhs_f32.iter().zip(&self.permuted) {
                for (eliminated, w) in eliminated.iter_mut().zip(w) {
                    *eliminated += f64::from(w * value);
                }
            }
            eliminated
        })
    }

    /// Second half: back substitution with the solved unknowns of the object, into `flat`.
    pub(super) fn back_substitute(&mut self, object: &[f64; OBJECT_DOF], flat: &mut [f64]) {
        let object = object.map(|value| value as f32);
        pulp::Arch::new().dispatch(|| {
            for (w, value) in self.schur_rhs_f32.iter().zip(&mut self.permuted) {
                let mut sum = 0.0;
                for (w, q) in w.iter().zip(&object) {
                    sum += w * q;
                }
                *value -= sum;
            }
        });
        self.factor
            .back_substitute(&mut self.permuted, &mut self.scratch);
        self.factor.unpermute(&self.permuted, flat);
    }

    /// Largest step size in (0, 1] without collision with the object. Rebuilds the candidates
    /// where the step exceeds their margin; also returns whether it did.
    pub(super) fn collision_free_step(
        &mut self,
        direction: &[f64],
        object: &AffineState,
        object_direction: &AffineState,
        collider: &Collider,
        parameters: &SolverParameters,
    ) -> (f64, bool) {
        let displacement = self.update_displacements(object);
        let motion = ccd::Motion {
            direction,
            object,
            object_direction,
        };
        let longest = motion.bound(&self.surface, &self.x, &mut self.motion_bounds);
        let max_step = (MAX_NODE_MOTION_M / longest).min(1.0);
        let reach = longest * max_step;
        let is_rebuilt = !self.contact.candidates.covers(displacement + reach);
        if is_rebuilt {
            let margin = parameters.candidate_margin_m.max(1.02 * reach);
            self.rebuild_candidates(object, collider, parameters, margin);
        }
        let (bounds, slack) = (&self.motion_bounds, parameters.ccd_slack);
        let step = motion.collision_free_step(&self.contact, &self.x, bounds, max_step, slack);
        (step, is_rebuilt)
    }

    /// Largest step size in (0, 1] before an element inverts.
    pub(super) fn inversion_free_step(&mut self, direction: &[f64]) -> f64 {
        self.step.clear();
        self.step
            .extend(direction.chunks_exact(3).map(DVec3::from_slice));
        self.elastic.inversion_free_step(&self.x, &self.step)
    }
}

#[cfg(feature = "bench")]
#[path = "gel_phases.rs"]
mod phases;
#[cfg(feature = "bench")]
pub use phases::GelPhases;

#[cfg(test)]
#[path = "gel_probe.rs"]
mod probe;
