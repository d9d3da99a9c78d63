//! Seeded random grasps of the built-in objects.

use glam::{DMat3, DQuat, DVec3};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use crate::fem::GelResolution;
use crate::grasp::{GelSpec, Protocol, Scene};
use gripcast_base::error::Result;
use gripcast_geometry::{Pose, builtin};

/// A reproducible random grasp.
#[derive(Clone, Debug)]
pub(super) struct RandomGrasp {
    /// Description.
    pub(super) name: String,
    pub(super) scene: Scene,
    pub(super) protocol: Protocol,
}

/// Built-in shapes, used in turn.
pub(super) const SHAPES: [&str; 7] = ["box", "sphere", "cylinder", "mug", "wedge", "bar", "spike"];
/// Minimum height of the gel centres, m: half a pad plus a margin for roll.
const MIN_HEIGHT_M: f64 = 0.0165;
/// Initial clearance between gels and object, both sides together, m.
const CLEARANCE_M: f64 = 0.002;

/// Returns grasp `number` of `seed` with random object, resting side, yaw, offsets, roll, mass,
/// friction and force. About half of the poses push, rotate or tip the object.
///
/// # Errors
/// None: the built-in objects are valid.
pub(super) fn random_grasp(seed: u64, number: u64, gel: GelResolution) -> Result<RandomGrasp> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let name = SHAPES[(number % SHAPES.len() as u64) as usize];
    let mesh = builtin(name)?;
    let resting = match rng.random_range(0..3_u32) {
        0 => DQuat::IDENTITY,
        1 => DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2),
        _ => DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2),
    };
    let is_hard = rng.random_bool(0.5);
    let reach = if is_hard { 1.0 } else { 0.1 };
    let yaw = DQuat::from_rotation_z(rng.random_range(0.0..std::f64::consts::TAU));
    let rotated = mesh.transformed(&Pose::new(yaw * resting, DVec3::ZERO));
    let bounds = rotated.bounds();
    let center = bounds.center();
    let position = DVec3::new(-center.x, -center.y, -bounds.min.z);
    let height = bounds.extent().z;
    let offset = DVec3::new(
        reach * rng.random_range(-0.004..0.004),
        reach * rng.random_range(-0.012..0.012),
        (0.5 * height + reach * rng.random_range(-0.4..0.4) * height).max(MIN_HEIGHT_M),
    );
    let down = DQuat::from_mat3(&DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z));
    let roll = DQuat::from_rotation_y(reach * rng.random_range(-0.15..0.15));
    let force = rng.random_range(10.0..70.0);
    let friction = rng.random_range(0.1..0.9);
    let mass_kg = rng.random_range(0.03..0.25);
    // Wide enough for the whole object at any gripper position.
    let opening = bounds.extent().x + 2.0 * offset.x.abs() + 0.15 * height * reach + CLEARANCE_M;
    Ok(RandomGrasp {
        name: format!("{number}: {name}{}", if is_hard { ", hard" } else { "" }),
        scene: Scene {
            mesh,
            mass_kg,
            friction,
            t_world_object: Pose::new(yaw * resting, position),
            t_world_gripper: Pose::new(roll * down, offset),
            opening_m: opening.min(0.2),
            gel: GelSpec::standard(gel)?,
        },
        protocol: Protocol {
            stop_force_n: force,
            ..Protocol::default()
        },
    })
}
