//! The object in a step: an affine body above a half-space.

use glam::DVec3;

use super::collider::Collider;
use super::coupling::{GeneralisedForce, ObjectStiffness};
use crate::affine::{AffineBody, AffineRate, AffineState};
use crate::contact::barrier::Barrier;
use crate::contact::ccd::half_space_toi;
use crate::contact::friction::Friction;
use crate::fem::Projection;

/// A vertex that touches the ground at the start of a step.
#[derive(Clone, Copy, Debug)]
struct Rubbing {
    material: DVec3,
    friction: Friction,
}

/// The object and the ground below it (z = 0 of the world).
#[derive(Debug)]
pub struct Object {
    pub(super) body: AffineBody,
    pub(super) state: AffineState,
    pub(super) start: AffineState,
    pub(super) rate: AffineRate,
    predicted: AffineState,
    saved: AffineState,
    /// Friction coefficient with the ground; without one there is no ground.
    pub(super) ground_mu: Option<f64>,
    rubbing: Vec<Rubbing>,
    /// It stays where it is.
    pub(super) is_fixed: bool,
    /// Acceleration besides gravity, m/s².
    pull: DVec3,
    reach: f64,
    pub(super) ground_gradient: GeneralisedForce,
}

impl Object {
    /// An object at rest in `state`.
    pub fn new(body: AffineBody, state: AffineState, collider: &Collider) -> Self {
        let lengths = collider.vertices.iter().map(|v| v.length());
        Self {
            body,
            state,
            start: state,
            predicted: state,
            saved: state,
            rate: AffineRate::ZERO,
            ground_mu: None,
            rubbing: Vec::new(),
            is_fixed: false,
            pull: DVec3::ZERO,
            reach: lengths.fold(0.0, f64::max) * 1.01,
            ground_gradient: GeneralisedForce::default(),
        }
    }

    /// Adds the ground.
    #[must_use]
    pub fn on_ground(mut self, mu: f64) -> Self {
        self.ground_mu = Some(mu);
        self
    }

    /// Raises or lowers the object.
    pub fn raise(&mut self, by_m: f64) {
        self.state.p.z += by_m;
        self.start = self.state;
    }

    /// Height of the lowest point at which the ground carries the object's weight in its present
    /// attitude, m.
    pub fn resting_height(&self, collider: &Collider, barrier: &Barrier, weight_n: f64) -> f64 {
        let row = self.state.a.row(2);
        let lowest = self.lowest(collider) - self.state.p.z;
        let carried = |height: f64| -> f64 {
            let vertices = collider.vertices.iter().zip(&collider.vertex_areas);
            vertices
                .map(|(vertex, area)| {
                    let distance = height + row.dot(*vertex) - lowest;
                    -area * barrier.d_hat * barrier.linear(distance).first
                })
                .sum()
        };
        let (mut low, mut high) = (0.0, barrier.d_hat);
        for _ in 0..80 {
            let middle = 0.5 * (low + high);
            if carried(middle) > weight_n {
                low = middle;
            } else {
                high = middle;
            }
        }
        high
    }

    /// Holds the object where it is.
    #[must_use]
    pub fn fixed(mut self) -> Self {
        self.is_fixed = true;
        self
    }

    /// Lets the object start with this rate instead of at rest.
    #[must_use]
    pub fn moving(mut self, rate: AffineRate) -> Self {
        self.rate = rate;
        self
    }

    /// Adds a constant acceleration besides gravity, m/s²: a tilted ground, for instance, is
    /// gravity that is not along z.
    #[must_use]
    pub fn pulled(mut self, acceleration: DVec3) -> Self {
        self.pull = acceleration;
        self
    }

    /// Place and shape.
    pub fn state(&self) -> &AffineState {
        &self.state
    }

    /// Rate of place and shape over the last step.
    pub fn rate(&self) -> &AffineRate {
        &self.rate
    }

    /// Mass and shape constants.
    pub fn body(&self) -> &AffineBody {
        &self.body
    }

    pub(super) fn begin_step(&mut self, dt: f64, gravity: f64) {
        self.start = self.state;
        let acceleration = DVec3::new(0.0, 0.0, gravity) + self.pull;
        self.predicted = self.state.inertial(&self.rate, acceleration, dt);
    }

    pub(super) fn end_step(&mut self, dt: f64) {
        self.rate = self.state.rate_since(&self.start, dt);
    }

    pub(super) fn save(&mut self) {
        self.saved = self.state;
    }

    pub(super) fn place_on_line(&mut self, direction: &[f64; 12], length: f64) {
        self.state = self.saved.stepped(direction, length);
    }

    fn may_touch_ground(&self, barrier: &Barrier) -> bool {
        self.ground_mu.is_some() && self.state.p.z - self.reach < barrier.d_hat
    }

    fn height(&self, material: DVec3) -> f64 {
        self.state.p.z + self.state.a.row(2).dot(material)
    }

    /// Lowest point above the ground plane, m.
    pub fn lowest(&self, collider: &Collider) -> f64 {
        let row = self.state.a.row(2);
        let heights = collider.vertices.iter().map(|v| row.dot(*v));
        self.state.p.z + heights.fold(f64::INFINITY, f64::min)
    }

    /// Energy at the present state, J.
    pub(super) fn energy(&self, collider: &Collider, barrier: &Barrier, dt: f64) -> f64 {
        if self.is_fixed {
            return 0.0;
        }
        let mut energy = self.body.kinetic(&self.state, &self.predicted) / (dt * dt)
            + self.body.shape(&self.state.a);
        if self.may_touch_ground(barrier) {
            for (vertex, area) in collider.vertices.iter().zip(&collider.vertex_areas) {
                let height = self.height(*vertex);
                if height < barrier.d_hat {
                    energy += area * barrier.d_hat * barrier.value_linear(height);
                }
            }
        }
        for rubbing in &self.rubbing {
            energy += rubbing.friction.value(self.slip(rubbing));
        }
        energy
    }

    fn slip(&self, rubbing: &Rubbing) -> DVec3 {
        self.state.point(rubbing.material) - self.start.point(rubbing.material)
    }

    /// Takes the ground's friction of the coming step from the present state.
    pub(super) fn lag_friction(&mut self, collider: &Collider, barrier: &Barrier, epsilon: f64) {
        self.rubbing.clear();
        let Some(mu) = self.ground_mu.filter(|&mu| mu > 0.0 && !self.is_fixed) else {
            return;
        };
        if !self.may_touch_ground(barrier) {
            return;
        }
        for (vertex, area) in collider.vertices.iter().zip(&collider.vertex_areas) {
            let height = self.height(*vertex);
            if height < barrier.d_hat {
                let force = -area * barrier.d_hat * barrier.linear(height).first;
                self.rubbing.push(Rubbing {
                    material: *vertex,
                    friction: Friction {
                        normal: DVec3::Z,
                        limit: mu * force,
                        epsilon,
                    },
                });
            }
        }
    }

    /// Gradient at the present state, without the gels' part.
    pub(super) fn gradient(
        &mut self,
        collider: &Collider,
        barrier: &Barrier,
        dt: f64,
    ) -> GeneralisedForce {
        self.ground_gradient = GeneralisedForce::default();
        let mut gradient = GeneralisedForce::default();
        if self.is_fixed {
            return gradient;
        }
        let (state, scale) = (&self.state, 1.0 / (dt * dt));
        self.body
            .add_kinetic_gradient(state, &self.predicted, scale, &mut gradient.0);
        self.body.add_shape_gradient(&state.a, 1.0, &mut gradient.0);
        if self.may_touch_ground(barrier) {
            for (vertex, area) in collider.vertices.iter().zip(&collider.vertex_areas) {
                let height = self.height(*vertex);
                if height < barrier.d_hat {
                    let first = area * barrier.d_hat * barrier.linear(height).first;
                    self.ground_gradient.add(DVec3::Z * first, *vertex);
                }
            }
        }
        for rubbing in &self.rubbing {
            let friction = rubbing.friction.gradient(self.slip(rubbing));
            self.ground_gradient.add(friction, rubbing.material);
        }
        gradient.add_all(&self.ground_gradient);
        gradient
    }

    /// Positive definite stiffness of the object alone.
    pub(super) fn stiffness(
        &self,
        collider: &Collider,
        barrier: &Barrier,
        dt: f64,
    ) -> ObjectStiffness {
        let mut stiffness = ObjectStiffness::default();
        self.body
            .add_kinetic_hessian(1.0 / (dt * dt), &mut stiffness.0);
        self.body
            .add_shape_hessian(&self.state.a, Projection::Abs, 1.0, &mut stiffness.0);
        if self.may_touch_ground(barrier) {
            for (vertex, area) in collider.vertices.iter().zip(&collider.vertex_areas) {
                let height = self.height(*vertex);
                if height < barrier.d_hat {
                    let second = area * barrier.d_hat * barrier.linear(height).second;
                    let block = glam::DMat3::from_diagonal(DVec3::Z * second.max(0.0));
                    stiffness.add_block(&block, *vertex);
                }
            }
        }
        for rubbing in &self.rubbing {
            let block = rubbing.friction.hessian(self.slip(rubbing));
            stiffness.add_block(&block, rubbing.material);
        }
        stiffness
    }

    /// Largest fraction of a step before a vertex touches the ground.
    pub(super) fn free_fraction(
        &self,
        direction: &AffineState,
        collider: &Collider,
        slack: f64,
    ) -> f64 {
        if self.ground_mu.is_none() || self.is_fixed {
            return 1.0;
        }
        let row = direction.a.row(2);
        let fall = direction.p.z.abs() + direction.a.row(2).length() * self.reach;
        if self.state.p.z - self.reach > fall {
            return 1.0;
        }
        let mut limit = 1.0_f64;
        for vertex in &collider.vertices {
            let height = self.height(*vertex);
            let end = height + direction.p.z + row.dot(*vertex);
            if end < slack * height {
                limit = limit.min(half_space_toi(height, end, slack).unwrap_or(1.0));
            }
        }
        limit
    }
}
