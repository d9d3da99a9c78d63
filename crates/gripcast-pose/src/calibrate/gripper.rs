//! Where the gripper's markers really are.
//!
//! Tags that are glued by hand are off by millimetres and degrees. Images of the gripper from
//! many sides give the places of the markers to each other to hundredths of a millimetre, by
//! joint least squares over camera poses, marker poses and openings (Huber's loss).
//!
//! # What comes from where
//! Images show markers, not the gripper. Seven freedoms are left, and tied to what the gripper's
//! frame means (origin midway between the gel faces, x along which it closes, z its approach):
//!
//! | freedom | comes from |
//! | --- | --- |
//! | two turns: the direction of x | the fingers: x is the line along which their markers slide, if the opening changed enough for the line to be known to 0.25°; else as the next row |
//! | three shifts and the turn about x | the description: the rigid fit of the body's markers to where they are described; a marker that is far off weighs less. Without markers on the body, those of the fingers |
//! | the opening's zero | images with closed fingers: there the opening is 0; without any, the described distance of the fingers' markers |
//!
//! The second row cannot be better than the gluing: its error is one constant shift and turn of
//! the frame, the same in every image. [`GripperCalibration::frame_sigma_m`] estimates it by how
//! the markers scatter about their description; for better, measure the tags on the gripper and
//! correct the description. The covariances of the markers have the corners' errors alone.

use glam::DVec3;

use super::gripper_bundle::{Bundle, Free, OF_SLIDE, Solved, View, slides_differ};
use super::gripper_check::{leave_one_out, rms_of_views, suspects};
use super::gripper_frame::{Ties, conditions, tie};
use super::gripper_report::{Loosened, Outcome, report};
use super::gripper_result::{GripperCalibration, GripperImage};
use super::gripper_start::{MIN_SIGHTS, Selection, select, start};
use crate::{BoardFile, Part};
use gripcast_base::error::{Error, Result};
use gripcast_base::statistics::median;
use gripcast_imaging::Intrinsics;

/// Fewest images with two markers or more.
const MIN_VIEWS: usize = 8;
/// Losses of the first searches, px: tags may be 10 px from where they are described.
const ROUGH_LOSSES_PX: [f64; 2] = [10.0, 2.0];
/// The last loss: times the median error, and never narrower, px.
const LOSS_OF_MEDIAN: f64 = 2.0;
const MIN_LOSS_PX: f64 = 0.1;
/// A sighting is an outlier if it fits worse than this, px, and than so many medians.
const OUTLIER_PX: f64 = 1.0;
const OUTLIER_OF_MEDIAN: f64 = 6.0;
/// With a larger error this is not the gripper of the description, px.
const CONTRADICTION_PX: f64 = 3.0;
/// Standard deviation of a corner's coordinate that no detector betters on real images, px.
const MIN_SIGMA_PX: f64 = 0.03;
/// The fingers' line has to be known to this to be the x axis: 0.25°.
const LINE_SIGMA_RAD: f64 = 0.0044;
/// Every so many images one is held out.
const HELD_OUT: usize = 5;
/// A marker is loose if the others have less than this part of the error without it.
const MUCH_BETTER: f64 = 0.75;

/// Calibrates the markers of a gripper: `nominal` is where they are supposed to be, to a
/// centimetre and 15°; the sizes of the markers are taken from it.
///
/// # Errors
/// `Input` if the board has no tags of a gripper, if fewer than eight images show two markers, if no image joins the two fingers, or
/// if the images contradict the description.
pub fn calibrate_gripper(
    nominal: &BoardFile,
    intrinsics: &Intrinsics,
    images: &[GripperImage],
) -> Result<GripperCalibration> {
    let board = &nominal.board;
    if board.markers.iter().all(|m| m.part == Part::Object) {
        let what = format!("the board {} has no tags of a gripper", board.name);
        return Err(Error::input(what)
            .remedy("give the gripper's board file, with parts body, finger_left, finger_right"));
    }
    let mut selection = select(board, intrinsics, images);
    check_enough(&selection, images)?;
    let mut bundle = selection.bundle.clone();
    start(&mut bundle, board, images);
    let described = bundle.clone();
    let ties = Ties {
        x_from_fingers: false,
        zero_from_closed: has_closed(&bundle),
    };
    let mut solved = solve(bundle, ties)?;
    let mut loosened: Vec<Loosened> = Vec::new();
    let checks = loop {
        let checks = leave_one_out(&solved.bundle, solved.sigma_px);
        let Some((worst, better)) = loose(&solved, &suspects(&checks), ties) else {
            break checks;
        };
        let moved = checks[worst].as_ref().and_then(|c| c.moved);
        loosened.push(Loosened::new(&solved.bundle, worst, moved));
        selection.bundle = better.bundle.clone();
        check_enough(&selection, images)?;
        solved = better;
    };
    let holdout_rms_px = holdout(&solved, ties);
    let described_rms_px = rms_of_views(&described, &described.views);
    let line = line_off(&solved, ties);
    let ties = Ties {
        x_from_fingers: line.is_some_and(|(_, sigma)| sigma < LINE_SIGMA_RAD),
        ..ties
    };
    tie(&mut solved.bundle, ties);
    let covariance = solved
        .bundle
        .covariance(solved.loss_px, &conditions(&solved.bundle, ties))
        .ok_or_else(undetermined)?;
    report(Outcome {
        nominal,
        images,
        selection,
        solved,
        loosened,
        left_out_rms: checks
            .iter()
            .map(|c| c.as_ref().map(|c| c.rms_px))
            .collect(),
        covariance,
        ties,
        line,
        holdout_rms_px,
        described_rms_px,
    })
}

/// Whether an image with closed fingers shows them together with something else.
fn has_closed(bundle: &Bundle) -> bool {
    let differ = |v: &View| slides_differ(&bundle.markers, &v.sights);
    bundle.views.iter().any(|v| differ(v) && !v.frees_opening)
}

fn check_enough(selection: &Selection, images: &[GripperImage]) -> Result<()> {
    let (bundle, views) = (&selection.bundle, selection.bundle.views.len());
    if views < MIN_VIEWS || bundle.markers.len() < 2 {
        return Err(Error::input(format!(
            "of {} images, {views} show two or more markers that are in {MIN_SIGHTS} \
                 images at least; {MIN_VIEWS} are needed",
            images.len()
        ))
        .remedy(
            "take 15 to 40 sharp images of the gripper from all sides that will be seen, each \
             with as many tags as possible, at several openings",
        ));
    }
    let slides = |view: &View| -> Vec<f64> {
        view.sights
            .iter()
            .map(|s| bundle.markers[s.marker].slide)
            .collect()
    };
    let has = |list: &[f64], slide: f64| list.contains(&slide);
    let all: Vec<f64> = bundle.markers.iter().map(|m| m.slide).collect();
    if !(has(&all, -0.5) && has(&all, 0.5)) {
        return Ok(());
    }
    let together = bundle
        .views
        .iter()
        .any(|v| has(&slides(v), -0.5) && has(&slides(v), 0.5));
    let closed = |slide: f64| {
        let is_closed = |v: &&View| images[v.image].closed;
        let mut closed = bundle.views.iter().filter(is_closed);
        closed.any(|v| has(&slides(v), slide) && has(&slides(v), 0.0))
    };
    if together || (closed(-0.5) && closed(0.5)) {
        return Ok(());
    }
    Err(
        Error::input("no image shows markers of both fingers, so that they cannot be joined")
            .remedy("add images that show both fingers' markers"),
    )
}

fn undetermined() -> Error {
    Error::input("the images do not determine where the markers are to each other")
        .remedy("add images from other sides, each with as many tags as possible")
}

/// Searches with narrowing losses, leaving outliers out.
fn solve(mut bundle: Bundle, ties: Ties) -> Result<Solved> {
    let first = ROUGH_LOSSES_PX[0];
    bundle
        .minimise(Free::Views, first, &[])
        .ok_or_else(undetermined)?;
    let search = |bundle: &mut Bundle, loss_px: f64| {
        let conditions = conditions(bundle, ties);
        bundle
            .minimise(Free::All, loss_px, &conditions)
            .ok_or_else(undetermined)
    };
    for loss_px in ROUGH_LOSSES_PX {
        search(&mut bundle, loss_px)?;
        tie(&mut bundle, ties);
    }
    let mut loss_px = final_loss(&bundle);
    search(&mut bundle, loss_px)?;
    if leave_outliers(&mut bundle) {
        loss_px = final_loss(&bundle);
        search(&mut bundle, loss_px)?;
    }
    let errors = bundle.all_errors_px();
    let count = errors.len() as f64;
    let rms_px = (errors.iter().map(|e| e * e).sum::<f64>() / count).sqrt();
    // An infinite median is of corners behind the camera.
    if median_error_px(&bundle) > CONTRADICTION_PX {
        return Err(Error::input(format!(
            "the markers are {rms_px:.1} px from where the calibration puts them"
        ))
        .remedy(
            "check that the board file is that of this gripper with the measured size of its \
             tags, and that the intrinsics belong to this camera and resolution",
        ));
    }
    let weighted: f64 = errors.iter().map(|e| e * e.min(loss_px)).sum();
    let unknowns = bundle.globals()
        + bundle
            .views
            .iter()
            .map(|v| 6 + usize::from(v.frees_opening))
            .sum::<usize>();
    let free = (2.0 * count - unknowns as f64).max(1.0);
    Ok(Solved {
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

/// Leaves out sightings that fit nowhere; whether there were any.
fn leave_outliers(bundle: &mut Bundle) -> bool {
    let limit = OUTLIER_PX.max(OUTLIER_OF_MEDIAN * median_error_px(bundle));
    let fits: Vec<Vec<bool>> = bundle
        .views
        .iter()
        .map(|v| {
            v.sights
                .iter()
                .map(|s| bundle.sight_rms_px(v, s) <= limit)
                .collect()
        })
        .collect();
    let mut any = false;
    for (view, fits) in bundle.views.iter_mut().zip(fits) {
        for (sight, fits) in view.sights.iter_mut().zip(fits) {
            any |= !fits;
            sight.used = fits;
        }
    }
    any
}

/// The bundle without a marker and the views that lose too much by it.
fn without(bundle: &Bundle, marker: usize) -> Bundle {
    let mut rest = bundle.clone();
    rest.markers.remove(marker);
    for view in &mut rest.views {
        view.sights.retain(|s| s.marker != marker);
        for sight in &mut view.sights {
            sight.marker -= usize::from(sight.marker > marker);
            sight.used = true;
        }
        view.frees_opening &= slides_differ(&rest.markers, &view.sights);
    }
    rest.views.retain(|v| v.sights.len() >= 2);
    rest
}

/// The suspect without which the others fit much better, with that fit.
fn loose(solved: &Solved, suspects: &[usize], ties: Ties) -> Option<(usize, Solved)> {
    let fits = suspects
        .iter()
        .filter_map(|i| Some((*i, solve(without(&solved.bundle, *i), ties).ok()?)));
    fits.min_by(|a, b| a.1.rms_px.total_cmp(&b.1.rms_px))
        .filter(|(_, fit)| fit.rms_px < MUCH_BETTER * solved.rms_px)
}

/// Error of images that took no part; none if too few would be left.
fn holdout(solved: &Solved, ties: Ties) -> Option<f64> {
    let held = |i: usize| i % HELD_OUT == HELD_OUT / 2;
    let mut rest = solved.bundle.clone();
    let views = rest.views.split_off(0);
    let mut tested = Vec::new();
    for (i, view) in views.into_iter().enumerate() {
        if held(i) {
            tested.push(view);
        } else {
            rest.views.push(view);
        }
    }
    if rest.views.len() < MIN_VIEWS {
        return None;
    }
    let conditions = conditions(&rest, ties);
    rest.minimise(Free::All, solved.loss_px, &conditions)?;
    rms_of_views(&rest, &tested)
}

/// Angle between the line of the fingers and x in the frame of the description, and its
/// deviation, rad; none where no finger moved.
fn line_off(solved: &Solved, ties: Ties) -> Option<(f64, f64)> {
    let moves = solved.bundle.views.iter().any(|v| v.frees_opening);
    let rules = conditions(&solved.bundle, ties);
    let covariance = solved.bundle.covariance(solved.loss_px, &rules)?;
    let last = solved.bundle.globals() - OF_SLIDE;
    let variance = covariance
        .at(last, last)
        .max(covariance.at(last + 1, last + 1));
    let sigma = solved.sigma_px * variance.sqrt();
    moves.then(|| (solved.bundle.slide.angle_between(DVec3::X), sigma))
}
