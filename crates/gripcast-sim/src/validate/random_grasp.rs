//! Seeded random grasps of the built-in objects.

use glam::{DMat3, DQuat, DVec3};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use crate::fem::GelResolution;
use crate::grasp::{GelSpec, Protocol, Scene};
use gripcast_base::error::Result;
use gripcast_geometry::{Pose, builtin};

/// A grasp that can be built again from its number.
#[derive(Clone, Debug)]
pub(super) struct RandomGrasp {
    /// What it is, in words.
    pub(super) name: String,
    pub(super) scene: Scene,
    pub(super) protocol: Protocol,
}

/// The shapes that are grasped in turn.
pub(super) const SHAPES: [&str; 7] = ["box", "sphere", "cylinder", "mug", "wedge", "bar", "spike"];
/// Lowest height of the gels' centres, m: half a pad and room for tilt.
const MIN_M: f64 = 0.0165;
/// Room between gels and object at the start, m for both sides.
const ROOM_M: f64 = 0.002;

/// Grasp `number` of `seed`: object, the side it lies on, turn, offsets, tilt, mass, friction and
/// force at random. About half of the poses push, turn or tilt the object.
///
/// # Errors
/// None for the built-in objects.
pub(super) fn random_grasp(seed: u64, number: u64, gel: GelResolution) -> Result<RandomGrasp> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let name = SHAPES[(number % SHAPES.len() as u64) as usize];
    let mesh = builtin(name)?;
    let lies = match rng.random_range(0..3_u32) {
        0 => DQuat::IDENTITY,
        1 => DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2),
        _ => DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2),
    };
    let is_hard = rng.random_bool(0.5);
    let reach = if is_hard { 1.0 } else { 0.1 };
    let turn = DQuat::from_rotation_z(rng.random_range(0.0..std::f64::consts::TAU));
    let laid = mesh.transformed(&Pose::new(turn * lies, DVec3::ZERO));
    let bounds = laid.bounds();
    let middle = bounds.center();
    let place = DVec3::new(-middle.x, -middle.y, -bounds.min.z);
    let height = bounds.extent().z;
    let offset = DVec3::new(
        reach * rng.random_range(-0.004..0.004),
        reach * rng.random_range(-0.012..0.012),
        (0.5 * height + reach * rng.random_range(-0.4..0.4) * height).max(MIN_M),
    );
    let down = DQuat::from_mat3(&DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z));
    let tilt = DQuat::from_rotation_y(reach * rng.random_range(-0.15..0.15));
    let force = rng.random_range(10.0..70.0);
    let friction = rng.random_range(0.1..0.9);
    let mass_kg = rng.random_range(0.03..0.25);
    // Wide enough for the whole object, wherever the gripper stands.
    let opening = bounds.extent().x + 2.0 * offset.x.abs() + 0.15 * height * reach + ROOM_M;
    Ok(RandomGrasp {
        name: format!("{number}: {name}{}", if is_hard { ", hard" } else { "" }),
        scene: Scene {
            mesh,
            mass_kg,
            friction,
            t_world_object: Pose::new(turn * lies, place),
            t_world_gripper: Pose::new(tilt * down, offset),
            opening_m: opening.min(0.2),
            gel: GelSpec::standard(gel)?,
        },
        protocol: Protocol {
            stop_force_n: force,
            ..Protocol::default()
        },
    })
}
