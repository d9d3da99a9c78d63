//! Alignment of the markers with the gripper frame, which the images alone do not determine.

use glam::{DQuat, DVec3};

use super::gripper_bundle::{Bundle, Constraint, MARKER_PARAMETERS, SLIDE_PARAMETERS};
use crate::Body;
use gripcast_base::linear::Symmetric;
use gripcast_geometry::Pose;

/// Deviation from the nominal position beyond which a marker's weight decreases, m.
const FULL_WEIGHT_M: f64 = 2e-3;
const MAX_PASSES: usize = 200;

/// What determines the frame besides the fit of the markers to their nominal poses.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrameSources {
    /// The sliding direction of the fingers determines the x axis.
    pub(super) x_from_fingers: bool,
    /// Images with closed fingers determine the opening's zero.
    pub(super) zero_from_closed: bool,
}

/// Indices of the markers that define the frame: those on the gripper's body, else all.
fn reference_markers(bundle: &Bundle) -> Vec<usize> {
    let on_body = |i: &usize| bundle.markers[*i].body == Body::Gripper;
    let all = 0..bundle.markers.len();
    let body: Vec<usize> = all.clone().filter(on_body).collect();
    if body.is_empty() { all.collect() } else { body }
}

fn weights(bundle: &Bundle, references: &[usize]) -> Vec<f64> {
    let weight = |i: &usize| {
        let marker = &bundle.markers[*i];
        let off = marker.pose.translation_m - marker.nominal.translation_m;
        FULL_WEIGHT_M / off.length().max(FULL_WEIGHT_M)
    };
    references.iter().map(weight).collect()
}

/// Rotation axes of the fit.
fn rotation_axes(sources: FrameSources) -> &'static [DVec3] {
    if sources.x_from_fingers {
        &[DVec3::X]
    } else {
        &[DVec3::X, DVec3::Y, DVec3::Z]
    }
}

/// Transforms the bundle into the frame in which the markers fit their nominal poses best: weighted
/// least squares over the corners.
pub(super) fn align(bundle: &mut Bundle, sources: FrameSources) {
    if sources.x_from_fingers {
        let rotation = DQuat::from_rotation_arc(bundle.slide, DVec3::X);
        transform(bundle, &Pose::from_rotation(rotation));
        bundle.slide = DVec3::X;
    }
    let references = reference_markers(bundle);
    for _ in 0..MAX_PASSES {
        let Some(step) = fit_step(bundle, &references, rotation_axes(sources)) else {
            break;
        };
        transform(bundle, &step);
        if step.translation_m.length() + step.rotation.xyz().length() < 1e-12 {
            break;
        }
    }
    if !sources.zero_from_closed {
        shift_opening(bundle);
    }
}

/// One step of the fit. None if the markers do not determine it.
fn fit_step(bundle: &Bundle, references: &[usize], axes: &[DVec3]) -> Option<Pose> {
    let unknowns = 3 + axes.len();
    let mut matrix = Symmetric::zero(unknowns);
    let mut vector = vec![0.0; unknowns];
    for (i, weight) in references.iter().zip(weights(bundle, references)) {
        let marker = &bundle.markers[*i];
        for (corner, local) in marker.corners().into_iter().zip(marker.local) {
            let off = marker.nominal.transform_point(local) - corner;
            for axis in 0..3 {
                let mut row = vec![(axis, 1.0)];
                row.extend((3..).zip(axes.iter().map(|a| a.cross(corner)[axis])));
                matrix.add_outer(&row, weight);
                for (k, entry) in row {
                    vector[k] += weight * entry * off[axis];
                }
            }
        }
    }
    let step = matrix.factor()?.solve(&vector);
    let rotation: DVec3 = axes.iter().zip(&step[3..]).map(|(a, by)| *a * *by).sum();
    let shift = DVec3::new(step[0], step[1], step[2]);
    Some(Pose::new(DQuat::from_scaled_axis(rotation), shift))
}

/// Changes the gripper frame; `change` maps old coordinates to new ones.
fn transform(bundle: &mut Bundle, change: &Pose) {
    for marker in &mut bundle.markers {
        marker.pose = *change * marker.pose;
    }
    let back = change.inverse();
    for view in &mut bundle.views {
        view.pose = view.pose * back;
    }
    bundle.slide = change.transform_vector(bundle.slide);
}

/// Shifts the opening so that the distance of the fingers' markers is nominal at 0.
fn shift_opening(bundle: &mut Bundle) {
    let (mut sum, mut squares) = (0.0, 0.0);
    for marker in &bundle.markers {
        let off = marker.pose.translation_m - marker.nominal.translation_m;
        sum += marker.slide * off.dot(bundle.slide);
        squares += marker.slide * marker.slide;
    }
    if squares == 0.0 {
        return;
    }
    let opening = sum / squares;
    for marker in &mut bundle.markers {
        marker.pose.translation_m -= bundle.slide * (marker.slide * opening);
    }
    for view in bundle.views.iter_mut() {
        if view.frees_opening {
            view.opening_m += opening;
        } else {
            // One finger alone: its displacement moves the pose instead.
            let first = view.observations.first();
            let slide = first.map_or(0.0, |o| bundle.markers[o.marker].slide);
            let shift = bundle.slide * (slide * opening);
            view.pose = view.pose * Pose::from_translation(shift);
        }
    }
}

/// Constraints under which a small step keeps the frame aligned: the first-order conditions of the
/// fit's minimum, including the change of the weights.
pub(super) fn constraints(bundle: &Bundle, sources: FrameSources) -> Vec<Constraint> {
    let references = reference_markers(bundle);
    let weights = weights(bundle, &references);
    let all = weights.iter().sum::<f64>();
    let weighted = || references.iter().zip(&weights);
    let center: DVec3 = weighted()
        .map(|(i, w)| bundle.markers[*i].pose.translation_m * (w / all))
        .sum();
    let mut shifts = [const { Constraint::new() }; 3];
    // Moments of the corner steps about the centre, rad.
    let mut inertia = 0.0;
    let mut moments = vec![[DVec3::ZERO; MARKER_PARAMETERS]; references.len()];
    for ((i, weight), moments) in weighted().zip(&mut moments) {
        let marker = &bundle.markers[*i];
        let off = marker.nominal.translation_m - marker.pose.translation_m;
        // A distant marker pulls with constant force wherever it is along the pull.
        let (pull, loss) = if *weight < 1.0 {
            (off.normalize_or_zero(), weight / off.length())
        } else {
            (DVec3::ZERO, 0.0)
        };
        let mut lost = DVec3::ZERO;
        for (corner, local) in marker.corners().into_iter().zip(marker.local) {
            let arm = corner - center;
            let on_marker = corner - marker.pose.translation_m;
            inertia += weight * arm.length_squared();
            lost += arm.cross(marker.nominal.transform_point(local) - corner);
            for (k, axis) in DVec3::AXES.into_iter().enumerate() {
                moments[k] += *weight * arm.cross(axis);
                moments[3 + k] += *weight * arm.cross(axis.cross(on_marker));
            }
        }
        for (k, axis) in DVec3::AXES.into_iter().enumerate() {
            moments[k] -= lost * (loss * pull.dot(axis));
            for (row, along) in shifts.iter_mut().zip(DVec3::AXES) {
                let kept = axis.dot(along) - pull.dot(axis) * pull.dot(along);
                row.push((MARKER_PARAMETERS * i + k, weight / all * kept));
            }
        }
    }
    let mut result = shifts.to_vec();
    for axis in rotation_axes(sources) {
        let row = references.iter().zip(&moments).flat_map(|(i, moments)| {
            (MARKER_PARAMETERS * i..).zip(moments.map(|m| m.dot(*axis) / inertia))
        });
        result.push(row.collect());
    }
    let last = bundle.globals() - SLIDE_PARAMETERS;
    if sources.x_from_fingers {
        result.extend((0..SLIDE_PARAMETERS).map(|k| vec![(last + k, 1.0)]));
    }
    let has_fingers = bundle.markers.iter().any(|m| m.slide != 0.0);
    if has_fingers && !sources.zero_from_closed {
        let markers = bundle.markers.iter().enumerate();
        let row = markers.filter(|(_, m)| m.slide != 0.0).flat_map(|(i, m)| {
            let along = bundle.slide * m.slide;
            (0..3).map(move |axis| (MARKER_PARAMETERS * i + axis, along[axis]))
        });
        result.push(row.collect());
    }
    result
}

/// Uncertainty of the frame from the scatter of the markers about their nominal positions: standard
/// deviations of the origin (m, over all axes) and of the least certain axis (rad). None for fewer
/// than three markers.
pub(super) fn frame_sigma(bundle: &Bundle, sources: FrameSources) -> Option<(f64, f64)> {
    let references = reference_markers(bundle);
    if references.len() < 3 {
        return None;
    }
    let count = references.len() as f64;
    let markers = || references.iter().map(|i| &bundle.markers[*i]);
    let positions = || markers().map(|m| m.pose.translation_m);
    let squares: f64 = markers()
        .map(|m| m.nominal.translation_m)
        .zip(positions())
        .map(|(nominal, position)| position.distance_squared(nominal))
        .sum();
    let center = positions().sum::<DVec3>() / count;
    let fitted = (3 + rotation_axes(sources).len()) as f64;
    let variance = squares / (3.0 * count - fitted);
    let (mut origin, mut largest): (f64, f64) = (3.0 * variance / count, 0.0);
    for axis in rotation_axes(sources) {
        let lever: f64 = positions()
            .map(|p| axis.cross(p - center).length_squared())
            .sum();
        let rotation = variance / lever.max(f64::MIN_POSITIVE);
        largest = largest.max(rotation);
        // The frame rotates about the centre of the markers, and the origin with it.
        origin += rotation * axis.cross(center).length_squared();
    }
    Some((origin.sqrt(), largest.sqrt()))
}
