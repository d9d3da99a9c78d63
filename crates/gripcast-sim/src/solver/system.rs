//! Gels, object and ground together, and one implicit Euler step of them.
//!
//! With all terms divided by dt² the incremental potential (Li et al. 2020) is, in J,
//! `E(x, q) = ½ |x - x̂|²_M/dt² + Ψ(x) + drive(x) + ½ |q - q̂|²_M/dt² + shape(q) + contact + friction`,
//! and its gradient is a balance of forces in N. A quasi-Newton iteration minimises it: a
//! factorised stiffness that is kept over iterations and steps, corrected by the newest changes of
//! the gradient.

use std::time::Instant;

use glam::DVec3;

use super::collider::Collider;
use super::coupling::OBJECT;
use super::gel::Gel;
use super::gel_factor::NotPositiveDefinite;
use super::lbfgs::{Memory, dot};
use super::object::Object;
use super::parameters::SolverParameters;
use crate::affine::{AffineState, Cholesky, Matrix12};
use crate::contact::barrier::Barrier;
use crate::fem::Projection;
use gripcast_base::error::Result;

/// Sufficient decrease of the line search (Armijo).
const SUFFICIENT: f64 = 1e-4;
/// A step that shrinks by less than this fraction from one iteration to the next is slow.
const SLOW: f64 = 0.5;
/// Slow iterations in a row that are taken before the stiffness is assembled anew.
const PATIENCE: u32 = 3;
/// Shortenings of the motion that a step begins with.
const REPEAT_HALVINGS: u32 = 3;
/// Halvings before the stiffness is assembled anew.
const MAX_HALVINGS: u32 = 30;

/// What one step took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct StepReport {
    /// Whether the tolerance was met.
    pub converged: bool,
    /// Iterations.
    pub iterations: u32,
    /// Assemblies and factorisations of the stiffness.
    pub factorisations: u32,
    /// Halvings of the line search.
    pub halvings: u32,
    /// Times that candidate pairs were gathered.
    pub gathers: u32,
}

/// Wall time spent in the phases of all steps so far, s.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct PhaseTimes {
    /// Finding contacts, forces and gradient.
    pub gradient_s: f64,
    /// Assembly and factorisation of the stiffness.
    pub factorisation_s: f64,
    /// Solves for the direction.
    pub direction_s: f64,
    /// Continuous collision detection and gathering of candidates.
    pub collision_s: f64,
    /// Energies of the line search.
    pub line_search_s: f64,
    /// Contacts, friction, first motion and first gradient of the steps.
    pub begin_s: f64,
}

/// How a step begins.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepStart {
    /// Motion that gels and object start the iteration with, m: a guess that saves iterations when
    /// all move together. It must not bring the object closer to the ground.
    pub together: DVec3,
    /// The stiffness of earlier steps is not worth keeping.
    pub renew: bool,
    /// What kind of step it is. It begins with the motion of the last step of its kind, as far as
    /// nothing touches and if the energy falls by that: fingers that open and close in turn repeat
    /// themselves every other step.
    pub kind: usize,
}

/// The scene in motion.
#[derive(Debug)]
pub struct System {
    gels: Vec<Gel>,
    object: Object,
    collider: Collider,
    parameters: SolverParameters,
    barrier: Barrier,
    pair_mu: f64,
    memory: Memory,
    gradient: Vec<f64>,
    before: Vec<f64>,
    direction: Vec<f64>,
    schur: Option<Cholesky>,
    factor_age: u32,
    corners: [DVec3; 8],
    times: PhaseTimes,
    /// Motion of the last step of each kind.
    motions: Vec<Vec<f64>>,
}

impl System {
    /// A scene; `pair_mu` is the friction coefficient between gels and object.
    ///
    /// # Errors
    /// Where a parameter is out of range.
    pub fn new(
        gels: Vec<Gel>,
        object: Object,
        collider: Collider,
        pair_mu: f64,
        parameters: SolverParameters,
    ) -> Result<Self> {
        parameters.validate()?;
        let unknowns = gels.iter().map(Gel::unknowns).sum::<usize>() + OBJECT;
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
            pair_mu,
            memory: Memory::new(parameters.memory),
            gradient: vec![0.0; unknowns],
            before: vec![0.0; unknowns],
            direction: vec![0.0; unknowns],
            schur: None,
            factor_age: 0,
            corners,
            times: PhaseTimes::default(),
            motions: Vec::new(),
            parameters,
        })
    }

    /// The gels.
    pub fn gels(&self) -> &[Gel] {
        &self.gels
    }

    /// The gels, to move their targets.
    pub fn gels_mut(&mut self) -> &mut [Gel] {
        &mut self.gels
    }

    /// The object.
    pub fn object(&self) -> &Object {
        &self.object
    }

    /// The object's surface.
    pub fn collider(&self) -> &Collider {
        &self.collider
    }

    /// Parameters of the solver.
    pub fn parameters(&self) -> &SolverParameters {
        &self.parameters
    }

    /// Where the time went.
    pub fn phase_times(&self) -> &PhaseTimes {
        &self.times
    }

    /// A lower bound of the distance between each gel and the object, m.
    pub fn clearance(&mut self) -> Vec<f64> {
        self.ensure_candidates();
        let object = self.object.state;
        let d_hat = self.parameters.d_hat_m;
        on_each(&mut self.gels, |_, gel| gel.clearance(&object, d_hat))
    }

    /// Moves the gels without deforming them, while the object rests: flight without contact.
    pub fn fly(&mut self, by: &[DVec3]) {
        let dt = self.parameters.dt_s;
        for (gel, by) in self.gels.iter_mut().zip(by) {
            gel.fly(*by, dt);
        }
    }

    /// One time step towards the drive's targets.
    ///
    /// Forces and contacts of the gels are those of the end of the step afterwards.
    pub fn step(&mut self, start: &StepStart) -> StepReport {
        let began = Instant::now();
        let dt = self.parameters.dt_s;
        let epsilon = self.parameters.eps_v_m_s * dt;
        let mut report = StepReport::default();
        for gel in &mut self.gels {
            gel.begin_step(dt);
        }
        self.object.begin_step(dt, self.parameters.gravity_m_s2);
        report.gathers += self.ensure_candidates();
        self.find_contacts();
        let mu = self.pair_mu;
        for gel in &mut self.gels {
            gel.contact.lag_friction(mu, epsilon);
        }
        self.object
            .lag_friction(&self.collider, &self.barrier, epsilon);
        if start.together != DVec3::ZERO && !self.object.is_fixed {
            for gel in &mut self.gels {
                gel.shift(start.together);
            }
            self.object.state.p += start.together;
            report.gathers += self.ensure_candidates();
            self.find_contacts();
        }
        let energy = self.repeat(start, &mut report);
        if start.renew {
            self.schur = None;
        }
        self.memory.clear();
        self.compute_gradient();
        self.times.begin_s += began.elapsed().as_secs_f64();
        self.minimise(energy, &mut report);
        for gel in &mut self.gels {
            gel.end_step(dt);
        }
        self.object.end_step(dt);
        self.remember(start.kind);
        report
    }

    /// Repeats the motion of the last step of this kind; the energy thereafter, J.
    fn repeat(&mut self, start: &StepStart, report: &mut StepReport) -> f64 {
        let before = self.energy();
        let Some(remembered) = self.motions.get(start.kind).filter(|m| !m.is_empty()) else {
            return before;
        };
        self.direction.clone_from(remembered);
        let together = if self.object.is_fixed {
            DVec3::ZERO
        } else {
            start.together
        };
        let at = self.direction.len() - OBJECT;
        for flat in self.direction[..at + 3].chunks_exact_mut(3) {
            for (value, together) in flat.iter_mut().zip(together.to_array()) {
                *value -= together;
            }
        }
        let (fraction, gathers) = self.free_fraction();
        report.gathers += gathers;
        for gel in &mut self.gels {
            gel.save();
        }
        self.object.save();
        let mut length = fraction;
        for _ in 0..REPEAT_HALVINGS {
            self.place_on_line(length);
            let energy = self.energy();
            if energy < before {
                self.find_contacts();
                return energy;
            }
            length *= 0.5;
        }
        self.place_on_line(0.0);
        self.find_contacts();
        before
    }

    /// Remembers the motion of the step that ends.
    fn remember(&mut self, kind: usize) {
        if self.motions.len() <= kind {
            self.motions.resize(kind + 1, Vec::new());
        }
        let motion = &mut self.motions[kind];
        motion.clear();
        for gel in &self.gels {
            for (x, start) in gel.x.iter().zip(&gel.start) {
                motion.extend((*x - *start).to_array());
            }
        }
        let (now, start) = (self.object.state.to_array(), self.object.start.to_array());
        motion.extend(now.iter().zip(start).map(|(now, start)| now - start));
    }

    fn ensure_candidates(&mut self) -> u32 {
        let (object, collider) = (&self.object.state, &self.collider);
        let parameters = &self.parameters;
        let gathered = on_each(&mut self.gels, |_, gel| {
            gel.ensure_candidates(object, collider, parameters)
        });
        gathered.into_iter().map(u32::from).sum()
    }

    fn find_contacts(&mut self) {
        let (object, barrier) = (&self.object.state, &self.barrier);
        on_each(&mut self.gels, |_, gel| gel.find_contacts(object, barrier));
    }

    fn energy(&mut self) -> f64 {
        let (state, from) = (&self.object.state, &self.object.start);
        let barrier = &self.barrier;
        let gels = on_each(&mut self.gels, |_, gel| gel.energy(state, from, barrier));
        let dt = self.parameters.dt_s;
        gels.into_iter().sum::<f64>() + self.object.energy(&self.collider, &self.barrier, dt)
    }

    /// Gradient at the present state, whose contacts have been found.
    fn compute_gradient(&mut self) {
        let (state, from) = (self.object.state, self.object.start);
        let barrier = &self.barrier;
        let parts = split(&self.gels, &mut self.gradient);
        on_each_with(&mut self.gels, parts, |gel, flat| {
            gel.write_gradient(&state, &from, barrier, flat);
        });
        let dt = self.parameters.dt_s;
        let mut object = self.object.gradient(&self.collider, &self.barrier, dt);
        if !self.object.is_fixed {
            for gel in &self.gels {
                object.add_all(&gel.object_gradient);
            }
        }
        let at = self.gradient.len() - OBJECT;
        self.gradient[at..].copy_from_slice(&object.0);
    }

    /// Assembles and factorises. Where the plain stiffness is not positive definite, each element
    /// is projected; the sum of positive semidefinite parts and inertia then is.
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
        let (state, from) = (self.object.state, self.object.start);
        let barrier = &self.barrier;
        for outcome in on_each(&mut self.gels, |_, gel| {
            gel.factorise(&state, &from, barrier, projection)
        }) {
            outcome?;
        }
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
        let mut last_move = f64::INFINITY;
        let mut slow = 0;
        while report.iterations < self.parameters.max_iterations {
            report.iterations += 1;
            if self.schur.is_none()
                || self.factor_age >= self.parameters.max_factor_age
                || slow > PATIENCE
            {
                let began = Instant::now();
                self.factorise();
                self.times.factorisation_s += began.elapsed().as_secs_f64();
                report.factorisations += 1;
                self.memory.clear();
                slow = 0;
            }
            self.factor_age += 1;
            let began = Instant::now();
            self.find_direction();
            self.times.direction_s += began.elapsed().as_secs_f64();
            let slope = dot(&self.gradient, &self.direction);
            if slope.is_nan() || slope >= 0.0 {
                // Rounding at the minimum, or corrections that do not fit any more.
                if self.factor_age == 1 {
                    report.converged = slope == 0.0 || self.direction_length() < tolerance;
                    return;
                }
                self.schur = None;
                continue;
            }
            let whole = self.direction_length();
            let began = Instant::now();
            let (fraction, gathers) = self.free_fraction();
            self.times.collision_s += began.elapsed().as_secs_f64();
            report.gathers += gathers;
            let began = Instant::now();
            let found = self.line_search(energy, slope, fraction, report);
            self.times.line_search_s += began.elapsed().as_secs_f64();
            let Some((length, new_energy)) = found else {
                if self.factor_age == 1 {
                    report.converged = whole < tolerance;
                    return;
                }
                self.schur = None;
                continue;
            };
            energy = new_energy;
            let began = Instant::now();
            self.accept(length);
            self.times.gradient_s += began.elapsed().as_secs_f64();
            let moved = whole * length;
            if whole < tolerance {
                report.converged = true;
                return;
            }
            if length < 1.0 || moved > SLOW * last_move {
                slow += 1;
            } else {
                slow = 0;
            }
            last_move = moved;
        }
    }

    /// Direction from the gradient by the corrected inverse of the factorised stiffness.
    fn find_direction(&mut self) {
        for (direction, gradient) in self.direction.iter_mut().zip(&self.gradient) {
            *direction = -gradient;
        }
        let (gels, schur) = (&mut self.gels, &self.schur);
        let is_fixed = self.object.is_fixed;
        self.memory.apply(&mut self.direction, |flat| {
            let at = flat.len() - OBJECT;
            let parts = split(gels, flat);
            let taken = on_each_with(gels, parts, |gel, flat| gel.solve_down(flat));
            let mut object = [0.0; OBJECT];
            if !is_fixed {
                object.copy_from_slice(&flat[at..]);
                for taken in taken {
                    for (object, taken) in object.iter_mut().zip(taken) {
                        *object -= taken;
                    }
                }
                if let Some(schur) = schur {
                    object = schur.solve(&object);
                }
            }
            let parts = split(gels, flat);
            on_each_with(gels, parts, |gel, flat| gel.solve_up(&object, flat));
            flat[at..].copy_from_slice(&object);
        });
    }

    fn object_direction(&self) -> [f64; OBJECT] {
        let mut direction = [0.0; OBJECT];
        direction.copy_from_slice(&self.direction[self.direction.len() - OBJECT..]);
        direction
    }

    /// Longest motion of a gel node or of a corner of the object's box, m.
    fn direction_length(&self) -> f64 {
        let object = AffineState::from_array(&self.object_direction());
        let corners = self.corners.iter().map(|&c| object.point(c));
        let at = self.direction.len() - OBJECT;
        let nodes = self.direction[..at].chunks_exact(3);
        nodes
            .map(DVec3::from_slice)
            .chain(corners)
            .map(DVec3::length_squared)
            .fold(0.0, f64::max)
            .sqrt()
    }

    /// Largest fraction of the step without contact or inversion, and how many gels gathered.
    fn free_fraction(&mut self) -> (f64, u32) {
        let object_direction = AffineState::from_array(&self.object_direction());
        let (state, collider) = (self.object.state, &self.collider);
        let parameters = &self.parameters;
        let parts = split(&self.gels, &mut self.direction);
        let fractions = on_each_with(&mut self.gels, parts, |gel, direction| {
            let inversion_free = gel.inversion_free_fraction(direction);
            let (fraction, gathered) =
                gel.free_fraction(direction, &state, &object_direction, collider, parameters);
            (fraction.min(inversion_free), gathered)
        });
        let slack = parameters.ccd_slack;
        let mut fraction = self
            .object
            .free_fraction(&object_direction, &self.collider, slack);
        let mut gathers = 0;
        for (gel, gathered) in fractions {
            fraction = fraction.min(gel);
            gathers += u32::from(gathered);
        }
        (fraction, gathers)
    }

    fn place_on_line(&mut self, length: f64) {
        let object = self.object_direction();
        let parts = split(&self.gels, &mut self.direction);
        on_each_with(&mut self.gels, parts, |gel, direction| {
            gel.place_on_line(direction, length);
        });
        self.object.place_on_line(&object, length);
    }

    /// Halves the step until the energy falls enough; the state is then at its end.
    fn line_search(
        &mut self,
        energy: f64,
        slope: f64,
        fraction: f64,
        report: &mut StepReport,
    ) -> Option<(f64, f64)> {
        for gel in &mut self.gels {
            gel.save();
        }
        self.object.save();
        let mut length = fraction;
        // Sums of some thousand terms are uncertain by about this much.
        let noise = 1e-14 * energy.abs();
        for _ in 0..MAX_HALVINGS {
            self.place_on_line(length);
            let new_energy = self.energy();
            if new_energy <= energy + SUFFICIENT * length * slope + noise {
                return Some((length, new_energy));
            }
            length *= 0.5;
            report.halvings += 1;
        }
        self.place_on_line(0.0);
        None
    }

    /// Takes the step of the line search and learns from it.
    fn accept(&mut self, length: f64) {
        std::mem::swap(&mut self.gradient, &mut self.before);
        self.find_contacts();
        self.compute_gradient();
        for direction in &mut self.direction {
            *direction *= length;
        }
        self.memory
            .push(&self.direction, &self.gradient, &self.before);
    }
}

/// The gels' parts of a flat vector.
fn split<'a>(gels: &[Gel], mut flat: &'a mut [f64]) -> Vec<&'a mut [f64]> {
    let mut parts = Vec::with_capacity(gels.len());
    for gel in gels {
        let (part, rest) = flat.split_at_mut(gel.unknowns());
        parts.push(part);
        flat = rest;
    }
    parts
}

/// Runs `work` on each gel, two gels at the same time; results in the order of the gels.
fn on_each<R: Send>(gels: &mut [Gel], work: impl Fn(usize, &mut Gel) -> R + Sync) -> Vec<R> {
    if let [first, second] = gels {
        let (a, b) = rayon::join(|| work(0, first), || work(1, second));
        return vec![a, b];
    }
    gels.iter_mut()
        .enumerate()
        .map(|(index, gel)| work(index, gel))
        .collect()
}

/// [`on_each`] with a part of a flat vector for each gel.
fn on_each_with<R: Send>(
    gels: &mut [Gel],
    parts: Vec<&mut [f64]>,
    work: impl Fn(&mut Gel, &mut [f64]) -> R + Sync,
) -> Vec<R> {
    let mut parts = parts.into_iter();
    if let [first, second] = gels {
        if let (Some(a), Some(b)) = (parts.next(), parts.next()) {
            let (a, b) = rayon::join(|| work(first, a), || work(second, b));
            return vec![a, b];
        }
        return Vec::new();
    }
    gels.iter_mut()
        .zip(parts)
        .map(|(gel, part)| work(gel, part))
        .collect()
}

#[cfg(test)]
#[path = "system_test.rs"]
mod tests;
