//! Starting poses for the search: each marker alone allows two.

use glam::{DVec2, DVec3};

use super::ippe::both_poses;
use super::reprojection::State;
use super::sighting::Sighting;
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Markers that give starting poses, the largest in the image first.
const MAX_MARKERS: usize = 8;
/// Starting poses that are worth a search.
const MAX_KEPT: usize = 4;
/// Error beyond which a corner tells nothing but that it is wrong, px.
const WRONG_PX: f64 = 10.0;
/// Rotations closer than this lead to one minimum, rad.
const SAME_RAD: f64 = 0.035;

/// Angle between two rotations, rad.
pub(super) fn angle_between(a: &Pose, b: &Pose) -> f64 {
    let (s, c) = {
        let d = a.rotation.conjugate() * b.rotation;
        (d.xyz().length(), d.w.abs())
    };
    2.0 * s.atan2(c)
}

/// The most promising starting states, best first. A wrong marker spoils only its own.
pub(super) fn hypotheses(
    intrinsics: &Intrinsics,
    sightings: &[&Sighting],
    openings_m: &[f64],
) -> Vec<State> {
    let mut by_area: Vec<&Sighting> = sightings.to_vec();
    by_area.sort_by(|a, b| b.area_px().total_cmp(&a.area_px()));
    by_area.truncate(MAX_MARKERS);
    let mut scored: Vec<(f64, State)> = Vec::new();
    let mut consider = |state: State| scored.push((score(intrinsics, sightings, &state), state));
    for sighting in &by_area {
        let points = sighting.corners.map(|c| c.point_m);
        for pose in both_poses(&points, &sighting.ideal).into_iter().flatten() {
            for opening_m in openings_m {
                let slid = DVec3::X * (sighting.corners[0].slide * opening_m);
                consider(State {
                    pose: pose * Pose::from_translation(-slid),
                    opening_m: *opening_m,
                });
            }
        }
    }
    for state in together(sightings) {
        consider(state);
    }
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

/// Both poses of all markers as one plane, where they are one.
pub(super) fn together(sightings: &[&Sighting]) -> Vec<State> {
    let corners = || sightings.iter().flat_map(|s| s.corners);
    if sightings.len() < 2 || corners().any(|c| c.slide != 0.0) {
        return Vec::new();
    }
    let points: Vec<DVec3> = corners().map(|c| c.point_m).collect();
    let ideal: Vec<DVec2> = sightings.iter().flat_map(|s| s.ideal).collect();
    let poses = both_poses(&points, &ideal);
    let state = |pose| State {
        pose,
        opening_m: 0.0,
    };
    poses.into_iter().flatten().map(state).collect()
}

/// Sum of squared errors, each at most that of a wrong corner, px².
fn score(intrinsics: &Intrinsics, sightings: &[&Sighting], state: &State) -> f64 {
    sightings
        .iter()
        .flat_map(|s| s.errors_px(intrinsics, state))
        .map(|error| error.min(WRONG_PX).powi(2))
        .sum()
}
