//! Calibration of the marker poses on the gripper.
//!
//! Tags glued by hand are off by millimetres and degrees. Images of the gripper from many sides
//! determine the relative marker poses to hundredths of a millimetre, by bundle adjustment over
//! camera poses, marker poses and openings with a Huber loss.
//!
//! # Frame
//! Images show markers, not the gripper frame (origin midway between the gel faces, x = closing
//! direction, z = approach direction). Seven degrees of freedom are determined as follows:
//!
//! | degrees of freedom | source |
//! | --- | --- |
//! | direction of x (2) | sliding direction of the fingers' markers, if the opening varies enough to determine it to 0.25°; else as the next row |
//! | translation and rotation about x (4) | robust rigid fit of the body's markers to the board file; without markers on the body, those of the fingers |
//! | zero of the opening (1) | images with closed fingers; without any, the nominal distance of the fingers' markers |
//!
//! The second row is limited by the gluing: its error is one constant transform of the frame, the
//! same in every image. [`GripperCalibration::frame_sigma_m`] estimates it from the scatter of the
//! markers about the board file; to improve it, measure the tags on the gripper and correct the
//! board file. The covariances of the markers contain the corner noise only.

use glam::DVec3;

use super::gripper_bundle::{Bundle, Free, SLIDE_PARAMETERS, Solution, View, slides_differ};
use super::gripper_check::{leave_one_out, rms_of_views, suspects};
use super::gripper_frame::{FrameSources, align, constraints};
use super::gripper_report::{LooseMarker, ReportInput, report};
use super::gripper_result::{GripperCalibration, GripperImage};
use super::gripper_start::{MIN_OBSERVATIONS, Selection, select, start};
use crate::least_squares::rms;
use crate::{BoardFile, Body};
use gripcast_base::error::{Error, Result};
use gripcast_base::statistics::median;
use gripcast_imaging::Intrinsics;

/// Minimum number of images with two or more markers.
const MIN_VIEWS: usize = 8;
/// Huber losses of the initial fits, px: tags may be 10 px off their nominal positions.
const ROUGH_LOSSES_PX: [f64; 2] = [10.0, 2.0];
/// Huber loss of the final fit, times the median error.
const LOSS_OF_MEDIAN: f64 = 2.0;
/// Minimum Huber loss of the final fit, px.
const MIN_LOSS_PX: f64 = 0.1;
/// An observation is an outlier beyond this error, px, and this many median errors.
const OUTLIER: (f64, f64) = (1.0, 6.0);
/// Maximum median error of images that match the board, px.
const MAX_MEDIAN_PX: f64 = 3.0;
/// Lower bound of the standard deviation of a corner coordinate on real images, px.
const MIN_SIGMA_PX: f64 = 0.03;
/// Maximum standard deviation of a sliding direction that determines the x axis: 0.25°.
const MAX_SLIDE_SIGMA_RAD: f64 = 0.0044;
/// Every n-th image is held out.
const HOLDOUT_STRIDE: usize = 5;
/// A marker is loose if the RMS error without it drops below this fraction.
const LOOSE_RATIO: f64 = 0.75;

/// Calibrates the markers of a gripper. `nominal` has the marker sizes and approximate poses, to
/// 10 mm and 15°.
///
/// # Errors
/// `Input` if the board has no gripper tags, fewer than eight images show two markers, no image
/// links the two fingers, or the images do not match the board.
pub fn calibrate_gripper(
    nominal: &BoardFile,
    intrinsics: &Intrinsics,
    images: &[GripperImage],
) -> Result<GripperCalibration> {
    let board = &nominal.board;
    if board.markers.iter().all(|m| m.body == Body::Object) {
        let what = format!("board {} has no gripper tags", board.name);
        return Err(Error::input(what)
            .remedy("give a board file with markers of part body, finger_left or finger_right"));
    }
    let mut selection = select(board, intrinsics, images);
    check_enough(&selection, images)?;
    let mut bundle = selection.bundle.clone();
    start(&mut bundle, board, images);
    let nominal_bundle = bundle.clone();
    let mut sources = FrameSources {
        x_from_fingers: false,
        zero_from_closed: has_closed(&bundle),
    };
    let mut solution = solve(bundle, sources)?;
    let mut loose: Vec<LooseMarker> = Vec::new();
    let checks = loop {
        let checks = leave_one_out(&solution.bundle, solution.sigma_px);
        let Some((worst, better)) = find_loose(&solution, &suspects(&checks), sources) else {
            break checks;
        };
        let moved = checks[worst].as_ref().and_then(|c| c.moved);
        loose.push(LooseMarker::new(&solution.bundle, worst, moved));
        selection.bundle = better.bundle.clone();
        check_enough(&selection, images)?;
        solution = better;
    };
    let holdout_rms_px = holdout(&solution, sources);
    let described_rms_px = rms_of_views(&nominal_bundle, &nominal_bundle.views);
    let line = slide_deviation(&solution, sources);
    sources.x_from_fingers = line.is_some_and(|(_, sigma)| sigma < MAX_SLIDE_SIGMA_RAD);
    align(&mut solution.bundle, sources);
    let constraints = constraints(&solution.bundle, sources);
    let covariance = solution.bundle.covariance(solution.loss_px, &constraints);
    let left_out_rms = checks.iter().map(|c| c.as_ref().map(|c| c.rms_px));
    report(ReportInput {
        nominal,
        images,
        selection,
        loose,
        left_out_rms: left_out_rms.collect(),
        covariance: covariance.ok_or_else(undetermined)?,
        solution,
        sources,
        line,
        holdout_rms_px,
        described_rms_px,
    })
}

/// Whether an image with closed fingers shows them together with another body.
fn has_closed(bundle: &Bundle) -> bool {
    let differ = |v: &View| slides_differ(&bundle.markers, &v.observations);
    bundle.views.iter().any(|v| differ(v) && !v.frees_opening)
}

fn check_enough(selection: &Selection, images: &[GripperImage]) -> Result<()> {
    let (bundle, views) = (&selection.bundle, selection.bundle.views.len());
    if views < MIN_VIEWS || bundle.markers.len() < 2 {
        return Err(Error::input(format!(
            "{views} of {} images show two or more markers that are each in at least \
             {MIN_OBSERVATIONS} images; {MIN_VIEWS} are needed",
            images.len()
        ))
        .remedy(
            "take 15 to 40 sharp images of the gripper from all sides that will be observed, each \
             with as many tags as possible, at several openings",
        ));
    }
    let has = |slide: f64| bundle.markers.iter().any(|m| m.slide == slide);
    if !(has(-0.5) && has(0.5)) {
        return Ok(());
    }
    let shows = |view: &View, slide: f64| {
        let mut observations = view.observations.iter();
        observations.any(|o| bundle.markers[o.marker].slide == slide)
    };
    let mut views = bundle.views.iter();
    let together = views.any(|v| shows(v, -0.5) && shows(v, 0.5));
    let closed = |slide: f64| {
        let mut views = bundle.views.iter().filter(|v| images[v.image].closed);
        views.any(|v| shows(v, slide) && shows(v, 0.0))
    };
    if together || (closed(-0.5) && closed(0.5)) {
        return Ok(());
    }
    Err(
        Error::input("no image shows markers of both fingers, so they cannot be linked")
            .remedy("add images that show the markers of both fingers"),
    )
}

fn undetermined() -> Error {
    Error::input("the images do not determine the relative marker poses")
        .remedy("add images from other sides, each with as many tags as possible")
}

/// Fits with decreasing losses and rejects outliers.
fn solve(mut bundle: Bundle, sources: FrameSources) -> Result<Solution> {
    let first = ROUGH_LOSSES_PX[0];
    bundle
        .minimise(Free::Views, first, &[])
        .ok_or_else(undetermined)?;
    let fit = |bundle: &mut Bundle, loss_px: f64| {
        let constraints = constraints(bundle, sources);
        bundle
            .minimise(Free::All, loss_px, &constraints)
            .ok_or_else(undetermined)
    };
    for loss_px in ROUGH_LOSSES_PX {
        fit(&mut bundle, loss_px)?;
        align(&mut bundle, sources);
    }
    let mut loss_px = final_loss(&bundle);
    fit(&mut bundle, loss_px)?;
    if reject_outliers(&mut bundle) {
        loss_px = final_loss(&bundle);
        fit(&mut bundle, loss_px)?;
    }
    let errors = bundle.all_errors_px();
    let rms_px = rms(&errors);
    // The median is infinite for corners behind the camera.
    if median_error_px(&bundle) > MAX_MEDIAN_PX {
        return Err(Error::input(format!(
            "the images do not match the board: RMS reprojection error {rms_px:.1} px"
        ))
        .remedy(
            "check that the board file is that of this gripper with the measured size of its \
             tags, and that the intrinsics belong to this camera and resolution",
        ));
    }
    let weighted: f64 = errors.iter().map(|e| e * e.min(loss_px)).sum();
    let of_view = |v: &View| 6 + usize::from(v.frees_opening);
    let unknowns = bundle.globals() + bundle.views.iter().map(of_view).sum::<usize>();
    let free = (2.0 * errors.len() as f64 - unknowns as f64).max(1.0);
    Ok(Solution {
        sigma_px: (weighted / free).sqrt().max(MIN_SIGMA_PX),
        bundle,
        loss_px,
        rms_px,
    })
}

fn median_error_px(bundle: &Bundle) -> f64 {
    median(bundle.all_errors_px()).unwrap_or(f64::INFINITY)
}

fn final_loss(bundle: &Bundle) -> f64 {
    MIN_LOSS_PX.max(LOSS_OF_MEDIAN * median_error_px(bundle))
}

/// Marks outliers as unused; returns whether there are any.
fn reject_outliers(bundle: &mut Bundle) -> bool {
    let limit = OUTLIER.0.max(OUTLIER.1 * median_error_px(bundle));
    let mut any = false;
    let mut views = bundle.views.clone();
    for view in &mut views {
        for i in 0..view.observations.len() {
            let is_inlier = bundle.rms_px(view, &view.observations[i]) <= limit;
            view.observations[i].used = is_inlier;
            any |= !is_inlier;
        }
    }
    bundle.views = views;
    any
}

/// Removes a marker, and the views with too few other markers.
fn without(bundle: &Bundle, marker: usize) -> Bundle {
    let mut rest = bundle.clone();
    rest.markers.remove(marker);
    for view in &mut rest.views {
        view.observations.retain(|o| o.marker != marker);
        for observation in &mut view.observations {
            observation.marker -= usize::from(observation.marker > marker);
            observation.used = true;
        }
        view.frees_opening &= slides_differ(&rest.markers, &view.observations);
    }
    rest.views.retain(|v| v.observations.len() >= 2);
    rest
}

/// Finds the suspect without which the others fit much better; returns that fit as well.
fn find_loose(
    solution: &Solution,
    suspects: &[usize],
    sources: FrameSources,
) -> Option<(usize, Solution)> {
    let fit = |i: &usize| Some((*i, solve(without(&solution.bundle, *i), sources).ok()?));
    let fits = suspects.iter().filter_map(fit);
    fits.min_by(|a, b| a.1.rms_px.total_cmp(&b.1.rms_px))
        .filter(|(_, fit)| fit.rms_px < LOOSE_RATIO * solution.rms_px)
}

/// RMS reprojection error of held-out images; none if too few would be left.
fn holdout(solution: &Solution, sources: FrameSources) -> Option<f64> {
    let mut rest = solution.bundle.clone();
    let views = std::mem::take(&mut rest.views).into_iter().enumerate();
    let is_held_out = |i: usize| i % HOLDOUT_STRIDE == HOLDOUT_STRIDE / 2;
    let (held_out, kept): (Vec<_>, Vec<_>) = views.partition(|(i, _)| is_held_out(*i));
    rest.views = kept.into_iter().map(|(_, view)| view).collect();
    if rest.views.len() < MIN_VIEWS {
        return None;
    }
    let constraints = constraints(&rest, sources);
    rest.minimise(Free::All, solution.loss_px, &constraints)?;
    let held_out: Vec<View> = held_out.into_iter().map(|(_, view)| view).collect();
    rms_of_views(&rest, &held_out)
}

/// Angle between the sliding direction and the nominal x axis, and its standard deviation, rad.
/// None if no finger moved.
fn slide_deviation(solution: &Solution, sources: FrameSources) -> Option<(f64, f64)> {
    let bundle = &solution.bundle;
    let moves = bundle.views.iter().any(|v| v.frees_opening);
    let covariance = bundle.covariance(solution.loss_px, &constraints(bundle, sources))?;
    let last = bundle.globals() - SLIDE_PARAMETERS;
    let variance = covariance
        .at(last, last)
        .max(covariance.at(last + 1, last + 1));
    let sigma = solution.sigma_px * variance.sqrt();
    moves.then(|| (bundle.slide.angle_between(DVec3::X), sigma))
}
