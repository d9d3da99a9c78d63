//! Poses of rigid bodies from detected markers: initial poses by IPPE, joint Levenberg–Marquardt
//! over all corners, covariance, ambiguity.

mod body_pose;
pub(super) mod homography;
mod hypotheses;
mod ippe;
mod observation;
mod reprojection;
#[cfg(test)]
mod solve_test;

pub use body_pose::{BodyPose, GripperPose, MarkerResidual, Opening, RelativePose, relative_pose};

use super::board::{Board, Body};
use super::detection::Detection;
use super::least_squares::angle_between;
use gripcast_base::error::{Error, Result};
use gripcast_base::statistics::median;
use gripcast_imaging::Intrinsics;
use hypotheses::{coplanar_poses, hypotheses};
use observation::{MarkerObservation, normal_spread, observe_markers};
use reprojection::{CornerObservation, Fit, State, minimise};

/// Lower bound of the standard deviation of a corner coordinate, px.
const MIN_SIGMA_PX: f64 = 0.03;
/// Number of residuals of [`MIN_SIGMA_PX`] that the estimated deviation includes as a prior.
const PRIOR_RESIDUALS: f64 = 4.0;
/// Ratio of the Huber threshold to the median residual.
const LOSS_OF_MEDIAN: f64 = 2.0;
/// Huber threshold of the first search, px.
const ROUGH_LOSS_PX: f64 = 2.0;
/// Minimum Huber threshold, px.
const MIN_LOSS_PX: f64 = 0.1;
/// A marker is an outlier if its residual exceeds this and [`OUTLIER_OF_MEDIAN`], px.
const OUTLIER_PX: f64 = 1.0;
/// Ratio of an outlier's residual to the median residual.
const OUTLIER_OF_MEDIAN: f64 = 5.0;
/// Maximum reprojection error at which markers match the board file, px.
const MAX_RMS_PX: f64 = 4.0;
/// Rotations closer than this belong to the same minimum, rad.
const SAME_MINIMUM_RAD: f64 = 0.017;
/// Spread of the normals from which the pose is unambiguous: 30°.
const UNAMBIGUOUS_RAD: f64 = std::f64::consts::FRAC_PI_6;
/// The alternative is rejected if its cost is higher by this many corner variances …
const REJECTION_VARIANCES: f64 = 25.0;
/// … with at least this deviation, px: residuals of a single marker underestimate the errors.
const MIN_REJECTION_SIGMA_PX: f64 = 0.1;
/// Initial openings of the search, m.
const OPENINGS_M: [f64; 3] = [0.0, 0.04, 0.08];

/// Solves the pose of a rigid body from its markers in `detections`.
///
/// # Errors
/// `Input` if none of its markers was detected, or if they do not match the board file.
pub fn solve_body_pose(
    board: &Board,
    body: Body,
    detections: &[Detection],
    intrinsics: &Intrinsics,
) -> Result<BodyPose> {
    let (observed, notes) = observe_markers(board, &[body], detections, intrinsics);
    require_usable(&observed, &notes)?;
    let observed: Vec<_> = observed.into_iter().map(|o| at_opening(o, 0.0)).collect();
    let solution = solve::<6>(board, body, &observed, intrinsics, &[0.0])?;
    Ok(body_pose(body, &observed, solution, notes))
}

/// Solves the gripper's pose and opening from the markers on its body and fingers.
///
/// The fingers move along ∓x by half of the opening. `known_opening_m` is exact; it is required
/// if only markers of one finger are detected.
///
/// # Errors
/// `Input` if no marker of the gripper was detected, if the opening is not determined, or if the
/// markers do not match the board file.
pub fn solve_gripper(
    board: &Board,
    detections: &[Detection],
    intrinsics: &Intrinsics,
    known_opening_m: Option<f64>,
) -> Result<GripperPose> {
    let bodies = [Body::Gripper, Body::FingerLeft, Body::FingerRight];
    let (observed, mut notes) = observe_markers(board, &bodies, detections, intrinsics);
    require_usable(&observed, &notes)?;
    let slide = |o: &MarkerObservation| o.corners[0].slide;
    let has_finger = observed.iter().any(|o| slide(o) != 0.0);
    if has_finger && known_opening_m.is_none() {
        if observed.windows(2).all(|o| slide(&o[0]) == slide(&o[1])) {
            return Err(Error::input(
                "only markers of one finger were detected: they do not determine both pose and \
                 opening",
            )
            .remedy("give the opening, or show markers of the body or of the other finger"));
        }
        let solution = match solve::<7>(board, Body::Gripper, &observed, intrinsics, &OPENINGS_M) {
            Ok(solution) => solution,
            // The only finger marker may be the outlier.
            Err(error) => {
                return solve_without_fingers(board, observed, intrinsics, notes).ok_or(error);
            }
        };
        let opening = Opening {
            opening_m: solution.fit.state.opening_m,
            sigma_m: solution.sigma_px * solution.fit.inverse_information[6][6].sqrt(),
        };
        if opening.opening_m < -3.0 * opening.sigma_m - 1e-3 {
            notes.push(format!(
                "the opening of {:.1} mm is below 0: left and right finger may be exchanged in \
                 the board file",
                1e3 * opening.opening_m
            ));
        }
        return Ok(GripperPose {
            body: body_pose(Body::Gripper, &observed, solution, notes),
            opening: Some(opening),
        });
    }
    let opening_m = known_opening_m.unwrap_or(0.0);
    let rigid = observed.into_iter().map(|o| at_opening(o, opening_m));
    let observed: Vec<_> = rigid.collect();
    let solution = solve::<6>(board, Body::Gripper, &observed, intrinsics, &[0.0])?;
    Ok(GripperPose {
        body: body_pose(Body::Gripper, &observed, solution, notes),
        opening: known_opening_m.map(|opening_m| Opening {
            opening_m,
            sigma_m: 0.0,
        }),
    })
}

/// Solves the gripper's pose from the markers of its body alone. `None`: there are none, or they
/// do not match the board file.
fn solve_without_fingers(
    board: &Board,
    observed: Vec<MarkerObservation>,
    intrinsics: &Intrinsics,
    mut notes: Vec<String>,
) -> Option<GripperPose> {
    let (fingers, observed): (Vec<_>, Vec<_>) = observed
        .into_iter()
        .partition(|o| o.corners[0].slide != 0.0);
    let solution = solve::<6>(board, Body::Gripper, &observed, intrinsics, &[0.0]).ok()?;
    notes.push(format!(
        "finger marker {} was excluded: it contradicts the body's markers",
        ids(fingers.iter())
    ));
    Some(GripperPose {
        body: body_pose(Body::Gripper, &observed, solution, notes),
        opening: None,
    })
}

/// The marker moved to an opening, fixed to the body.
fn at_opening(mut observation: MarkerObservation, opening_m: f64) -> MarkerObservation {
    for corner in &mut observation.corners {
        corner.point_m.x += corner.slide * opening_m;
        corner.slide = 0.0;
    }
    observation
}

/// An alternative pose.
struct Alternative {
    state: State,
    cost: f64,
    is_minimum: bool,
}

impl Alternative {
    fn new<const N: usize>(fit: &Fit<N>, is_minimum: bool) -> Self {
        Self {
            state: fit.state,
            cost: fit.cost,
            is_minimum,
        }
    }
}

/// The best minimum and its quality.
struct Solution<const N: usize> {
    fit: Fit<N>,
    runner_up: Option<State>,
    ambiguity: Option<f64>,
    ambiguous: bool,
    rms_px: f64,
    sigma_px: f64,
    /// One per observed marker.
    residuals: Vec<MarkerResidual>,
    normal_spread_rad: f64,
}

fn solve<const N: usize>(
    board: &Board,
    body: Body,
    observed: &[MarkerObservation],
    intrinsics: &Intrinsics,
    openings_m: &[f64],
) -> Result<Solution<N>> {
    let all: Vec<&MarkerObservation> = observed.iter().collect();
    if all.is_empty() {
        return Err(not_detected(board, body));
    }
    let starts = hypotheses(intrinsics, &all, openings_m);
    let (used, fit, loss_px) = without_outliers::<N>(intrinsics, all, &starts)
        .ok_or_else(|| undetermined(board, observed))?;
    let rms_px = rms(intrinsics, &used, &fit.state);
    if rms_px > MAX_RMS_PX {
        return Err(mismatch(board, &used, rms_px));
    }
    let sigma_px = corner_sigma::<N>(intrinsics, &used, &fit.state, loss_px);
    let normal_spread_rad = normal_spread(&used);
    let others = starts.into_iter().chain(coplanar_poses(&used));
    let max_increase = REJECTION_VARIANCES * sigma_px.max(MIN_REJECTION_SIGMA_PX).powi(2);
    let is_plausible = |other: &Alternative| other.cost - fit.cost <= max_increase;
    let runner_up = runner_up(intrinsics, &used, &fit, others, loss_px)
        .filter(|other| other.is_minimum || is_plausible(other));
    let is_rejected = !runner_up.as_ref().is_some_and(is_plausible);
    let residuals = observed.iter().map(|o| MarkerResidual {
        id: o.id,
        rms_px: o.rms_px(intrinsics, &fit.state),
        used: used.iter().any(|u| std::ptr::eq(*u, o)),
    });
    Ok(Solution {
        residuals: residuals.collect(),
        ambiguity: runner_up
            .as_ref()
            .map(|other| rms(intrinsics, &used, &other.state) / rms_px.max(f64::MIN_POSITIVE)),
        runner_up: runner_up.map(|other| other.state),
        ambiguous: !is_rejected && normal_spread_rad < UNAMBIGUOUS_RAD,
        rms_px,
        sigma_px,
        normal_spread_rad,
        fit,
    })
}

/// Solves repeatedly, each time without the worst outlier, down to two markers: of two that
/// contradict each other, either may be wrong.
fn without_outliers<'a, const N: usize>(
    intrinsics: &Intrinsics,
    mut used: Vec<&'a MarkerObservation>,
    starts: &[State],
) -> Option<(Vec<&'a MarkerObservation>, Fit<N>, f64)> {
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

/// The best minimum over all starts, and its Huber threshold (px), derived from the residuals.
fn best_fit<const N: usize>(
    intrinsics: &Intrinsics,
    used: &[&MarkerObservation],
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

/// The best alternative to `best`: another minimum, or a start with optimised translation if its
/// search ends at `best`.
fn runner_up<const N: usize>(
    intrinsics: &Intrinsics,
    used: &[&MarkerObservation],
    best: &Fit<N>,
    starts: impl Iterator<Item = State>,
    loss_px: f64,
) -> Option<Alternative> {
    let corners = corners(used);
    let is_other = |state: &State| angle_between(&state.pose, &best.state.pose) > SAME_MINIMUM_RAD;
    starts
        .filter_map(|start| {
            let minimum = minimise::<N>(intrinsics, &corners, start, loss_px)
                .map(|fit| Alternative::new(&fit, true));
            let mirror = || {
                minimise::<3>(intrinsics, &corners, start, loss_px)
                    .map(|fit| Alternative::new(&fit, false))
            };
            let other = |found: &Alternative| is_other(&found.state);
            minimum.filter(other).or_else(|| mirror().filter(other))
        })
        .min_by(|a, b| a.cost.total_cmp(&b.cost))
}

fn corners(used: &[&MarkerObservation]) -> Vec<CornerObservation> {
    used.iter().flat_map(|s| s.corners).collect()
}

fn median_error(intrinsics: &Intrinsics, used: &[&MarkerObservation], state: &State) -> f64 {
    let errors = used.iter().flat_map(|s| s.errors_px(intrinsics, state));
    median(errors).unwrap_or(f64::INFINITY)
}

fn rms(intrinsics: &Intrinsics, used: &[&MarkerObservation], state: &State) -> f64 {
    let squares = used.iter().map(|s| s.rms_px(intrinsics, state).powi(2));
    (squares.sum::<f64>() / used.len() as f64).sqrt()
}

/// Standard deviation of a corner coordinate, from the residuals and the prior.
fn corner_sigma<const N: usize>(
    intrinsics: &Intrinsics,
    used: &[&MarkerObservation],
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

fn body_pose<const N: usize>(
    body: Body,
    observed: &[MarkerObservation],
    solution: Solution<N>,
    mut notes: Vec<String>,
) -> BodyPose {
    let variance = solution.sigma_px.powi(2);
    let mut covariance = [[0.0; 6]; 6];
    for (row, from) in covariance.iter_mut().zip(&solution.fit.inverse_information) {
        for (value, from) in row.iter_mut().zip(from) {
            *value = variance * from;
        }
    }
    for marker in solution.residuals.iter().filter(|m| !m.used) {
        notes.push(format!(
            "marker {} was excluded as an outlier: its reprojection error is {:.1} px",
            marker.id, marker.rms_px
        ));
    }
    if solution.ambiguous {
        notes.push(format!(
            "the pose is ambiguous: its mirror image fits as well ({} marker(s), normals within \
             {:.0}°)",
            observed.len(),
            solution.normal_spread_rad.to_degrees()
        ));
    }
    BodyPose {
        body,
        t_camera_body: solution.fit.state.pose,
        covariance,
        rms_px: solution.rms_px,
        corner_sigma_px: solution.sigma_px,
        markers: solution.residuals,
        ambiguity: solution.ambiguity,
        runner_up: solution.runner_up.map(|state| state.pose),
        ambiguous: solution.ambiguous,
        normal_spread_rad: solution.normal_spread_rad,
        notes,
    }
}

/// Refuses markers that were detected and all excluded.
fn require_usable(observed: &[MarkerObservation], notes: &[String]) -> Result<()> {
    if !observed.is_empty() || notes.is_empty() {
        return Ok(());
    }
    Err(Error::input(notes.join("; "))
        .remedy("show each marker once: cover or remove copies and other boards"))
}

fn not_detected(board: &Board, body: Body) -> Error {
    let what = match body {
        Body::Object => "the object's board",
        Body::Gripper => "the gripper",
        Body::FingerLeft => "the left finger",
        Body::FingerRight => "the right finger",
    };
    Error::input(format!("no marker of {what} ({}) was detected", board.name))
        .remedy("show the markers to the camera in focus, at least 20 px large and evenly lit")
}

fn undetermined(board: &Board, observed: &[MarkerObservation]) -> Error {
    Error::input(format!(
        "the markers {} of {} do not determine a pose",
        ids(observed.iter()),
        board.name
    ))
    .remedy("check the corners in the board file: the four of a square, clockwise")
}

fn mismatch(board: &Board, used: &[&MarkerObservation], rms_px: f64) -> Error {
    Error::input(format!(
        "the markers {} do not match the board {}: their reprojection error is {rms_px:.1} px",
        ids(used.iter().copied()),
        board.name
    ))
    .remedy(
        "check that the board file is that of the printed board, that marker size and scale were \
         measured, and that the intrinsics belong to this camera and resolution",
    )
}

fn ids<'a>(observed: impl Iterator<Item = &'a MarkerObservation>) -> String {
    let ids: Vec<String> = observed.map(|s| s.id.to_string()).collect();
    ids.join(", ")
}
