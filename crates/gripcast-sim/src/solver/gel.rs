//! One gel in a step: its energy, its gradient, its stiffness and the factor of it.

use glam::DVec3;

use super::ccd;
use super::collider::Collider;
use super::coupling::{Coupling, GeneralisedForce, OBJECT};
use super::gel_contact::{GelContact, Situation};
use super::gel_factor::{GelFactor, NotPositiveDefinite};
use super::parameters::SolverParameters;
use crate::affine::AffineState;
use crate::contact::barrier::Barrier;
use crate::fem::{Elastic, GelGrid, NeoHookean, Projection, Surface};
use gripcast_base::error::{Error, Result};

/// A step may move a node by at most this much relative to the object, m: it bounds the pairs
/// that one iteration has to look at.
const MAX_MOVE: f64 = 2e-3;

/// What drives the back face of a gel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
    /// Springs of this stiffness per back area, N/m³: the same for every mesh.
    PerArea(f64),
    /// Springs of `weight m_i / dt²` for the nodal mass m_i, as Taccel: they soften as the mesh
    /// is refined. The paper's weight is 5e4.
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

/// A node held by springs along the world's axes.
#[derive(Clone, Copy, Debug)]
struct Held {
    node: u32,
    at: DVec3,
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
    /// Nodes held at a world position by springs that differ by axis, N/m.
    held: Vec<Held>,
    /// Lumped mass over dt² of the nodes that are not driven, else 0.
    inertia: Vec<f64>,
    pub(super) x: Vec<DVec3>,
    pub(super) start: Vec<DVec3>,
    pub(super) velocity: Vec<DVec3>,
    predicted: Vec<DVec3>,
    pub(super) target: Vec<DVec3>,
    trial: Vec<DVec3>,
    pub(super) contact: GelContact,
    contact_gradient: Vec<DVec3>,
    gradient: Vec<DVec3>,
    pub(super) object_gradient: GeneralisedForce,
    factor: GelFactor,
    stiffness: Vec<f64>,
    coupling: Coupling,
    /// `L⁻¹ P B` of the coupling B, and the same in single precision.
    eliminated: Vec<[f64; OBJECT]>,
    single_eliminated: Vec<[f32; OBJECT]>,
    permuted: Vec<f32>,
    scratch: Vec<f32>,
    scratch_many: Vec<[f64; OBJECT]>,
    motion: Vec<f64>,
    step: Vec<DVec3>,
}

impl Gel {
    /// A pad at rest with the nodes of `grid` mapped into the world by `place`.
    ///
    /// # Errors
    /// Where the material's parameters are out of range.
    pub fn new(
        grid: &GelGrid,
        material: &GelMaterial,
        drive: Drive,
        parameters: &SolverParameters,
        place: impl Fn(DVec3) -> DVec3,
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
                "the drive's stiffness must be above 0, found {bad} N/m at a node"
            )));
        }
        let mut inertia: Vec<f64> = masses.iter().map(|m| m / (dt * dt)).collect();
        for &node in &driven {
            inertia[node as usize] = 0.0;
        }
        let pattern = elastic.pattern();
        let factor = GelFactor::new(pattern.column_starts(), pattern.rows())?;
        let stiffness = pattern.zeros();
        let x: Vec<DVec3> = grid.positions().iter().map(|&p| place(p)).collect();
        let n = x.len();
        Ok(Self {
            surface: grid.contact_surface().clone(),
            rest: grid.positions().to_vec(),
            target: driven.iter().map(|&node| x[node as usize]).collect(),
            driven,
            drive,
            held: Vec::new(),
            inertia,
            start: x.clone(),
            predicted: x.clone(),
            trial: x.clone(),
            velocity: vec![DVec3::ZERO; n],
            contact_gradient: vec![DVec3::ZERO; n],
            gradient: vec![DVec3::ZERO; n],
            object_gradient: GeneralisedForce::default(),
            contact: GelContact::new(n),
            coupling: Coupling::default(),
            eliminated: Vec::new(),
            single_eliminated: Vec::new(),
            permuted: vec![0.0; 3 * n],
            scratch: Vec::new(),
            scratch_many: Vec::new(),
            motion: vec![0.0; n],
            step: Vec::new(),
            x,
            elastic,
            factor,
            stiffness,
        })
    }

    /// Holds nodes where they are by springs of this stiffness along each axis of the world, N/m:
    /// with a stiff one along an axis and none along the others, a plane of symmetry.
    #[must_use]
    pub fn holding(mut self, nodes: impl IntoIterator<Item = u32>, stiffness: DVec3) -> Self {
        let x = &self.x;
        self.held.extend(nodes.into_iter().map(|node| Held {
            node,
            at: x[node as usize],
            stiffness,
        }));
        self
    }

    /// Lets only these triangles of the gel's nodes touch the object, not its front and sides.
    #[must_use]
    pub fn touching_with(mut self, surface: Surface) -> Self {
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

    /// Stiffness that drives each of [`Gel::driven`], N/m.
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

    /// Smallest distance to the object among the pairs nearer than `d_hat`, m.
    pub fn min_gap(&self) -> Option<f64> {
        self.contact.min_gap()
    }

    /// Mean distance to the object of the pairs nearer than `d_hat`, weighted by the force that
    /// each carries, m.
    pub fn mean_gap(&self) -> Option<f64> {
        self.contact.mean_gap()
    }

    /// Number of pairs nearer than `d_hat`.
    pub fn contacts(&self) -> usize {
        self.contact.contacts.len()
    }

    /// Moves the drive's targets.
    pub fn move_target(&mut self, by: DVec3) {
        for target in &mut self.target {
            *target += by;
        }
    }

    /// Moves the whole gel with its drive and sets its velocity: flight without contact.
    pub(super) fn fly(&mut self, by: DVec3, dt: f64) {
        self.move_target(by);
        self.start.clone_from(&self.x);
        for (x, v) in self.x.iter_mut().zip(&mut self.velocity) {
            *x += by;
            *v = by / dt;
        }
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

    pub(super) fn shift(&mut self, by: DVec3) {
        for x in &mut self.x {
            *x += by;
        }
    }

    /// A lower bound of the distance to the object, m; candidates must be complete.
    pub(super) fn clearance(&mut self, object: &AffineState, d_hat: f64) -> f64 {
        let moved = self.moved(object);
        self.contact.candidates.nearest(d_hat) - moved
    }

    /// Makes the candidate pairs complete for the present positions.
    pub(super) fn ensure_candidates(
        &mut self,
        object: &AffineState,
        collider: &Collider,
        parameters: &SolverParameters,
    ) -> bool {
        if self.contact.candidates.is_gathered() {
            let largest = self.moved(object);
            if self.contact.candidates.cover(largest) {
                return false;
            }
        }
        self.gather(object, collider, parameters, parameters.candidate_margin_m);
        true
    }

    fn moved(&mut self, object: &AffineState) -> f64 {
        let GelContact {
            candidates, moved, ..
        } = &mut self.contact;
        candidates.moved(&self.surface, &self.x, object, moved)
    }

    fn gather(
        &mut self,
        object: &AffineState,
        collider: &Collider,
        parameters: &SolverParameters,
        radius: f64,
    ) {
        let limits = (parameters.d_hat_m, radius);
        let Self {
            contact,
            surface,
            rest,
            x,
            ..
        } = self;
        contact
            .candidates
            .gather(surface, rest, x, object, collider, limits);
        contact.moved.fill(0.0);
    }

    /// Finds the contacts of the present positions; candidates must be complete.
    pub(super) fn find_contacts(&mut self, object: &AffineState, barrier: &Barrier) {
        self.moved(object);
        self.contact.update(&Situation {
            barrier,
            x: &self.x,
            object,
        });
    }

    /// Energy without contact at positions `x`, J.
    fn body_energy(&self, x: &[DVec3]) -> f64 {
        let elastic = self.elastic.energy(x);
        if !elastic.is_finite() {
            return f64::INFINITY;
        }
        let mut energy = 0.0;
        for ((x, predicted), inertia) in x.iter().zip(&self.predicted).zip(&self.inertia) {
            energy += 0.5 * inertia * (*x - *predicted).length_squared();
        }
        let springs = self.driven.iter().zip(&self.drive).zip(&self.target);
        for ((&node, stiffness), target) in springs {
            energy += 0.5 * stiffness * (x[node as usize] - *target).length_squared();
        }
        for held in &self.held {
            let off = x[held.node as usize] - held.at;
            energy += 0.5 * off.dot(held.stiffness * off);
        }
        energy + elastic
    }

    /// Energy at the present positions, J.
    pub(super) fn energy(
        &mut self,
        object: &AffineState,
        from: &AffineState,
        barrier: &Barrier,
    ) -> f64 {
        let body = self.body_energy(&self.x);
        if !body.is_finite() {
            return body;
        }
        let x = std::mem::take(&mut self.x);
        let GelContact {
            candidates, moved, ..
        } = &mut self.contact;
        candidates.moved(&self.surface, &x, object, moved);
        let now = Situation {
            barrier,
            x: &x,
            object,
        };
        let contact = self.contact.energy(&now);
        let friction = self.contact.friction_energy(&now, &self.start, from);
        self.x = x;
        body + contact + friction
    }

    /// Moves to `origin + step * length`, where `origin` was saved by [`Gel::save`].
    pub(super) fn place_on_line(&mut self, direction: &[f64], length: f64) {
        for ((x, origin), d) in self
            .x
            .iter_mut()
            .zip(&self.trial)
            .zip(direction.chunks_exact(3))
        {
            *x = *origin + DVec3::new(d[0], d[1], d[2]) * length;
        }
    }

    pub(super) fn save(&mut self) {
        self.trial.clone_from(&self.x);
    }

    /// Gradient at the present positions into `flat`; contacts must have been found.
    pub(super) fn write_gradient(
        &mut self,
        object: &AffineState,
        from: &AffineState,
        barrier: &Barrier,
        flat: &mut [f64],
    ) {
        self.contact_gradient.fill(DVec3::ZERO);
        self.object_gradient = GeneralisedForce::default();
        let now = Situation {
            barrier,
            x: &self.x,
            object,
        };
        self.contact.add_gradient(
            &now,
            &self.start,
            from,
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
        for held in &self.held {
            let node = held.node as usize;
            self.gradient[node] += (self.x[node] - held.at) * held.stiffness;
        }
        for (flat, g) in flat.chunks_exact_mut(3).zip(&self.gradient) {
            flat.copy_from_slice(&g.to_array());
        }
    }

    /// Assembles the stiffness at the present positions, factorises it and eliminates it from the
    /// coupling.
    pub(super) fn factorise(
        &mut self,
        object: &AffineState,
        from: &AffineState,
        barrier: &Barrier,
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
        for held in &self.held {
            let (node, stiffness) = (held.node as usize, held.stiffness.to_array());
            pattern.add_diagonal(node, stiffness, &mut self.stiffness);
        }
        self.coupling.clear(3 * self.x.len());
        let now = Situation {
            barrier,
            x: &self.x,
            object,
        };
        self.contact.add_hessian(
            &now,
            &self.start,
            from,
            pattern,
            &mut self.stiffness,
            &mut self.coupling,
        );
        self.factor.factorize(&self.stiffness)?;
        self.eliminated.clear();
        let rows = &self.coupling.rows;
        self.eliminated
            .extend(self.factor.permutation().iter().map(|&row| rows[row]));
        self.factor
            .solve_forward_many(&mut self.eliminated, &mut self.scratch_many);
        self.single_eliminated.clear();
        self.single_eliminated
            .extend(self.eliminated.iter().map(|w| w.map(|value| value as f32)));
        Ok(())
    }

    /// Contribution of this gel to the object's stiffness once the gel is eliminated.
    pub(super) fn add_schur(&self, schur: &mut [[f64; OBJECT]; OBJECT]) {
        for (row, own) in schur.iter_mut().zip(&self.coupling.object.0) {
            for (a, b) in row.iter_mut().zip(own) {
                *a += b;
            }
        }
        for w in &self.eliminated {
            for (row, wi) in schur.iter_mut().zip(w) {
                for (value, wj) in row.iter_mut().zip(w) {
                    *value -= wi * wj;
                }
            }
        }
    }

    /// First half of a solve: the right-hand side through the factor, and what it takes from the
    /// object's right-hand side.
    pub(super) fn solve_down(&mut self, flat: &[f64]) -> [f64; OBJECT] {
        self.factor.permute(flat, &mut self.permuted);
        self.factor
            .solve_forward(&mut self.permuted, &mut self.scratch);
        pulp::Arch::new().dispatch(|| {
            let mut taken = [0.0; OBJECT];
            for (w, value) in self.single_eliminated.iter().zip(&self.permuted) {
                for (taken, w) in taken.iter_mut().zip(w) {
                    *taken += f64::from(w * value);
                }
            }
            taken
        })
    }

    /// Second half: the gel's unknowns from the object's.
    pub(super) fn solve_up(&mut self, object: &[f64; OBJECT], flat: &mut [f64]) {
        let object = object.map(|value| value as f32);
        pulp::Arch::new().dispatch(|| {
            for (w, value) in self.single_eliminated.iter().zip(&mut self.permuted) {
                let mut sum = 0.0;
                for (w, q) in w.iter().zip(&object) {
                    sum += w * q;
                }
                *value -= sum;
            }
        });
        self.factor
            .solve_backward(&mut self.permuted, &mut self.scratch);
        self.factor.unpermute(&self.permuted, flat);
    }

    /// Largest fraction of the step that neither touches the object nor leaves the candidates;
    /// gathers anew where the step is longer than they reach. Also whether it gathered.
    pub(super) fn free_fraction(
        &mut self,
        direction: &[f64],
        object: &AffineState,
        object_direction: &AffineState,
        collider: &Collider,
        parameters: &SolverParameters,
    ) -> (f64, bool) {
        let already = self.moved(object);
        let longest = ccd::relative_motion(
            &self.surface,
            &self.x,
            direction,
            object,
            object_direction,
            &mut self.motion,
        );
        let fraction = (MAX_MOVE / longest).min(1.0);
        let reach = longest * fraction;
        let gathered = !self.contact.candidates.cover(already + reach);
        if gathered {
            let radius = parameters.candidate_margin_m.max(1.02 * reach);
            self.gather(object, collider, parameters, radius);
        }
        let limit = ccd::free_fraction(
            &self.contact,
            &self.x,
            direction,
            object,
            object_direction,
            &self.motion,
            (fraction, parameters.ccd_slack),
        );
        (limit, gathered)
    }

    /// Largest fraction of the step before an element inverts.
    pub(super) fn inversion_free_fraction(&mut self, direction: &[f64]) -> f64 {
        self.step.clear();
        self.step
            .extend(direction.chunks_exact(3).map(DVec3::from_slice));
        self.elastic.inversion_free_step(&self.x, &self.step)
    }
}

#[cfg(test)]
#[path = "gel_probe.rs"]
mod probe;
