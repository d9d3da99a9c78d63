//! The object in a time step: an affine body above the ground.

use glam::{DMat3, DVec3};

use super::collider::Collider;
use super::coupling::{GeneralisedForce, ObjectStiffness};
use super::gel_contact::Obstacle;
use crate::affine::{AffineBody, AffineRate, AffineState};
use crate::contact::barrier::Barrier;
use crate::contact::ccd::half_space_toi;
use crate::contact::friction::Friction;
use crate::fem::Projection;

/// A vertex that touches the ground at the start of a step.
#[derive(Clone, Copy, Debug)]
struct FrictionContact {
    material: DVec3,
    friction: Friction,
}

/// A vertex within the reach of the ground's barrier.
struct GroundContact {
    material: DVec3,
    height: f64,
    /// Area of the vertex times `d_hat`, m³.
    scale: f64,
}

/// The object and the ground below it (z = 0 of the world).
#[derive(Debug)]
pub struct Object {
    pub(super) body: AffineBody,
    pub(super) state: AffineState,
    /// State at the start of the step.
    pub(super) start: AffineState,
    pub(super) rate: AffineRate,
    /// State that inertia and gravity alone would lead to.
    predicted: AffineState,
    line_origin: AffineState,
    /// Friction coefficient with the ground; `None` without ground.
    pub(super) ground_mu: Option<f64>,
    friction_contacts: Vec<FrictionContact>,
    pub(super) is_fixed: bool,
    /// Acceleration besides gravity, m/s².
    acceleration: DVec3,
    /// Bound of the distance of a vertex from the centre of mass, m.
    radius: f64,
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
            line_origin: state,
            rate: AffineRate::ZERO,
            ground_mu: None,
            friction_contacts: Vec::new(),
            is_fixed: false,
            acceleration: DVec3::ZERO,
            radius: lengths.fold(0.0, f64::max) * 1.01,
            ground_gradient: GeneralisedForce::default(),
        }
    }

    /// Adds the ground with a friction coefficient.
    #[must_use]
    pub fn with_ground(mut self, mu: f64) -> Self {
        self.ground_mu = Some(mu);
        self
    }

    /// Moves the object up, m.
    pub fn raise(&mut self, by_m: f64) {
        self.state.p.z += by_m;
        self.start = self.state;
    }

    /// Height of the lowest point (m) at which the ground's barrier carries `weight_n` in the
    /// current orientation.
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

    /// Fixes the object in the world.
    #[must_use]
    pub fn fixed(mut self) -> Self {
        self.is_fixed = true;
        self
    }

    /// Sets the initial rate.
    #[must_use]
    pub fn with_rate(mut self, rate: AffineRate) -> Self {
        self.rate = rate;
        self
    }

    /// Adds a constant acceleration besides gravity, m/s², e.g. the component of gravity along an
    /// inclined ground.
    #[must_use]
    pub fn with_acceleration(mut self, acceleration: DVec3) -> Self {
        self.acceleration = acceleration;
        self
    }

    /// Position and linear part.
    pub fn state(&self) -> &AffineState {
        &self.state
    }

    /// Rate of the state over the last step.
    pub fn rate(&self) -> &AffineRate {
        &self.rate
    }

    /// Mass and shape constants.
    pub fn body(&self) -> &AffineBody {
        &self.body
    }

    pub(super) fn begin_step(&mut self, dt: f64, gravity: f64) {
        self.start = self.state;
        let acceleration = DVec3::new(0.0, 0.0, gravity) + self.acceleration;
        self.predicted = self.state.inertial(&self.rate, acceleration, dt);
    }

    pub(super) fn end_step(&mut self, dt: f64) {
        self.rate = self.state.rate_since(&self.start, dt);
    }

    /// The object as an obstacle for the gels.
    pub(super) fn as_obstacle<'a>(&'a self, barrier: &'a Barrier) -> Obstacle<'a> {
        Obstacle {
            barrier,
            now: &self.state,
            start: &self.start,
        }
    }

    pub(super) fn store_line_origin(&mut self) {
        self.line_origin = self.state;
    }

    /// Moves to the line origin plus `step_size` times `direction`.
    pub(super) fn set_step(&mut self, direction: &[f64; 12], step_size: f64) {
        self.state = self.line_origin.stepped(direction, step_size);
    }

    fn height(&self, material: DVec3) -> f64 {
        self.state.p.z + self.state.a.row(2).dot(material)
    }

    /// Height of the lowest vertex above the ground plane, m.
    pub fn lowest(&self, collider: &Collider) -> f64 {
        let row = self.state.a.row(2);
        let heights = collider.vertices.iter().map(|v| row.dot(*v));
        self.state.p.z + heights.fold(f64::INFINITY, f64::min)
    }

    /// The vertices closer than `d_hat` to the ground.
    fn ground_contacts<'a>(
        &'a self,
        collider: &'a Collider,
        barrier: &'a Barrier,
    ) -> impl Iterator<Item = GroundContact> + 'a {
        let can_touch = self.ground_mu.is_some() && self.state.p.z - self.radius < barrier.d_hat;
        let count = if can_touch {
            collider.vertices.len()
        } else {
            0
        };
        let vertices = collider.vertices[..count].iter();
        vertices
            .zip(&collider.vertex_areas)
            .map(|(vertex, area)| GroundContact {
                material: *vertex,
                height: self.height(*vertex),
                scale: area * barrier.d_hat,
            })
            .filter(|contact| contact.height < barrier.d_hat)
    }

    /// Energy at the current state, J.
    pub(super) fn energy(&self, collider: &Collider, barrier: &Barrier, dt: f64) -> f64 {
        if self.is_fixed {
            return 0.0;
        }
        let mut energy = self.body.kinetic(&self.state, &self.predicted) / (dt * dt)
            + self.body.shape(&self.state.a);
        for contact in self.ground_contacts(collider, barrier) {
            energy += contact.scale * barrier.value_linear(contact.height);
        }
        for contact in &self.friction_contacts {
            energy += contact.friction.value(self.slip(contact));
        }
        energy
    }

    fn slip(&self, contact: &FrictionContact) -> DVec3 {
        self.state.point(contact.material) - self.start.point(contact.material)
    }

    /// Lags the ground friction of the coming step from the current state.
    pub(super) fn lag_friction(&mut self, collider: &Collider, barrier: &Barrier, epsilon: f64) {
        self.friction_contacts.clear();
        let Some(mu) = self.ground_mu.filter(|&mu| mu > 0.0 && !self.is_fixed) else {
            return;
        };
        let lagged = self
            .ground_contacts(collider, barrier)
            .map(|contact| FrictionContact {
                material: contact.material,
                friction: Friction {
                    normal: DVec3::Z,
                    limit: mu * -(contact.scale * barrier.linear(contact.height).first),
                    epsilon,
                },
            })
            .collect();
        self.friction_contacts = lagged;
    }

    /// Gradient at the current state, without the gels' part.
    pub(super) fn gradient(
        &mut self,
        collider: &Collider,
        barrier: &Barrier,
        dt: f64,
    ) -> GeneralisedForce {
        let mut on_ground = GeneralisedForce::default();
        let mut gradient = GeneralisedForce::default();
        if !self.is_fixed {
            let (state, scale) = (&self.state, 1.0 / (dt * dt));
            self.body
                .add_kinetic_gradient(state, &self.predicted, scale, &mut gradient.0);
            self.body.add_shape_gradient(&state.a, 1.0, &mut gradient.0);
            for contact in self.ground_contacts(collider, barrier) {
                let first = contact.scale * barrier.linear(contact.height).first;
                on_ground.add(DVec3::Z * first, contact.material);
            }
            for contact in &self.friction_contacts {
                let friction = contact.friction.gradient(self.slip(contact));
                on_ground.add(friction, contact.material);
            }
            gradient.add_all(&on_ground);
        }
        self.ground_gradient = on_ground;
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
        for contact in self.ground_contacts(collider, barrier) {
            let second = contact.scale * barrier.linear(contact.height).second;
            let block = DMat3::from_diagonal(DVec3::Z * second.max(0.0));
            stiffness.add_block(&block, contact.material);
        }
        for contact in &self.friction_contacts {
            let block = contact.friction.hessian(self.slip(contact));
            stiffness.add_block(&block, contact.material);
        }
        stiffness
    }

    /// Largest step size in (0, 1] before a vertex touches the ground.
    pub(super) fn collision_free_step(
        &self,
        direction: &AffineState,
        collider: &Collider,
        slack: f64,
    ) -> f64 {
        if self.ground_mu.is_none() || self.is_fixed {
            return 1.0;
        }
        let row = direction.a.row(2);
        let fall = direction.p.z.abs() + row.length() * self.radius;
        if self.state.p.z - self.radius > fall {
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
