//! Checks of a calibration: images that took no part, markers that took no part, markers that
//! moved meanwhile.

use super::gripper_bundle::{Bundle, Free, OF_MARKER, View};
use gripcast_geometry::Pose;

/// Fewest sightings on each side of a move.
const MIN_ON_A_SIDE: usize = 3;
/// The loss of checks, px.
const CHECK_LOSS_PX: f64 = 3.0;
/// A marker has moved if two places explain this part of what one place does not …
const EXPLAINED: f64 = 0.6;
/// … and this many variances of a corner more than a place has unknowns.
const SIGNIFICANT: f64 = 20.0;
/// A marker that is this much worse than the others, and than so many px, does not stay.
const RATTLING: f64 = 6.0;
const RATTLING_PX: f64 = 1.0;

/// How well a marker is predicted by the others.
pub(super) struct LeftOut {
    /// Root mean square over the corners of the sightings that were used, px.
    pub(super) rms_px: f64,
    /// Error that a quarter of all sightings exceeds, px.
    upper_px: f64,
    /// The move that explains most of it.
    pub(super) moved: Option<Moved>,
}

/// A marker that is in two places.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved {
    /// The last image of the first place and the first one of the second.
    pub(super) images: [usize; 2],
    pub(super) shift_m: f64,
    pub(super) turn_rad: f64,
}

/// Angle of the rotation between two poses, rad.
pub(super) fn angle(a: &Pose, b: &Pose) -> f64 {
    let d = a.rotation.conjugate() * b.rotation;
    2.0 * d.xyz().length().atan2(d.w.abs())
}

/// A bundle of one view, or of one marker.
fn part_of(bundle: &Bundle, views: Vec<View>) -> Bundle {
    Bundle {
        views,
        ..bundle.clone()
    }
}

/// The view's pose by its markers but `without`; none if too few are left.
fn view_without(bundle: &Bundle, view: &View, without: usize) -> Option<View> {
    let mut rest = view.clone();
    rest.sights.retain(|s| s.marker != without);
    let slide = |marker: usize| bundle.markers[marker].slide;
    let others = || {
        rest.sights
            .iter()
            .filter(|s| s.used)
            .map(|s| slide(s.marker))
    };
    // A finger's marker is predicted where the others show the opening.
    let shows_opening =
        others().any(|s| s != 0.0) && others().any(|s| s != others().next().unwrap_or(0.0));
    if others().count() == 0 || (view.frees_opening && slide(without) != 0.0 && !shows_opening) {
        return None;
    }
    rest.frees_opening = view.frees_opening && shows_opening;
    let mut alone = part_of(bundle, vec![rest]);
    alone.minimise(Free::Views, CHECK_LOSS_PX, &[])?;
    alone.views.pop()
}

/// Residual of each marker where the images are solved without it. None where too few images
/// show enough other markers.
pub(super) fn leave_one_out(bundle: &Bundle, sigma_px: f64) -> Vec<Option<LeftOut>> {
    (0..bundle.markers.len())
        .map(|marker| left_out(bundle, marker, sigma_px))
        .collect()
}

fn left_out(bundle: &Bundle, marker: usize, sigma_px: f64) -> Option<LeftOut> {
    let (mut views, mut was_used) = (Vec::new(), Vec::new());
    for view in &bundle.views {
        let own = view.sights.iter().find(|s| s.marker == marker);
        let Some(own) = own else { continue };
        let Some(mut solved) = view_without(bundle, view, marker) else {
            continue;
        };
        let mut own = own.clone();
        was_used.push(own.used);
        own.used = true;
        // Only this marker is looked at from now on; the list has it alone.
        own.marker = 0;
        solved.sights = vec![own];
        views.push(solved);
    }
    if views.len() < MIN_ON_A_SIDE {
        return None;
    }
    let alone = Bundle {
        markers: vec![bundle.markers[marker].clone()],
        views,
        ..bundle.clone()
    };
    let whole = placed(&alone)?;
    let by_view = |v: &View| v.sights.first().map(|s| whole.0.sight_rms_px(v, s));
    let mut errors: Vec<f64> = whole.0.views.iter().filter_map(by_view).collect();
    let used = || errors.iter().zip(&was_used).filter(|(_, used)| **used);
    let squares: f64 = used().map(|(e, _)| e * e).sum();
    let rms_px = (squares / used().count().max(1) as f64).sqrt();
    errors.sort_by(f64::total_cmp);
    Some(LeftOut {
        rms_px,
        upper_px: errors[errors.len() * 3 / 4],
        moved: split(&alone, whole.1, sigma_px),
    })
}

/// The marker's best place with the views as they are, and the cost there.
fn placed(alone: &Bundle) -> Option<(Bundle, f64)> {
    let mut placed = alone.clone();
    let cost = placed.minimise(Free::Markers, CHECK_LOSS_PX, &[])?;
    Some((placed, cost))
}

/// The best division of the views into before and after a move, if it explains enough.
fn split(alone: &Bundle, whole: f64, sigma_px: f64) -> Option<Moved> {
    let count = alone.views.len();
    let mut best: Option<(f64, Moved)> = None;
    for at in MIN_ON_A_SIDE..=count.saturating_sub(MIN_ON_A_SIDE) {
        let (first, second) = alone.views.split_at(at);
        let before = placed(&part_of(alone, first.to_vec()));
        let after = placed(&part_of(alone, second.to_vec()));
        let (Some(before), Some(after)) = (before, after) else {
            continue;
        };
        let cost = before.1 + after.1;
        if best.as_ref().is_none_or(|(least, _)| cost < *least) {
            let (a, b) = (before.0.markers[0].pose, after.0.markers[0].pose);
            let moved = Moved {
                images: [first[at - 1].image, second[0].image],
                shift_m: a.translation_m.distance(b.translation_m),
                turn_rad: angle(&a, &b),
            };
            best = Some((cost, moved));
        }
    }
    let (cost, moved) = best?;
    let gain = whole - cost;
    let chance = (OF_MARKER as f64 + SIGNIFICANT) * sigma_px * sigma_px;
    (gain > EXPLAINED * whole && gain > chance).then_some(moved)
}

/// Markers that may not have stayed in their places, none of fewer than three. One that moved
/// spoils the others' checks as well, so that there may be several.
pub(super) fn suspects(checks: &[Option<LeftOut>]) -> Vec<usize> {
    if checks.len() < 3 {
        return Vec::new();
    }
    let upper = |i: usize| checks[i].as_ref().map_or(0.0, |c| c.upper_px);
    let mut sorted: Vec<f64> = (0..checks.len()).map(upper).filter(|e| *e > 0.0).collect();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len().saturating_sub(1) / 2);
    let limit = RATTLING_PX.max(RATTLING * median.copied().unwrap_or(0.0));
    let moved = |i: usize| checks[i].as_ref().is_some_and(|c| c.moved.is_some());
    (0..checks.len())
        .filter(|i| moved(*i) || upper(*i) > limit)
        .collect()
}

/// Root mean square error of views whose poses (and openings) are solved with the markers as they
/// are, px; none without views.
pub(super) fn rms_of_views(bundle: &Bundle, views: &[View]) -> Option<f64> {
    let (mut squares, mut count) = (0.0, 0usize);
    for view in views {
        let mut alone = part_of(bundle, vec![view.clone()]);
        if alone.minimise(Free::Views, CHECK_LOSS_PX, &[]).is_none() {
            continue;
        }
        let errors = alone.all_errors_px();
        squares += errors.iter().map(|e| e * e).sum::<f64>();
        count += errors.len();
    }
    (count > 0).then(|| (squares / count as f64).sqrt())
}
