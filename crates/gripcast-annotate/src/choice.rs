//! Which images a pose is taken from.

use glam::{DQuat, DVec3};

use super::observation::Observation;
use gripcast_geometry::Pose;

/// Fingers that have moved by this much are closing, m.
const CLOSING_M: f64 = 1e-3;
/// A gripper that moves less than this between images is at rest, m and rad.
const REST_M: f64 = 1e-3;
const REST_RAD: f64 = 0.01;
/// Most images that are used.
const MAX: usize = 5;
/// Images more blurred than the sharpest by this factor are left out.
const BLURRED: f64 = 1.25;

/// Images that are used, and their pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// Numbers of the observations, ascending; at least one.
    pub used: Vec<usize>,
    /// Mean of their poses.
    pub t_object_gripper: Pose,
    /// Mean of their covariances. What the images have in common, such as the corners' bias at
    /// one place, does not average out, so it is not divided by their number.
    pub covariance: [[f64; 6]; 6],
    /// Largest distance of one from the mean, m.
    pub spread_m: f64,
    /// The same as an angle, rad.
    pub spread_rad: f64,
    /// What a person should know.
    pub notes: Vec<String>,
}

impl Choice {
    /// The newest observation that is used.
    #[must_use]
    pub fn last(&self) -> usize {
        self.used.last().copied().unwrap_or(0)
    }
}

/// The last sharp images before the gripper moves, of observations by time: those at rest until
/// the fingers begin to close. Fingers close when the opening that the tags show falls by a
/// millimetre below its largest; where no finger's tag is seen, all images are from before.
/// None without observations.
#[must_use]
pub fn choose(observations: &[&Observation]) -> Option<Choice> {
    let mut notes = Vec::new();
    let sound = |i: &usize| !observations[*i].is_ambiguous();
    let mut candidates: Vec<usize> = (0..observations.len()).filter(sound).collect();
    if candidates.is_empty() {
        candidates = (0..observations.len()).collect();
    }
    let opening = |i: usize| observations[i].gripper.opening.map(|o| o.opening_m);
    let widest = candidates
        .iter()
        .filter_map(|i| opening(*i))
        .fold(f64::NEG_INFINITY, f64::max);
    let is_open = |i: usize| opening(i).is_none_or(|opening| opening > widest - CLOSING_M);
    let last = candidates.iter().rposition(|i| is_open(*i))?;
    let blur = |i: &usize| observations[*i].blur_px;
    let sharpest = candidates[..=last]
        .iter()
        .map(blur)
        .fold(f64::INFINITY, f64::min);
    // Blurred ones move, or seem to.
    let sharp: Vec<usize> = candidates[..=last]
        .iter()
        .copied()
        .filter(|i| is_open(*i) && blur(i) <= BLURRED * sharpest)
        .collect();
    let end = *sharp.last()?;
    let is_at_rest = |i: &usize| {
        let (a, b) = (pose(observations[*i]), pose(observations[end]));
        a.translation_m.distance(b.translation_m) < REST_M && a.rotation_from(b).length() < REST_RAD
    };
    let mut used: Vec<usize> = sharp.iter().rev().copied().take_while(is_at_rest).collect();
    if used.len() < 2 && observations.len() > 2 {
        notes.push("the gripper was not at rest before it closed".to_owned());
    }
    used.truncate(MAX);
    used.sort_unstable();
    let chosen: Vec<&Observation> = used.iter().map(|i| observations[*i]).collect();
    let t_object_gripper = mean(&chosen);
    let off = |seen: &&Observation| {
        let shift = pose(seen).translation_m - t_object_gripper.translation_m;
        (
            shift.length(),
            pose(seen).rotation_from(&t_object_gripper).length(),
        )
    };
    let (spread_m, spread_rad) = chosen
        .iter()
        .map(off)
        .fold((0.0, 0.0), |a, b| (f64::max(a.0, b.0), f64::max(a.1, b.1)));
    let count = chosen.len() as f64;
    let mut covariance = [[0.0; 6]; 6];
    for seen in &chosen {
        for (row, other) in covariance.iter_mut().zip(seen.relative.covariance) {
            for (value, other) in row.iter_mut().zip(other) {
                *value += other / count;
            }
        }
    }
    Some(Choice {
        used,
        t_object_gripper,
        covariance,
        spread_m,
        spread_rad,
        notes,
    })
}

fn pose(seen: &Observation) -> &Pose {
    &seen.relative.t_object_gripper
}

/// Mean of poses that are nearly the same.
fn mean(seen: &[&Observation]) -> Pose {
    let Some(first) = seen.first() else {
        return Pose::IDENTITY;
    };
    let count = seen.len() as f64;
    let turns = seen.iter().map(|s| pose(s).rotation_from(pose(first)));
    let turn = DQuat::from_scaled_axis(turns.sum::<DVec3>() / count);
    let translation = seen.iter().map(|s| pose(s).translation_m).sum::<DVec3>() / count;
    Pose::new(turn * pose(first).rotation, translation)
}
