//! Checks of a calibration: held-out views, held-out markers, markers that moved between images.

use super::gripper_bundle::{Bundle, Free, MARKER_PARAMETERS, View};
use crate::least_squares::angle_between;

/// Minimum number of observations before and after a move.
const MIN_OBSERVATIONS: usize = 3;
/// Huber loss of the checks, px.
const CHECK_LOSS_PX: f64 = 3.0;
/// A marker has moved if two poses explain this fraction of the cost of one pose …
const EXPLAINED: f64 = 0.6;
/// … and this many corner variances more than a pose has parameters.
const SIGNIFICANT: f64 = 20.0;
/// A marker is loose if its error exceeds this multiple of the median marker error, and this, px.
const LOOSE: (f64, f64) = (6.0, 1.0);

/// Leave-one-out check of a marker.
pub(super) struct LeftOut {
    /// RMS reprojection error over the inlier observations, px.
    pub(super) rms_px: f64,
    /// Upper quartile of the errors of all observations, px.
    upper_px: f64,
    /// The move that explains most of the error.
    pub(super) moved: Option<Moved>,
}

/// A move of a marker.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved {
    /// Last image before and first image after the move.
    pub(super) images: [usize; 2],
    pub(super) shift_m: f64,
    pub(super) rotation_rad: f64,
}

fn with_views(bundle: &Bundle, views: Vec<View>) -> Bundle {
    Bundle {
        views,
        ..bundle.clone()
    }
}

/// Solves a view without the marker `without`. None if too few markers are left.
fn view_without(bundle: &Bundle, view: &View, without: usize) -> Option<View> {
    let mut rest = view.clone();
    rest.observations.retain(|o| o.marker != without);
    let slide = |marker: usize| bundle.markers[marker].slide;
    let others = || {
        let inliers = rest.observations.iter().filter(|o| o.used);
        inliers.map(|o| slide(o.marker))
    };
    // A finger's marker is predicted only where the others determine the opening.
    let shows_opening =
        others().any(|s| s != 0.0) && others().any(|s| s != others().next().unwrap_or(0.0));
    if others().count() == 0 || (view.frees_opening && slide(without) != 0.0 && !shows_opening) {
        return None;
    }
    rest.frees_opening = view.frees_opening && shows_opening;
    let mut alone = with_views(bundle, vec![rest]);
    alone.minimise(Free::Views, CHECK_LOSS_PX, &[])?;
    alone.views.pop()
}

/// Checks each marker against views solved without it. None where too few images show enough other
/// markers.
pub(super) fn leave_one_out(bundle: &Bundle, sigma_px: f64) -> Vec<Option<LeftOut>> {
    (0..bundle.markers.len())
        .map(|marker| left_out(bundle, marker, sigma_px))
        .collect()
}

fn left_out(bundle: &Bundle, marker: usize, sigma_px: f64) -> Option<LeftOut> {
    let (mut views, mut was_used) = (Vec::new(), Vec::new());
    for view in &bundle.views {
        let own = view.observations.iter().find(|o| o.marker == marker);
        let Some(own) = own else { continue };
        let Some(mut solved) = view_without(bundle, view, marker) else {
            continue;
        };
        let mut own = own.clone();
        was_used.push(own.used);
        own.used = true;
        // The list has only this marker from now on.
        own.marker = 0;
        solved.observations = vec![own];
        views.push(solved);
    }
    if views.len() < MIN_OBSERVATIONS {
        return None;
    }
    let alone = Bundle {
        markers: vec![bundle.markers[marker].clone()],
        views,
        ..bundle.clone()
    };
    let (fitted, cost) = fit_marker(&alone)?;
    let of_view = |v: &View| v.observations.first().map(|o| fitted.rms_px(v, o));
    let mut errors: Vec<f64> = fitted.views.iter().filter_map(of_view).collect();
    let used = || errors.iter().zip(&was_used).filter(|(_, used)| **used);
    let squares: f64 = used().map(|(e, _)| e * e).sum();
    let rms_px = (squares / used().count().max(1) as f64).sqrt();
    errors.sort_by(f64::total_cmp);
    Some(LeftOut {
        rms_px,
        upper_px: errors[errors.len() * 3 / 4],
        moved: find_move(&alone, cost, sigma_px),
    })
}

/// Fits the marker's pose with fixed views; returns the cost as well.
fn fit_marker(alone: &Bundle) -> Option<(Bundle, f64)> {
    let mut fitted = alone.clone();
    let cost = fitted.minimise(Free::Markers, CHECK_LOSS_PX, &[])?;
    Some((fitted, cost))
}

/// Finds the best split of the views into before and after a move, if it explains enough of the
/// cost `whole` of one pose.
fn find_move(alone: &Bundle, whole: f64, sigma_px: f64) -> Option<Moved> {
    let count = alone.views.len();
    let mut best: Option<(f64, Moved)> = None;
    for at in MIN_OBSERVATIONS..=count.saturating_sub(MIN_OBSERVATIONS) {
        let (first, second) = alone.views.split_at(at);
        let before = fit_marker(&with_views(alone, first.to_vec()));
        let after = fit_marker(&with_views(alone, second.to_vec()));
        let (Some(before), Some(after)) = (before, after) else {
            continue;
        };
        let cost = before.1 + after.1;
        if best.as_ref().is_none_or(|(min, _)| cost < *min) {
            let (a, b) = (before.0.markers[0].pose, after.0.markers[0].pose);
            let moved = Moved {
                images: [first[at - 1].image, second[0].image],
                shift_m: a.translation_m.distance(b.translation_m),
                rotation_rad: angle_between(&a, &b),
            };
            best = Some((cost, moved));
        }
    }
    let (cost, moved) = best?;
    let gain = whole - cost;
    let chance = (MARKER_PARAMETERS as f64 + SIGNIFICANT) * sigma_px * sigma_px;
    (gain > EXPLAINED * whole && gain > chance).then_some(moved)
}

/// Markers that may have moved; none for fewer than three markers. One moved marker affects the
/// checks of the others as well, so there may be several.
pub(super) fn suspects(checks: &[Option<LeftOut>]) -> Vec<usize> {
    if checks.len() < 3 {
        return Vec::new();
    }
    let upper = |i: usize| checks[i].as_ref().map_or(0.0, |c| c.upper_px);
    let mut sorted: Vec<f64> = (0..checks.len()).map(upper).filter(|e| *e > 0.0).collect();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len().saturating_sub(1) / 2);
    let limit = LOOSE.1.max(LOOSE.0 * median.copied().unwrap_or(0.0));
    let moved = |i: usize| checks[i].as_ref().is_some_and(|c| c.moved.is_some());
    (0..checks.len())
        .filter(|i| moved(*i) || upper(*i) > limit)
        .collect()
}

/// RMS reprojection error of views whose poses and openings are fitted with fixed markers, px. None
/// without views.
pub(super) fn rms_of_views(bundle: &Bundle, views: &[View]) -> Option<f64> {
    let (mut squares, mut count) = (0.0, 0usize);
    for view in views {
        let mut alone = with_views(bundle, vec![view.clone()]);
        if alone.minimise(Free::Views, CHECK_LOSS_PX, &[]).is_some() {
            let errors = alone.all_errors_px();
            squares += errors.iter().map(|e| e * e).sum::<f64>();
            count += errors.len();
        }
    }
    (count > 0).then(|| (squares / count as f64).sqrt())
}
