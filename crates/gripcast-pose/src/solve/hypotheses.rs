//! Initial poses of the search: two per marker.

use glam::{DVec2, DVec3};

use super::ippe::both_poses;
use super::observation::MarkerObservation;
use super::reprojection::State;
use crate::least_squares::angle_between;
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Maximum number of markers that initial poses are computed from, the largest in the image.
const MAX_MARKERS: usize = 8;
/// Maximum number of initial poses.
const MAX_KEPT: usize = 4;
/// Reprojection errors are clamped to this for the score, px.
const MAX_ERROR_PX: f64 = 10.0;
/// Rotations closer than this count as one hypothesis, rad.
const SAME_RAD: f64 = 0.035;

/// The best initial states by reprojection error, best first.
pub(super) fn hypotheses(
    intrinsics: &Intrinsics,
    observations: &[&MarkerObservation],
    openings_m: &[f64],
) -> Vec<State> {
    let mut by_area: Vec<&MarkerObservation> = observations.to_vec();
    by_area.sort_by(|a, b| b.area_px().total_cmp(&a.area_px()));
    by_area.truncate(MAX_MARKERS);
    let mut scored: Vec<(f64, State)> = Vec::new();
    let mut add = |state: State| scored.push((score(intrinsics, observations, &state), state));
    for observation in &by_area {
        let points = observation.corners.map(|c| c.point_m);
        for pose in both_poses(&points, &observation.ideal)
            .into_iter()
            .flatten()
        {
            for opening_m in openings_m {
                let offset = DVec3::X * (observation.corners[0].slide * opening_m);
                add(State {
                    pose: pose * Pose::from_translation(-offset),
                    opening_m: *opening_m,
                });
            }
        }
    }
    coplanar_poses(observations).into_iter().for_each(add);
    scored.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut kept: Vec<State> = Vec::new();
    for (_, state) in scored {
        let is_new = kept
            .iter()
            .all(|k| angle_between(&k.pose, &state.pose) > SAME_RAD);
        if is_new && kept.len() < MAX_KEPT {
            kept.push(state);
        }
    }
    kept
}

/// Both poses of all markers if they are coplanar.
pub(super) fn coplanar_poses(observations: &[&MarkerObservation]) -> Vec<State> {
    let corners = || observations.iter().flat_map(|s| s.corners);
    if observations.len() < 2 || corners().any(|c| c.slide != 0.0) {
        return Vec::new();
    }
    let points: Vec<DVec3> = corners().map(|c| c.point_m).collect();
    let ideal: Vec<DVec2> = observations.iter().flat_map(|s| s.ideal).collect();
    let poses = both_poses(&points, &ideal);
    let state = |pose| State {
        pose,
        opening_m: 0.0,
    };
    poses.into_iter().flatten().map(state).collect()
}

/// Sum of the squared errors, clamped to [`MAX_ERROR_PX`], px².
fn score(intrinsics: &Intrinsics, observations: &[&MarkerObservation], state: &State) -> f64 {
    observations
        .iter()
        .flat_map(|s| s.errors_px(intrinsics, state))
        .map(|error| error.min(MAX_ERROR_PX).powi(2))
        .sum()
}
