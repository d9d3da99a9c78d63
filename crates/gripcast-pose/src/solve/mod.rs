//! Poses from detected markers: starts from each marker's two possible poses, joint
//! Levenberg–Marquardt over all corners of a rigid part, covariance, ambiguity.

pub(super) mod homography;
mod hypotheses;
mod ippe;
mod part_pose;
mod reprojection;
mod sighting;
#[cfg(test)]
mod solve_test;

pub use part_pose::{GripperPose, MarkerResidual, Opening, PartPose, RelativePose, relative};

use super::board::{Board, Part};
use super::detection::Detection;
use gripcast_base::error::{Error, Result};
use gripcast_base::statistics::median;
use gripcast_imaging::Intrinsics;
use hypotheses::{angle_between, hypotheses, together};
use reprojection::{Fit, Observation, State, minimise};
use sighting::{Sighting, normals_apart, sightings};

/// Standard deviation of a corner's coordinate that no detector betters on real images, px.
const MIN_SIGMA_PX: f64 = 0.03;
/// As many residuals of [`MIN_SIGMA_PX`] are added before a deviation is taken of few.
const PRIOR_RESIDUALS: f64 = 4.0;
/// Residuals of the least-squares part of the loss, times their median.
const LOSS_OF_MEDIAN: f64 = 2.0;
/// Loss of the first search, px.
const ROUGH_LOSS_PX: f64 = 2.0;
/// The loss is never narrower, px.
const MIN_LOSS_PX: f64 = 0.1;
/// A marker is an outlier if it fits worse than this and than [`OUTLIER_OF_MEDIAN`], px.
const OUTLIER_PX: f64 = 1.0;
/// See [`OUTLIER_PX`]; times the median residual.
const OUTLIER_OF_MEDIAN: f64 = 5.0;
/// With a larger error the markers are not where the board's description has them, px.
const CONTRADICTION_PX: f64 = 4.0;
/// Minima nearer than this are one, rad.
const SAME_MINIMUM_RAD: f64 = 0.017;
/// Markers whose normals are this far apart have one pose: 30°.
const UNAMBIGUOUS_RAD: f64 = std::f64::consts::FRAC_PI_6;
/// The runner-up is refuted by this many squared deviations of a corner …
const REFUTED: f64 = 25.0;
/// … which is at least this, px, as single markers hide their errors well.
const REFUTED_SIGMA_PX: f64 = 0.1;
/// Openings that searches start from, m.
const OPENINGS_M: [f64; 3] = [0.0, 0.04, 0.08];

/// Pose of one rigid part from its markers among `detections`.
///
/// # Errors
/// `Input` if none of its markers was seen, or if they contradict the board's description.
pub fn solve_part(
    board: &Board,
    part: Part,
    detections: &[Detection],
    intrinsics: &Intrinsics,
) -> Result<PartPose> {
    let (seen, notes) = sightings(board, &[part], detections, intrinsics);
    // A rigid part's own markers do not slide against each other.
    let seen: Vec<Sighting> = seen.into_iter().map(|s| slid(s, 0.0)).collect();
    let solved = solve::<6>(board, part, &seen, intrinsics, &[0.0])?;
    Ok(part_pose(part, &seen, solved, notes))
}

/// Pose of the gripper from the markers on its body and fingers, with its opening.
///
/// The fingers move along ∓x by half of the opening. A `known_opening_m` is taken as exact; it is
/// needed if all markers that were seen are on one finger.
///
/// # Errors
/// `Input` if no marker of the gripper was seen, if the opening is not determined, or if the
/// markers contradict the board's description.
pub fn solve_gripper(
    board: &Board,
    detections: &[Detection],
    intrinsics: &Intrinsics,
    known_opening_m: Option<f64>,
) -> Result<GripperPose> {
    let parts = [Part::Body, Part::FingerLeft, Part::FingerRight];
    let (seen, mut notes) = sightings(board, &parts, detections, intrinsics);
    let slides = |s: &Sighting| s.corners[0].slide;
    let fingers = seen.iter().any(|s| slides(s) != 0.0);
    let one_slide = seen.windows(2).all(|s| slides(&s[0]) == slides(&s[1]));
    let known = match known_opening_m {
        Some(opening_m) => Some(opening_m),
        None if !fingers => Some(0.0),
        None => None,
    };
    if let Some(opening_m) = known {
        let seen: Vec<Sighting> = seen.into_iter().map(|s| slid(s, opening_m)).collect();
        let solved = solve::<6>(board, Part::Body, &seen, intrinsics, &[0.0])?;
        let opening = known_opening_m.map(|opening_m| Opening {
            opening_m,
            sigma_m: 0.0,
        });
        let body = part_pose(Part::Body, &seen, solved, notes);
        return Ok(GripperPose { body, opening });
    }
    if one_slide {
        return Err(Error::input(
            "only markers of one finger were seen, so that pose and opening cannot be told apart",
        )
        .remedy(
            "give the opening, or let the camera see the body's or the other finger's markers",
        ));
    }
    let solved = match solve::<7>(board, Part::Body, &seen, intrinsics, &OPENINGS_M) {
        Ok(solved) => solved,
        // Without its only finger marker, which may be the outlier, nothing tells the opening.
        Err(error) => {
            return solve_body(board, seen, intrinsics, notes).ok_or(error);
        }
    };
    let opening = Opening {
        opening_m: solved.fit.state.opening_m,
        sigma_m: solved.sigma_px * solved.fit.inverse_information[6][6].sqrt(),
    };
    if opening.opening_m < -3.0 * opening.sigma_m - 1e-3 {
        notes.push(format!(
            "the opening of {:.1} mm is below 0: left and right finger may be exchanged in the \
             board's description",
            1e3 * opening.opening_m
        ));
    }
    Ok(GripperPose {
        body: part_pose(Part::Body, &seen, solved, notes),
        opening: Some(opening),
    })
}

/// The gripper from the markers of its body alone; none if they contradict each other, or there
/// are none.
fn solve_body(
    board: &Board,
    mut seen: Vec<Sighting>,
    intrinsics: &Intrinsics,
    mut notes: Vec<String>,
) -> Option<GripperPose> {
    let on_finger = |s: &Sighting| s.corners[0].slide != 0.0;
    let left_out: Vec<String> = seen
        .iter()
        .filter(|s| on_finger(s))
        .map(|s| s.id.to_string())
        .collect();
    seen.retain(|s| !on_finger(s));
    let solved = solve::<6>(board, Part::Body, &seen, intrinsics, &[0.0]).ok()?;
    notes.push(format!(
        "the fingers' marker {} was left out: it is not where the body's markers put it",
        left_out.join(", ")
    ));
    Some(GripperPose {
        body: part_pose(Part::Body, &seen, solved, notes),
        opening: None,
    })
}

/// The marker where `opening_m` puts it, as part of a rigid body.
fn slid(mut sighting: Sighting, opening_m: f64) -> Sighting {
    for corner in &mut sighting.corners {
        corner.point_m.x += corner.slide * opening_m;
        corner.slide = 0.0;
    }
    sighting
}

/// Another pose that fits.
struct Rival {
    state: State,
    cost: f64,
    is_minimum: bool,
}

impl Rival {
    fn new<const N: usize>(fit: &Fit<N>, is_minimum: bool) -> Self {
        Self {
            state: fit.state,
            cost: fit.cost,
            is_minimum,
        }
    }
}

/// A minimum with what is known about it.
struct Solved<const N: usize> {
    fit: Fit<N>,
    runner_up: Option<State>,
    ambiguity: Option<f64>,
    ambiguous: bool,
    rms_px: f64,
    sigma_px: f64,
    /// By sighting.
    residuals: Vec<MarkerResidual>,
    normals_apart_rad: f64,
}

fn solve<const N: usize>(
    board: &Board,
    part: Part,
    seen: &[Sighting],
    intrinsics: &Intrinsics,
    openings_m: &[f64],
) -> Result<Solved<N>> {
    let all: Vec<&Sighting> = seen.iter().collect();
    if all.is_empty() {
        return Err(unseen(board, part));
    }
    let starts = hypotheses(intrinsics, &all, openings_m);
    let (used, fit, loss_px) =
        without_outliers::<N>(intrinsics, all, &starts).ok_or_else(|| undetermined(board, seen))?;
    let rms_px = rms(intrinsics, &used, &fit.state);
    if rms_px > CONTRADICTION_PX {
        return Err(contradiction(board, &used, rms_px));
    }
    let sigma_px = corner_sigma::<N>(intrinsics, &used, &fit.state, loss_px);
    let apart = normals_apart(&used);
    let others = starts.into_iter().chain(together(&used));
    let bearable = REFUTED * sigma_px.max(REFUTED_SIGMA_PX).powi(2);
    let is_bearable = |rival: &Rival| rival.cost - fit.cost <= bearable;
    let rival = runner_up(intrinsics, &used, &fit, others, loss_px)
        .filter(|rival| rival.is_minimum || is_bearable(rival));
    let refuted = !rival.as_ref().is_some_and(is_bearable);
    let residuals = seen.iter().map(|s| MarkerResidual {
        id: s.id,
        rms_px: s.rms_px(intrinsics, &fit.state),
        used: used.iter().any(|u| std::ptr::eq(*u, s)),
    });
    Ok(Solved {
        residuals: residuals.collect(),
        ambiguity: rival
            .as_ref()
            .map(|rival| rms(intrinsics, &used, &rival.state) / rms_px.max(f64::MIN_POSITIVE)),
        runner_up: rival.map(|rival| rival.state),
        ambiguous: !refuted && apart < UNAMBIGUOUS_RAD,
        rms_px,
        sigma_px,
        normals_apart_rad: apart,
        fit,
    })
}

/// Solves, leaves out the worst marker as long as it is an outlier, and solves again. Two markers
/// that contradict each other do not tell which of them is wrong.
fn without_outliers<'a, const N: usize>(
    intrinsics: &Intrinsics,
    mut used: Vec<&'a Sighting>,
    starts: &[State],
) -> Option<(Vec<&'a Sighting>, Fit<N>, f64)> {
    loop {
        let (fit, loss_px) = best_fit::<N>(intrinsics, &used, starts)?;
        let limit = OUTLIER_PX.max(OUTLIER_OF_MEDIAN * median_error(intrinsics, &used, &fit.state));
        let worst = (0..used.len()).max_by(|a, b| {
            let rms = |i: &usize| used[*i].rms_px(intrinsics, &fit.state);
            rms(a).total_cmp(&rms(b))
        })?;
        if used.len() < 3 || used[worst].rms_px(intrinsics, &fit.state) <= limit {
            return Some((used, fit, loss_px));
        }
        used.remove(worst);
    }
}

/// The lowest minimum that the starts lead to, and its loss, which follows the residuals.
fn best_fit<const N: usize>(
    intrinsics: &Intrinsics,
    used: &[&Sighting],
    starts: &[State],
) -> Option<(Fit<N>, f64)> {
    let corners = corners(used);
    let search = |start: &State, loss_px| minimise::<N>(intrinsics, &corners, *start, loss_px);
    let rough: Vec<State> = starts
        .iter()
        .filter_map(|start| search(start, ROUGH_LOSS_PX))
        .map(|fit| fit.state)
        .collect();
    let median = rough
        .iter()
        .map(|state| median_error(intrinsics, used, state))
        .min_by(f64::total_cmp)?;
    let loss_px = MIN_LOSS_PX.max(LOSS_OF_MEDIAN * median);
    let fits = rough.iter().filter_map(|state| search(state, loss_px));
    let best = fits.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    Some((best, loss_px))
}

/// The best pose that is not `best`: another minimum, or the mirror image at its best distance
/// where it leads to no minimum of its own.
fn runner_up<const N: usize>(
    intrinsics: &Intrinsics,
    used: &[&Sighting],
    best: &Fit<N>,
    starts: impl Iterator<Item = State>,
    loss_px: f64,
) -> Option<Rival> {
    let corners = corners(used);
    let is_other = |state: &State| angle_between(&state.pose, &best.state.pose) > SAME_MINIMUM_RAD;
    starts
        .filter_map(|start| {
            let minimum = minimise::<N>(intrinsics, &corners, start, loss_px)
                .map(|fit| Rival::new(&fit, true));
            let mirror = || {
                minimise::<3>(intrinsics, &corners, start, loss_px)
                    .map(|fit| Rival::new(&fit, false))
            };
            let other = |rival: &Rival| is_other(&rival.state);
            minimum.filter(other).or_else(|| mirror().filter(other))
        })
        .min_by(|a, b| a.cost.total_cmp(&b.cost))
}

fn corners(used: &[&Sighting]) -> Vec<Observation> {
    used.iter().flat_map(|s| s.corners).collect()
}

fn median_error(intrinsics: &Intrinsics, used: &[&Sighting], state: &State) -> f64 {
    let errors = used.iter().flat_map(|s| s.errors_px(intrinsics, state));
    median(errors).unwrap_or(f64::INFINITY)
}

fn rms(intrinsics: &Intrinsics, used: &[&Sighting], state: &State) -> f64 {
    let squares = used.iter().map(|s| s.rms_px(intrinsics, state).powi(2));
    (squares.sum::<f64>() / used.len() as f64).sqrt()
}

/// Deviation of one coordinate of a corner: that of the residuals, as far as there are enough of
/// them to tell, and no better than any camera's.
fn corner_sigma<const N: usize>(
    intrinsics: &Intrinsics,
    used: &[&Sighting],
    state: &State,
    loss_px: f64,
) -> f64 {
    let weighted: f64 = used
        .iter()
        .flat_map(|s| s.errors_px(intrinsics, state))
        .map(|error| error * error.min(loss_px))
        .sum();
    let free = (8 * used.len()) as f64 - N as f64;
    let variance = (PRIOR_RESIDUALS * MIN_SIGMA_PX.powi(2) + weighted) / (PRIOR_RESIDUALS + free);
    variance.sqrt().max(MIN_SIGMA_PX)
}

fn part_pose<const N: usize>(
    part: Part,
    seen: &[Sighting],
    solved: Solved<N>,
    mut notes: Vec<String>,
) -> PartPose {
    let variance = solved.sigma_px.powi(2);
    let mut covariance = [[0.0; 6]; 6];
    for (row, from) in covariance.iter_mut().zip(&solved.fit.inverse_information) {
        for (value, from) in row.iter_mut().zip(from) {
            *value = variance * from;
        }
    }
    for marker in solved.residuals.iter().filter(|m| !m.used) {
        notes.push(format!(
            "marker {} was left out: it is {:.1} px from where the other markers put it",
            marker.id, marker.rms_px
        ));
    }
    if solved.ambiguous {
        notes.push(format!(
            "the pose is ambiguous: its mirror image fits as well ({} marker(s), normals {:.0}° \
             apart)",
            seen.len(),
            solved.normals_apart_rad.to_degrees()
        ));
    }
    PartPose {
        part,
        t_camera_part: solved.fit.state.pose,
        covariance,
        rms_px: solved.rms_px,
        corner_sigma_px: solved.sigma_px,
        markers: solved.residuals,
        ambiguity: solved.ambiguity,
        runner_up: solved.runner_up.map(|state| state.pose),
        ambiguous: solved.ambiguous,
        normals_apart_rad: solved.normals_apart_rad,
        notes,
    }
}

fn unseen(board: &Board, part: Part) -> Error {
    let what = match part {
        Part::Object => "the object's board",
        Part::Body => "the gripper",
        Part::FingerLeft => "the left finger",
        Part::FingerRight => "the right finger",
    };
    Error::input(format!("no marker of {what} ({}) was seen", board.name))
        .remedy("let the camera see it sharply, large enough (20 px a marker) and evenly lit")
}

fn undetermined(board: &Board, seen: &[Sighting]) -> Error {
    Error::input(format!(
        "the markers {} of {} do not determine a pose",
        ids(seen.iter()),
        board.name
    ))
    .remedy("check the corners in the board's description: four of a square, clockwise")
}

fn contradiction(board: &Board, used: &[&Sighting], rms_px: f64) -> Error {
    Error::input(format!(
        "the markers {} are not where {} has them: {rms_px:.1} px off at best",
        ids(used.iter().copied()),
        board.name
    ))
    .remedy(
        "check that this is the printed board, that its marker size and scale were measured, and \
         that the intrinsics belong to this camera and resolution",
    )
}

fn ids<'a>(sightings: impl Iterator<Item = &'a Sighting>) -> String {
    let ids: Vec<String> = sightings.map(|s| s.id.to_string()).collect();
    ids.join(", ")
}
