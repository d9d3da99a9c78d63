//! Selection of the observations that a pose is averaged from.

use glam::{DQuat, DVec3};

use super::observation::Observation;
use gripcast_geometry::Pose;

/// Decrease of the opening at which the fingers count as closing, m.
const CLOSING_M: f64 = 1e-3;
/// Maximum motion of a gripper at rest, m and rad.
const REST_M: f64 = 1e-3;
const REST_RAD: f64 = 0.01;
/// Maximum number of selected images.
const MAX: usize = 5;
/// Maximum blur relative to the sharpest image.
const MAX_BLUR: f64 = 1.25;

/// Selected observations and their mean pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Selection {
    /// Indices of the observations, ascending; at least one.
    pub used: Vec<usize>,
    /// Mean of their poses.
    pub t_object_gripper: Pose,
    /// Mean of their covariances, not divided by their number: the errors are correlated.
    pub covariance: [[f64; 6]; 6],
    /// Maximum distance from the mean, m.
    pub spread_m: f64,
    /// Maximum rotation from the mean, rad.
    pub spread_rad: f64,
    /// Notes for the user.
    pub notes: Vec<String>,
}

impl Selection {
    /// Index of the latest selected observation.
    #[must_use]
    pub fn last(&self) -> usize {
        self.used.last().copied().unwrap_or(0)
    }
}

/// Selects, from observations in order of time, the last sharp ones of the gripper at rest before
/// the fingers close: before the opening decreases by 1 mm. Observations without an opening count
/// as open. `None`: there are no observations.
#[must_use]
pub fn select(observations: &[&Observation]) -> Option<Selection> {
    let mut notes = Vec::new();
    let is_unambiguous = |i: &usize| !observations[*i].is_ambiguous();
    let mut candidates: Vec<usize> = (0..observations.len()).filter(is_unambiguous).collect();
    if candidates.is_empty() {
        candidates = (0..observations.len()).collect();
    }
    let opening = |i: usize| observations[i].gripper.opening.map(|o| o.opening_m);
    let max_opening = candidates
        .iter()
        .filter_map(|i| opening(*i))
        .fold(f64::NEG_INFINITY, f64::max);
    let is_open = |i: usize| opening(i).is_none_or(|opening| opening > max_opening - CLOSING_M);
    let last = candidates.iter().rposition(|i| is_open(*i))?;
    let blur = |i: &usize| observations[*i].blur_px;
    let sharpest = candidates[..=last]
        .iter()
        .map(blur)
        .fold(f64::INFINITY, f64::min);
    // Blurred images show motion.
    let sharp: Vec<usize> = candidates[..=last]
        .iter()
        .copied()
        .filter(|i| is_open(*i) && blur(i) <= MAX_BLUR * sharpest)
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
    let selected: Vec<&Observation> = used.iter().map(|i| observations[*i]).collect();
    let t_object_gripper = mean(&selected);
    let deviation = |observation: &&Observation| {
        let pose = pose(observation);
        let shift = pose.translation_m - t_object_gripper.translation_m;
        (
            shift.length(),
            pose.rotation_from(&t_object_gripper).length(),
        )
    };
    let (spread_m, spread_rad) = selected
        .iter()
        .map(deviation)
        .fold((0.0, 0.0), |a, b| (f64::max(a.0, b.0), f64::max(a.1, b.1)));
    let count = selected.len() as f64;
    let mut covariance = [[0.0; 6]; 6];
    for observation in &selected {
        for (row, other) in covariance.iter_mut().zip(observation.relative.covariance) {
            for (value, other) in row.iter_mut().zip(other) {
                *value += other / count;
            }
        }
    }
    Some(Selection {
        used,
        t_object_gripper,
        covariance,
        spread_m,
        spread_rad,
        notes,
    })
}

fn pose(observation: &Observation) -> &Pose {
    &observation.relative.t_object_gripper
}

/// Mean of similar poses.
fn mean(observations: &[&Observation]) -> Pose {
    let Some(first) = observations.first() else {
        return Pose::IDENTITY;
    };
    let count = observations.len() as f64;
    let poses = || observations.iter().map(|o| pose(o));
    let rotations = poses().map(|p| p.rotation_from(pose(first)));
    let rotation = DQuat::from_scaled_axis(rotations.sum::<DVec3>() / count);
    let translation = poses().map(|p| p.translation_m).sum::<DVec3>() / count;
    Pose::new(rotation * pose(first).rotation, translation)
}
