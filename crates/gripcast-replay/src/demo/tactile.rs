//! Frames of the demo data's tactile sensors: GelSight Minis that differ from the shipped profile.

use gripcast_base::error::{Error, Result};
use gripcast_geometry::TriangleMesh;
use gripcast_imaging::encode_jpeg;
use gripcast_sim::grasp::{Finger, GripperState, Snapshot};
use gripcast_tactile::{
    ObjectDepthRenderer, SceneRenderer as _, SensorMount, SensorProfile, SensorVariation,
    SimulatedGel, TactileScene, WholeFrame,
};

/// Size of the frames, px: a stream of the Mini.
pub(super) const FRAME: [u32; 2] = [640, 480];
/// JPEG quality of the frames.
const QUALITY: u8 = 92;

/// How the left and the right sensor differ from the shipped profile.
const VARIATIONS: [SensorVariation; 2] = [
    SensorVariation {
        light: [1.10, 0.93, 0.96],
        response: [0.85, 1.12, 0.95],
        noise: 1.6,
        smoothing: 1.2,
        is_mirrored: true,
        ..SensorVariation::NONE
    },
    SensorVariation {
        light: [0.92, 1.06, 1.03],
        response: [1.10, 0.88, 1.08],
        noise: 1.5,
        smoothing: 1.1,
        is_mirrored: true,
        ..SensorVariation::NONE
    },
];

/// Returns the sensor profile of a finger: the shipped profile with its background mirrored and
/// rescaled per colour, another response to slopes, and more noise and smoothing. The amounts are
/// chosen, not measured.
///
/// # Errors
/// None; a test checks that.
pub(super) fn sensor(finger: Finger) -> Result<SensorProfile> {
    let variation = &VARIATIONS[finger as usize];
    let mut profile = variation.apply(&SensorProfile::gelsight_mini()?);
    profile.name = format!("demo-{}", ["left", "right"][finger as usize]);
    profile.provenance = format!(
        "Not a real sensor: the shipped gelsight-mini profile with its background mirrored and \
         scaled by {:?}, its shading scaled by {:?}, its noise by {} and its smoothing by {}.",
        variation.light, variation.response, variation.noise, variation.smoothing
    );
    profile.validate()?;
    Ok(profile)
}

/// Contact of both sensors in a grasp.
pub(super) struct Contact<'a> {
    /// The object in its own frame, m.
    pub(super) mesh: &'a TriangleMesh,
    /// The simulated gels.
    pub(super) gel: &'a SimulatedGel,
    /// Pose of the object before the fingers close.
    pub(super) t_world_object: gripcast_geometry::Pose,
    /// Pose and opening of the gripper before the fingers close.
    pub(super) placed: &'a GripperState,
    /// State before the lift.
    pub(super) pre_lift: &'a Snapshot,
}

/// Renders the JPEG frames of a sensor before closing and before the lift; the seeds draw the
/// noise.
///
/// # Errors
/// `Input` if the snapshot does not belong to the gel.
pub(super) fn tactile_frames(
    profile: &SensorProfile,
    contact: &Contact<'_>,
    finger: Finger,
    seeds: [u64; 2],
) -> Result<[Vec<u8>; 2]> {
    let mut renderer = ObjectDepthRenderer::new(profile)?;
    let sensor = SensorMount::on(finger);
    let poses = [&contact.t_world_object, &contact.placed.t_world_gripper];
    let opening_m = contact.placed.opening_m;
    let before = TactileScene::before_closing(contact.mesh, contact.gel, poses, opening_m, sensor)?;
    let after = TactileScene::from_snapshot(contact.mesh, contact.gel, contact.pre_lift, sensor)?;
    let full = (FRAME[0], FRAME[1]);
    let window = profile.crop_profile.window(full.0, full.1);
    let window = window.ok_or_else(|| Error::internal("the crop leaves nothing of the frame"))?;
    let whole = WholeFrame::new(profile, window, full, full);
    let untouched = renderer.render(&before.untouched(), None)?;
    let mut frame = |scene: &TactileScene<'_>, seed| -> Result<Vec<u8>> {
        let image = renderer.render(scene, Some(seed))?;
        encode_jpeg(&whole.compose(&image, &untouched)?, QUALITY)
    };
    Ok([frame(&before, seeds[0])?, frame(&after, seeds[1])?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_testing::mean_difference;

    #[test]
    fn sensors_differ_from_shipped_profile_and_each_other() {
        let shipped = SensorProfile::gelsight_mini().unwrap();
        let [left, right] = Finger::BOTH.map(|finger| sensor(finger).unwrap());
        let image = |p: &SensorProfile| p.background.image.clone().unwrap();
        assert!(mean_difference(&image(&left), &image(&shipped)) > 5.0);
        assert!(mean_difference(&image(&left), &image(&right)) > 5.0);
        assert_ne!(left.shading, shipped.shading);
        assert!(left.noise_std[0] > 1.4 * shipped.noise_std[0]);
        assert!(left.provenance.starts_with("Not a real sensor"));
    }
}
