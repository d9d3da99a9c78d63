//! Gels, object and ground as one system, and its implicit Euler step.
//!
//! With all terms divided by dt² the incremental potential (Li et al. 2020) is, in J,
//! `E(x, q) = ½ |x - x̂|²_M/dt² + Ψ(x) + drive(x) + ½ |q - q̂|²_M/dt² + shape(q) + contact +
//! friction`, and its gradient is a balance of forces in N. A quasi-Newton iteration minimises it:
//! the factorised stiffness is kept over iterations and steps and corrected by L-BFGS.

use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use super::collider::Collider;
use super::coupling::OBJECT_DOF;
use super::gel::Gel;
use super::gel_contact::NodeContact;
use super::gel_factor::NotPositiveDefinite;
use super::lbfgs::{History, dot};
use super::object::Object;
use super::parameters::SolverParameters;
use crate::affine::{AffineState, Cholesky, Matrix12};
use crate::contact::barrier::Barrier;
use crate::fem::Projection;
use gripcast_base::error::Result;

/// Sufficient-decrease constant of the Armijo condition.
const ARMIJO_C1: f64 = 1e-4;
/// An iteration is slow when its step is longer than this fraction of the previous one.
const SLOW_STEP_RATIO: f64 = 0.5;
/// Consecutive slow iterations before the stiffness is refactorised.
const MAX_SLOW_ITERATIONS: u32 = 3;
/// Step sizes tried for the warm start, each half of the one before.
const WARM_START_TRIALS: u32 = 3;
/// Halvings of the line search before the stiffness is refactorised.
const MAX_HALVINGS: u32 = 30;

/// Work of one time step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct StepReport {
    /// Whether the Newton tolerance was met.
    pub converged: bool,
    /// Newton iterations.
    pub iterations: u32,
    /// Assemblies and factorisations of the stiffness.
    pub factorisations: u32,
    /// Halvings of the line search.
    pub halvings: u32,
    /// Rebuilds of the candidate pairs of a gel.
    pub broad_phase_rebuilds: u32,
}

/// Wall time of the solver phases, summed over all steps, s.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct PhaseTimes {
    /// Active contacts, forces and gradient.
    pub gradient_s: f64,
    /// Assembly and factorisation of the stiffness.
    pub factorisation_s: f64,
    /// Search direction.
    pub direction_s: f64,
    /// Continuous collision detection and broad phase.
    pub collision_s: f64,
    /// Energies of the line search.
    pub line_search_s: f64,
    /// Start of each step: contacts, lagged friction, warm start, first gradient.
    pub begin_s: f64,
}

/// Initial guess and solver state of one time step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepStart {
    /// Translation of gels and object in the initial guess, m: saves iterations when all move
    /// together. Must not move the object towards the ground.
    pub initial_translation: DVec3,
    /// Discards the factorised stiffness of earlier steps.
    pub refactorize: bool,
    /// Slot of the stored motion for the warm start: the motion of the last step with the same
    /// slot is applied if it is collision-free and lowers the energy. Use one slot per kind of
    /// step, e.g. one for closing and one for opening fingers.
    pub warm_start_slot: usize,
}

/// Gels, object and ground with the state of the solver.
#[derive(Debug)]
pub struct System {
    gels: Vec<Gel>,
    object: Object,
    collider: Collider,
    parameters: SolverParameters,
    barrier: Barrier,
    /// Friction coefficient between gels and object.
    gel_mu: f64,
    history: History,
    gradient: Vec<f64>,
    previous_gradient: Vec<f64>,
    direction: Vec<f64>,
    schur: Option<Cholesky>,
    factor_age: u32,
    /// Corners of the object's bounding box in its material frame, m.
    corners: [DVec3; 8],
    times: PhaseTimes,
    /// Motion of the last step of each warm-start slot.
    stored_motions: Vec<Vec<f64>>,
}

impl System {
    /// Builds a system; `gel_mu` is the friction coefficient between gels and object.
    ///
    /// # Errors
    /// `Config` where a parameter is out of range.
    pub fn new(
        gels: Vec<Gel>,
        object: Object,
        collider: Collider,
        gel_mu: f64,
        parameters: SolverParameters,
    ) -> Result<Self> {
        parameters.validate()?;
        let unknowns = gels.iter().map(Gel::unknowns).sum::<usize>() + OBJECT_DOF;
        let (min, max) = (collider.bounds.min, collider.bounds.max);
        let corners = std::array::from_fn(|i| {
            let pick = |bit: usize, low, high| if i & bit == 0 { low } else { high };
            DVec3::new(
                pick(1, min.x, max.x),
                pick(2, min.y, max.y),
                pick(4, min.z, max.z),
            )
        });
        Ok(Self {
            gels,
            object,
            collider,
            barrier: parameters.barrier(),
            gel_mu,
            history: History::new(parameters.memory),
            gradient: vec![0.0; unknowns],
            previous_gradient: vec![0.0; unknowns],
            direction: vec![0.0; unknowns],
            schur: None,
            factor_age: 0,
            corners,
            times: PhaseTimes::default(),
            stored_motions: Vec::new(),
            parameters,
        })
    }

    /// The gels.
    pub fn gels(&self) -> &[Gel] {
        &self.gels
    }

    /// The gels, mutable: moves their drive targets between steps.
    pub fn gels_mut(&mut self) -> &mut [Gel] {
        &mut self.gels
    }

    /// The object.
    pub fn object(&self) -> &Object {
        &self.object
    }

    /// Collision surface of the object.
    pub fn collider(&self) -> &Collider {
        &self.collider
    }

    /// Parameters of the solver.
    pub fn parameters(&self) -> &SolverParameters {
        &self.parameters
    }

    /// Wall time of the solver phases so far.
    pub fn phase_times(&self) -> &PhaseTimes {
        &self.times
    }

    /// Lower bound of the distance between each gel and the object, m.
    pub fn clearance(&mut self) -> Vec<f64> {
        self.ensure_candidates();
        let (object, d_hat) = (&self.object.state, self.parameters.d_hat_m);
        let gels = self.gels.par_iter_mut();
        gels.map(|gel| gel.clearance(object, d_hat)).collect()
    }

    /// Stick or slip of each node of each gel over the step that has ended.
    pub fn node_contacts(&self) -> Vec<Vec<NodeContact>> {
        let obstacle = self.object.as_obstacle(&self.barrier);
        let epsilon = self.parameters.eps_v_m_s * self.parameters.dt_s;
        let gels = self.gels.iter();
        gels.map(|gel| gel.node_contacts(obstacle, epsilon))
            .collect()
    }

    /// Translates each gel rigidly (m) while the object rests: a time step without contact.
    pub fn translate_free(&mut self, by: &[DVec3]) {
        let dt = self.parameters.dt_s;
        for (gel, by) in self.gels.iter_mut().zip(by) {
            gel.translate_free(*by, dt);
        }
    }

    /// Advances by one time step towards the drive targets.
    ///
    /// Forces and contacts of the gels are those at the end of the step.
    pub fn step(&mut self, start: &StepStart) -> StepReport {
        let began = Instant::now();
        let dt = self.parameters.dt_s;
        let epsilon = self.parameters.eps_v_m_s * dt;
        let mut report = StepReport::default();
        for gel in &mut self.gels {
            gel.begin_step(dt);
        }
        self.object.begin_step(dt, self.parameters.gravity_m_s2);
        report.broad_phase_rebuilds += self.ensure_candidates();
        self.find_contacts();
        for gel in &mut self.gels {
            gel.contact.lag_friction(self.gel_mu, epsilon);
        }
        self.object
            .lag_friction(&self.collider, &self.barrier, epsilon);
        let mut translation = DVec3::ZERO;
        if start.initial_translation != DVec3::ZERO && !self.object.is_fixed {
            translation = start.initial_translation;
            for gel in &mut self.gels {
                gel.translate(translation);
            }
            self.object.state.p += translation;
            report.broad_phase_rebuilds += self.ensure_candidates();
            self.find_contacts();
        }
        let energy = self.warm_start(start.warm_start_slot, translation, &mut report);
        if start.refactorize {
            self.schur = None;
        }
        self.history.clear();
        self.compute_gradient();
        self.times.begin_s += began.elapsed().as_secs_f64();
        self.minimise(energy, &mut report);
        for gel in &mut self.gels {
            gel.end_step(dt);
        }
        self.object.end_step(dt);
        self.store_motion(start.warm_start_slot);
        report
    }

    /// Applies the stored motion of a slot, less the `translation` already applied, as far as it
    /// lowers the energy. Returns the energy afterwards, J.
    fn warm_start(&mut self, slot: usize, translation: DVec3, report: &mut StepReport) -> f64 {
        let before = self.energy();
        let Some(stored) = self.stored_motions.get(slot).filter(|m| !m.is_empty()) else {
            return before;
        };
        self.direction.clone_from(stored);
        let object_offset = self.direction.len() - OBJECT_DOF;
        for vector in self.direction[..object_offset + 3].chunks_exact_mut(3) {
            for (value, translation) in vector.iter_mut().zip(translation.to_array()) {
                *value -= translation;
            }
        }
        let mut step_size = self.collision_free_step(report);
        self.store_line_origin();
        for _ in 0..WARM_START_TRIALS {
            self.set_step(step_size);
            let energy = self.energy();
            if energy < before {
                self.find_contacts();
                return energy;
            }
            step_size *= 0.5;
        }
        self.set_step(0.0);
        self.find_contacts();
        before
    }

    /// Stores the motion of the finished step for the warm start of later ones.
    fn store_motion(&mut self, slot: usize) {
        if self.stored_motions.len() <= slot {
            self.stored_motions.resize(slot + 1, Vec::new());
        }
        let motion = &mut self.stored_motions[slot];
        motion.clear();
        for gel in &self.gels {
            for (x, start) in gel.x.iter().zip(&gel.start) {
                motion.extend((*x - *start).to_array());
            }
        }
        let (now, start) = (self.object.state.to_array(), self.object.start.to_array());
        motion.extend(now.iter().zip(start).map(|(now, start)| now - start));
    }

    /// Rebuilds candidates that no longer cover the motion of their gel; returns their number.
    fn ensure_candidates(&mut self) -> u32 {
        let (object, collider) = (&self.object.state, &self.collider);
        let parameters = &self.parameters;
        let gels = self.gels.par_iter_mut();
        gels.map(|gel| u32::from(gel.ensure_candidates(object, collider, parameters)))
            .sum()
    }

    fn find_contacts(&mut self) {
        let obstacle = self.object.as_obstacle(&self.barrier);
        let gels = self.gels.par_iter_mut();
        gels.for_each(|gel| gel.find_contacts(obstacle));
    }

    fn energy(&mut self) -> f64 {
        let obstacle = self.object.as_obstacle(&self.barrier);
        let gels = self.gels.par_iter_mut();
        // Collected so that the order of the sum is fixed.
        let gels: Vec<f64> = gels.map(|gel| gel.energy(obstacle)).collect();
        let dt = self.parameters.dt_s;
        gels.into_iter().sum::<f64>() + self.object.energy(&self.collider, &self.barrier, dt)
    }

    /// Computes the gradient at the current state, whose contacts must be up to date.
    fn compute_gradient(&mut self) {
        let obstacle = self.object.as_obstacle(&self.barrier);
        let slices = split_by_gel(&self.gels, &mut self.gradient);
        let gels = self.gels.par_iter_mut().zip(slices);
        gels.for_each(|(gel, gradient)| {
            gel.write_gradient(obstacle, gradient);
        });
        let dt = self.parameters.dt_s;
        let mut on_object = self.object.gradient(&self.collider, &self.barrier, dt);
        if !self.object.is_fixed {
            for gel in &self.gels {
                on_object.add_all(&gel.object_gradient);
            }
        }
        let object_offset = self.gradient.len() - OBJECT_DOF;
        self.gradient[object_offset..].copy_from_slice(&on_object.0);
    }

    /// Assembles and factorises the stiffness. Where it is not positive definite, the element
    /// Hessians are projected; their sum with the inertia then is.
    fn factorise(&mut self) {
        self.schur = None;
        let projections = [Projection::None, Projection::Abs];
        let done = projections
            .into_iter()
            .any(|projection| self.try_factorise(projection).is_ok());
        self.factor_age = 0;
        debug_assert!(done, "a projected stiffness is positive definite");
    }

    fn try_factorise(&mut self, projection: Projection) -> Result<(), NotPositiveDefinite> {
        let obstacle = self.object.as_obstacle(&self.barrier);
        let gels = self.gels.par_iter_mut();
        let outcomes: Vec<_> = gels
            .map(|gel| gel.factorise(obstacle, projection))
            .collect();
        outcomes.into_iter().collect::<Result<(), _>>()?;
        let dt = self.parameters.dt_s;
        let own = self.object.stiffness(&self.collider, &self.barrier, dt);
        let mut schur: Matrix12 = own.0;
        for gel in &self.gels {
            gel.add_schur(&mut schur);
        }
        self.schur = Some(Cholesky::new(&schur).ok_or(NotPositiveDefinite)?);
        Ok(())
    }

    fn minimise(&mut self, mut energy: f64, report: &mut StepReport) {
        let tolerance = self.parameters.newton_tolerance_m_s * self.parameters.dt_s;
        let mut previous_move = f64::INFINITY;
        let mut slow_iterations = 0;
        while report.iterations < self.parameters.max_iterations {
            report.iterations += 1;
            if self.schur.is_none()
                || self.factor_age >= self.parameters.max_factor_age
                || slow_iterations > MAX_SLOW_ITERATIONS
            {
                let began = Instant::now();
                self.factorise();
                self.times.factorisation_s += began.elapsed().as_secs_f64();
                report.factorisations += 1;
                self.history.clear();
                slow_iterations = 0;
            }
            self.factor_age += 1;
            let began = Instant::now();
            self.find_direction();
            self.times.direction_s += began.elapsed().as_secs_f64();
            let slope = dot(&self.gradient, &self.direction);
            if slope.is_nan() || slope >= 0.0 {
                // Rounding at the minimum, or outdated L-BFGS corrections.
                if self.factor_age == 1 {
                    report.converged = slope == 0.0 || self.direction_length() < tolerance;
                    return;
                }
                self.schur = None;
                continue;
            }
            let full_step = self.direction_length();
            let began = Instant::now();
            let max_step = self.collision_free_step(report);
            self.times.collision_s += began.elapsed().as_secs_f64();
            let began = Instant::now();
            let found = self.line_search(energy, slope, max_step, report);
            self.times.line_search_s += began.elapsed().as_secs_f64();
            let Some((step_size, new_energy)) = found else {
                if self.factor_age == 1 {
                    report.converged = full_step < tolerance;
                    return;
                }
                self.schur = None;
                continue;
            };
            energy = new_energy;
            let began = Instant::now();
            self.accept(step_size);
            self.times.gradient_s += began.elapsed().as_secs_f64();
            let moved = full_step * step_size;
            if full_step < tolerance {
                report.converged = true;
                return;
            }
            if step_size < 1.0 || moved > SLOW_STEP_RATIO * previous_move {
                slow_iterations += 1;
            } else {
                slow_iterations = 0;
            }
            previous_move = moved;
        }
    }

    /// Computes the search direction: the L-BFGS-corrected inverse stiffness times the negative
    /// gradient. The gels are eliminated by a Schur complement on the object's unknowns.
    fn find_direction(&mut self) {
        for (direction, gradient) in self.direction.iter_mut().zip(&self.gradient) {
            *direction = -gradient;
        }
        let (gels, schur) = (&mut self.gels, &self.schur);
        let is_fixed = self.object.is_fixed;
        self.history.apply(&mut self.direction, |flat| {
            let object_offset = flat.len() - OBJECT_DOF;
            let slices = split_by_gel(gels, flat);
            let eliminated: Vec<_> = gels
                .par_iter_mut()
                .zip(slices)
                .map(|(gel, slice)| gel.forward_substitute(slice))
                .collect();
            let mut object = [0.0; OBJECT_DOF];
            if !is_fixed {
                object.copy_from_slice(&flat[object_offset..]);
                for eliminated in eliminated {
                    for (object, eliminated) in object.iter_mut().zip(eliminated) {
                        *object -= eliminated;
                    }
                }
                if let Some(schur) = schur {
                    object = schur.solve(&object);
                }
            }
            let slices = split_by_gel(gels, flat);
            gels.par_iter_mut()
                .zip(slices)
                .for_each(|(gel, slice)| gel.back_substitute(&object, slice));
            flat[object_offset..].copy_from_slice(&object);
        });
    }

    fn object_direction(&self) -> [f64; OBJECT_DOF] {
        let mut direction = [0.0; OBJECT_DOF];
        direction.copy_from_slice(&self.direction[self.direction.len() - OBJECT_DOF..]);
        direction
    }

    /// Longest motion of a gel node or of a corner of the object's bounding box, m.
    fn direction_length(&self) -> f64 {
        let object = AffineState::from_array(&self.object_direction());
        let corners = self.corners.iter().map(|&c| object.point(c));
        let object_offset = self.direction.len() - OBJECT_DOF;
        let nodes = self.direction[..object_offset].chunks_exact(3);
        nodes
            .map(DVec3::from_slice)
            .chain(corners)
            .map(DVec3::length_squared)
            .fold(0.0, f64::max)
            .sqrt()
    }

    /// Largest step size in (0, 1] without collision or inverted element; counts rebuilds of
    /// candidates in `report`.
    fn collision_free_step(&mut self, report: &mut StepReport) -> f64 {
        let object_direction = AffineState::from_array(&self.object_direction());
        let (object, collider) = (&self.object.state, &self.collider);
        let parameters = &self.parameters;
        let slices = split_by_gel(&self.gels, &mut self.direction);
        let steps: Vec<_> = self
            .gels
            .par_iter_mut()
            .zip(slices)
            .map(|(gel, direction)| {
                let inversion_free = gel.inversion_free_step(direction);
                let (step, was_rebuilt) = gel.collision_free_step(
                    direction,
                    object,
                    &object_direction,
                    collider,
                    parameters,
                );
                (step.min(inversion_free), was_rebuilt)
            })
            .collect();
        let slack = parameters.ccd_slack;
        let mut max_step = self
            .object
            .collision_free_step(&object_direction, collider, slack);
        for (step, was_rebuilt) in steps {
            max_step = max_step.min(step);
            report.broad_phase_rebuilds += u32::from(was_rebuilt);
        }
        max_step
    }

    /// Stores the current state as the origin of [`System::set_step`].
    fn store_line_origin(&mut self) {
        for gel in &mut self.gels {
            gel.store_line_origin();
        }
        self.object.store_line_origin();
    }

    /// Moves to the line origin plus `step_size` times the search direction.
    fn set_step(&mut self, step_size: f64) {
        let object = self.object_direction();
        let slices = split_by_gel(&self.gels, &mut self.direction);
        let gels = self.gels.par_iter_mut().zip(slices);
        gels.for_each(|(gel, direction)| gel.set_step(direction, step_size));
        self.object.set_step(&object, step_size);
    }

    /// Backtracks from `max_step` until the Armijo condition holds. Returns the step size and the
    /// energy there (J), with the state moved accordingly.
    fn line_search(
        &mut self,
        energy: f64,
        slope: f64,
        max_step: f64,
        report: &mut StepReport,
    ) -> Option<(f64, f64)> {
        self.store_line_origin();
        let mut step_size = max_step;
        // Rounding of a sum of some thousand terms.
        let noise = 1e-14 * energy.abs();
        for _ in 0..MAX_HALVINGS {
            self.set_step(step_size);
            let new_energy = self.energy();
            if new_energy <= energy + ARMIJO_C1 * step_size * slope + noise {
                return Some((step_size, new_energy));
            }
            step_size *= 0.5;
            report.halvings += 1;
        }
        self.set_step(0.0);
        None
    }

    /// Updates contacts, gradient and L-BFGS history after a step of the line search.
    fn accept(&mut self, step_size: f64) {
        std::mem::swap(&mut self.gradient, &mut self.previous_gradient);
        self.find_contacts();
        self.compute_gradient();
        for direction in &mut self.direction {
            *direction *= step_size;
        }
        self.history
            .push(&self.direction, &self.gradient, &self.previous_gradient);
    }
}

/// Splits a vector over all unknowns into one slice per gel.
fn split_by_gel<'a>(gels: &[Gel], mut flat: &'a mut [f64]) -> Vec<&'a mut [f64]> {
    let mut slices = Vec::with_capacity(gels.len());
    for gel in gels {
        let (slice, rest) = flat.split_at_mut(gel.unknowns());
        slices.push(slice);
        flat = rest;
    }
    slices
}

#[cfg(test)]
#[path = "system_test.rs"]
mod tests;
