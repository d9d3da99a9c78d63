//! Object, fingers and ground as rigid bodies.
//!
//! Simulated in the initial gripper frame, so that the only degree of freedom of a finger is along
//! x, which rapier can leave free while locking the others exactly.

use glam::DVec3;
use rapier3d_f64::dynamics::{
    CoefficientCombineRule, FrictionModel, GenericJointBuilder, ImpulseJointHandle,
    IntegrationParameters, JointAxesMask, JointAxis, LockedAxes, MassProperties as RapierMass,
    RigidBodyBuilder, RigidBodyHandle, SpringCoefficients,
};
use rapier3d_f64::geometry::{
    ColliderBuilder, Group, InteractionGroups, InteractionTestMode, NarrowPhase, SharedShape,
};
use rapier3d_f64::math::{Matrix, Vector};
use rapier3d_f64::parry::query::{DefaultQueryDispatcher, QueryDispatcher};
use rapier3d_f64::pipeline::PhysicsWorld;

use super::contact::FlatContacts;
use super::convert;
use super::decomposition::Decomposition;
use super::settings::RigidSettings;
use crate::GraspSetup;
use crate::grasp::{Finger, GelForce};
use gripcast_base::error::Result;
use gripcast_geometry::{MassProperties, Pose};

/// Motor damping, 1/s: rigid up to the maximum force.
const MOTOR_DAMPING: f64 = 1e9;
/// Bits of a contact id that hold the index of its point.
const POINT_MASK: u64 = 0x7fff_ffff;
/// Maximum speed of penetration correction, m/s.
const MAX_CORRECTION_M_S: f64 = 0.5;

const OBJECT: Group = Group::GROUP_1;
const FINGERS: Group = Group::GROUP_2;
const GROUND: Group = Group::GROUP_3;

/// Inputs of [`World::new`].
pub(super) struct WorldSetup<'a> {
    pub(super) grasp: &'a GraspSetup,
    pub(super) pieces: &'a Decomposition,
    /// Initial opening of the fingers, m.
    pub(super) opening_m: f64,
    pub(super) friction: f64,
    pub(super) force_n: f64,
}

/// The simulated bodies.
pub(super) struct World {
    physics: PhysicsWorld,
    settings: RigidSettings,
    t_world_gripper: Pose,
    /// The world's z axis in the gripper's frame.
    up: DVec3,
    object: RigidBodyHandle,
    /// Centre of mass in the frame of the object's mesh, m.
    center_of_mass_m: DVec3,
    base: RigidBodyHandle,
    fingers: [RigidBodyHandle; 2],
    motors: [ImpulseJointHandle; 2],
    base_speed_m_s: f64,
}

/// Centre of a finger's box of thickness `thickness_m` on the gripper's x axis, m.
pub(super) fn finger_x(finger: Finger, opening_m: f64, thickness_m: f64) -> f64 {
    -finger.closing().x * (0.5 * opening_m + 0.5 * thickness_m)
}

impl World {
    pub(super) fn new(setup: &WorldSetup, settings: &RigidSettings) -> Result<Self> {
        let t_gripper_world = setup.grasp.t_world_gripper.inverse();
        let up = t_gripper_world.transform_vector(DVec3::Z);
        let mut physics = PhysicsWorld {
            gravity: convert::vector(up * -settings.gravity_m_s2),
            integration_parameters: integration(settings),
            narrow_phase: NarrowPhase::with_query_dispatcher(
                FlatContacts.chain(DefaultQueryDispatcher),
            ),
            ..PhysicsWorld::default()
        };
        let groups = |own, other| InteractionGroups::new(own, other, InteractionTestMode::And);
        let surface = |builder: ColliderBuilder| {
            builder
                .friction(setup.friction)
                .friction_combine_rule(CoefficientCombineRule::Max)
                .density(0.0)
        };

        let ground = t_gripper_world.transform_point(DVec3::ZERO);
        let ground_body = RigidBodyBuilder::fixed().translation(convert::vector(ground));
        physics.insert(
            ground_body,
            surface(ColliderBuilder::new(SharedShape::halfspace(
                convert::vector(up),
            )))
            .collision_groups(groups(GROUND, OBJECT)),
        );

        let t_gripper_object = t_gripper_world * setup.grasp.t_world_object;
        let properties = MassProperties::from_mesh(&setup.grasp.mesh)?;
        let object = physics.insert_body(
            RigidBodyBuilder::dynamic()
                .pose(convert::pose(&t_gripper_object))
                .additional_mass_properties(mass(&properties, setup.grasp.mass_kg))
                .can_sleep(false),
        );
        for shape in setup.pieces.shapes() {
            physics.insert_collider(
                surface(ColliderBuilder::new(shape.clone()))
                    .collision_groups(groups(OBJECT, FINGERS | GROUND)),
                Some(object),
            );
        }

        let base = physics.insert_body(RigidBodyBuilder::kinematic_velocity_based());
        // A finger is a box of the size of its gel.
        let half = settings.pad.half_in_gripper_m();
        let mut finger = |finger: Finger| {
            let x = finger_x(finger, setup.opening_m, settings.pad.thickness_m);
            let free_x = LockedAxes::ROTATION_LOCKED
                | LockedAxes::TRANSLATION_LOCKED_Y
                | LockedAxes::TRANSLATION_LOCKED_Z;
            let body = RigidBodyBuilder::dynamic()
                .translation(Vector::new(x, 0.0, 0.0))
                .locked_axes(free_x)
                .gravity_scale(0.0)
                .can_sleep(false);
            let shape = surface(ColliderBuilder::cuboid(half.x, half.y, half.z))
                .mass(settings.finger_mass_kg)
                .collision_groups(groups(FINGERS, OBJECT));
            let (body, _) = physics.insert(body, shape);
            let motor = GenericJointBuilder::new(JointAxesMask::empty())
                .motor_velocity(JointAxis::LinX, 0.0, MOTOR_DAMPING)
                .motor_max_force(JointAxis::LinX, setup.force_n);
            let motor = physics.insert_impulse_joint(base, body, motor);
            (body, motor)
        };
        let [(left, left_motor), (right, right_motor)] = Finger::BOTH.map(&mut finger);
        Ok(Self {
            physics,
            settings: *settings,
            t_world_gripper: setup.grasp.t_world_gripper,
            up,
            object,
            center_of_mass_m: properties.center_of_mass_m,
            base,
            fingers: [left, right],
            motors: [left_motor, right_motor],
            base_speed_m_s: 0.0,
        })
    }

    /// One time step, with the gripper rising at a speed.
    pub(super) fn tick(&mut self, lift_speed_m_s: f64) {
        let dt = self.settings.dt_s;
        let speeds = self.fingers.map(|f| self.physics.bodies[f].linvel().x);
        let common = 0.5 * (speeds[0] + speeds[1]) - self.up.x * self.base_speed_m_s;
        let damped = common * dt / (dt + self.settings.centring_s);
        let rise = self.up * (lift_speed_m_s - self.base_speed_m_s);
        let base_velocity = convert::vector(self.up * lift_speed_m_s);
        self.base_speed_m_s = lift_speed_m_s;
        self.physics.bodies[self.base].set_linvel(base_velocity, true);
        let base_x = self.physics.bodies[self.base].translation().x;
        let [gain, max_speed] = [
            self.settings.position_gain_per_s,
            self.settings.closing_speed_m_s,
        ];
        for (i, finger) in Finger::BOTH.into_iter().enumerate() {
            let body = &mut self.physics.bodies[self.fingers[i]];
            let along_x = body.linvel().x + rise.x - damped;
            body.set_linvel(Vector::new(along_x, base_velocity.y, base_velocity.z), true);
            // The face stops at the gripper's centre.
            let to_go = finger_x(finger, 0.0, self.settings.pad.thickness_m)
                - (body.translation().x - base_x);
            let speed = (gain * to_go).clamp(-max_speed, max_speed);
            if let Some(joint) = self.physics.impulse_joints.get_mut(self.motors[i], true) {
                joint
                    .data
                    .set_motor_velocity(JointAxis::LinX, speed, MOTOR_DAMPING);
            }
        }
        self.physics.step();
    }

    /// Whether the state is finite.
    pub(super) fn is_finite(&self) -> bool {
        let bodies = [self.object, self.fingers[0], self.fingers[1]];
        bodies.iter().all(|body| {
            let body = &self.physics.bodies[*body];
            body.is_enabled() && body.position().is_finite() && body.linvel().is_finite()
        })
    }

    pub(super) fn t_world_object(&self) -> Pose {
        self.t_world_gripper * convert::from_pose(self.physics.bodies[self.object].position())
    }

    /// Height of the object's centre of mass above the ground, m.
    pub(super) fn object_height_m(&self) -> f64 {
        self.t_world_object()
            .transform_point(self.center_of_mass_m)
            .z
    }

    /// Linear (m/s) and angular (rad/s) speed of the object.
    #[cfg(test)]
    pub(super) fn object_speed(&self) -> (f64, f64) {
        let body = &self.physics.bodies[self.object];
        (body.linvel().length(), body.angvel().length())
    }

    /// Distance between the faces of the fingers, m.
    pub(super) fn opening_m(&self) -> f64 {
        let [left, right] = self.fingers.map(|f| self.physics.bodies[f].translation().x);
        right - left - self.settings.pad.thickness_m
    }

    /// Contact forces on the fingers, averaged over the last time step.
    pub(super) fn forces(&self) -> [GelForce; 2] {
        [0, 1].map(|i| {
            let closing = Finger::BOTH[i].closing();
            let (mut force, mut moment) = (DVec3::ZERO, DVec3::ZERO);
            self.for_each_contact(i, |arm, f, _| {
                force += f;
                moment += arm.cross(f);
            });
            GelForce {
                normal_n: -force.dot(closing),
                shear_n: [force.y, force.z],
                torque_n_m: moment.dot(closing),
            }
        })
    }

    /// Smallest distance between each finger and the object, m; negative for an overlap.
    pub(super) fn gaps_m(&self) -> [Option<f64>; 2] {
        [0, 1].map(|i| {
            let mut gap: Option<f64> = None;
            self.for_each_contact(i, |_, _, distance| {
                gap = Some(gap.map_or(distance, |gap| gap.min(distance)));
            });
            gap
        })
    }

    /// Calls `visit` with each contact of a finger: its position relative to the finger's centre
    /// (m), the force on the finger (N) and the distance (m).
    fn for_each_contact(&self, finger: usize, mut visit: impl FnMut(DVec3, DVec3, f64)) {
        let dt = self.settings.dt_s;
        let substep = dt / f64::from(self.settings.solver_substeps);
        let body = self.fingers[finger];
        let colliders = self.physics.bodies[body].colliders();
        let pairs = colliders
            .iter()
            .flat_map(|c| self.physics.narrow_phase.contact_pairs_with(*c));
        for manifold in pairs.flat_map(|pair| pair.solver_manifolds()) {
            let is_second = manifold.data.rigid_body2 == Some(body);
            let sign = if is_second { 1.0 } else { -1.0 };
            // Other points of the manifold still hold impulses of earlier steps.
            for solved in &manifold.data.solver_contacts {
                let Some(point) = manifold
                    .points
                    .get((solved.contact_id[0] & POINT_MASK) as usize)
                else {
                    continue;
                };
                let data = &point.data;
                // Impulses push the second body along the normal and the first one in reverse.
                let normal = manifold.data.normal * (data.impulse / dt);
                let friction = data.warmstart_tangent_world / -substep;
                let arm = if is_second {
                    data.solver_dp2
                } else {
                    data.solver_dp1
                };
                visit(
                    convert::from_vector(arm),
                    convert::from_vector((normal + friction) * sign),
                    point.dist,
                );
            }
        }
    }
}

fn mass(properties: &MassProperties, mass_kg: f64) -> RapierMass {
    let inertia = properties.inertia_m5() * (mass_kg / properties.volume_m3);
    RapierMass::with_inertia_matrix(
        convert::vector(properties.center_of_mass_m),
        mass_kg,
        Matrix::from_cols_array(&inertia.to_cols_array()),
    )
}

/// Solver parameters, with tolerances scaled from bodies of 1 m to a gripper and all approximations
/// disabled.
fn integration(settings: &RigidSettings) -> IntegrationParameters {
    let softness = SpringCoefficients {
        natural_frequency: settings.contact_frequency_hz,
        damping_ratio: settings.contact_damping_ratio,
    };
    IntegrationParameters {
        dt: settings.dt_s,
        contact_softness: softness,
        static_contact_softness: softness,
        num_solver_iterations: settings.solver_substeps as usize,
        normalized_allowed_linear_error: 1e-5,
        normalized_max_corrective_velocity: MAX_CORRECTION_M_S,
        normalized_prediction_distance: settings.prediction_m,
        max_ccd_substeps: 0,
        contact_clustering: false,
        contact_recycling: false,
        friction_model: FrictionModel::Coulomb,
        ..IntegrationParameters::default()
    }
}
