//! Ties the markers to the gripper's frame, which images alone do not show.

use glam::{DQuat, DVec3};

use super::gripper_bundle::{Bundle, Condition, OF_MARKER, OF_SLIDE};
use crate::Part;
use gripcast_base::linear::Symmetric;
use gripcast_geometry::Pose;

/// Markers that are off by less than this are weighted alike, others less, m.
const ALIKE_M: f64 = 2e-3;
const PASSES: usize = 200;

/// What fixes the frame beyond the best fit of the markers to their description.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ties {
    /// The x axis is the direction in which the fingers slide.
    pub(super) x_from_fingers: bool,
    /// Images with closed fingers fix the opening's zero.
    pub(super) zero_from_closed: bool,
}

/// Which markers stand for the frame, with weights: those of the body, or the fingers' if there
/// are none.
fn carriers(bundle: &Bundle) -> Vec<usize> {
    let of = |test: &dyn Fn(Part) -> bool| -> Vec<usize> {
        let all = bundle.markers.iter().enumerate();
        all.filter(|(_, m)| test(m.part)).map(|(i, _)| i).collect()
    };
    let body = of(&|part| part == Part::Body);
    if body.is_empty() { of(&|_| true) } else { body }
}

fn weights(bundle: &Bundle, carriers: &[usize]) -> Vec<f64> {
    let weight = |i: &usize| {
        let marker = &bundle.markers[*i];
        let off = marker.pose.translation_m - marker.nominal.translation_m;
        ALIKE_M / off.length().max(ALIKE_M)
    };
    carriers.iter().map(weight).collect()
}

/// The axes about which the fit turns the frame.
fn turning(ties: Ties) -> &'static [DVec3] {
    if ties.x_from_fingers {
        &[DVec3::X]
    } else {
        &[DVec3::X, DVec3::Y, DVec3::Z]
    }
}

/// Moves everything into the frame in which the markers fit their description best: least squares
/// over the corners, with less weight on markers that are far off.
pub(super) fn tie(bundle: &mut Bundle, ties: Ties) {
    if ties.x_from_fingers {
        let turn = DQuat::from_rotation_arc(bundle.slide, DVec3::X);
        apply(bundle, &Pose::from_rotation(turn));
        bundle.slide = DVec3::X;
    }
    let carriers = carriers(bundle);
    for _ in 0..PASSES {
        let Some(step) = fit_step(bundle, &carriers, turning(ties)) else {
            break;
        };
        apply(bundle, &step);
        if step.translation_m.length() + step.rotation.xyz().length() < 1e-12 {
            break;
        }
    }
    if !ties.zero_from_closed {
        shift_opening(bundle);
    }
}

/// One step of the fit; none if the markers do not determine it.
fn fit_step(bundle: &Bundle, carriers: &[usize], turning: &[DVec3]) -> Option<Pose> {
    let unknowns = 3 + turning.len();
    let mut matrix = Symmetric::zero(unknowns);
    let mut vector = vec![0.0; unknowns];
    for (i, weight) in carriers.iter().zip(weights(bundle, carriers)) {
        let marker = &bundle.markers[*i];
        for (corner, local) in marker.corners().into_iter().zip(marker.local) {
            let off = marker.nominal.transform_point(local) - corner;
            for axis in 0..3 {
                let mut row = vec![(axis, 1.0)];
                row.extend(
                    turning
                        .iter()
                        .enumerate()
                        .map(|(k, t)| (3 + k, t.cross(corner)[axis])),
                );
                matrix.add_outer(&row, weight);
                for (k, entry) in row {
                    vector[k] += weight * entry * off[axis];
                }
            }
        }
    }
    let step = matrix.factor()?.solve(&vector);
    let turn: DVec3 = turning.iter().zip(&step[3..]).map(|(t, by)| *t * *by).sum();
    let shift = DVec3::new(step[0], step[1], step[2]);
    Some(Pose::new(DQuat::from_scaled_axis(turn), shift))
}

/// Changes the gripper's frame: `change` maps old coordinates into new ones.
fn apply(bundle: &mut Bundle, change: &Pose) {
    for marker in &mut bundle.markers {
        marker.pose = *change * marker.pose;
    }
    let back = change.inverse();
    for view in &mut bundle.views {
        view.pose = view.pose * back;
    }
    bundle.slide = change.transform_vector(bundle.slide);
}

/// Puts the opening's zero where the fingers' markers are as far apart as described.
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
            // One finger alone: the pose takes what the opening does not.
            let slide = view
                .sights
                .first()
                .map_or(0.0, |s| bundle.markers[s.marker].slide);
            let shift = bundle.slide * (slide * opening);
            view.pose = view.pose * Pose::from_translation(shift);
        }
    }
}

/// The conditions under which a small step keeps the frame tied: those of the fit's minimum, to
/// first order, with the change of the weights.
pub(super) fn conditions(bundle: &Bundle, ties: Ties) -> Vec<Condition> {
    let carriers = carriers(bundle);
    let weights = weights(bundle, &carriers);
    let all = weights.iter().sum::<f64>();
    let weighted = || carriers.iter().zip(&weights);
    let middle: DVec3 = weighted()
        .map(|(i, w)| bundle.markers[*i].pose.translation_m * (w / all))
        .sum();
    let mut shifts = [const { Condition::new() }; 3];
    // The moments of the corners' steps about the middle, in rad.
    let mut inertia = 0.0;
    let mut moments = vec![[DVec3::ZERO; OF_MARKER]; carriers.len()];
    for ((i, weight), moments) in weighted().zip(&mut moments) {
        let marker = &bundle.markers[*i];
        let off = marker.nominal.translation_m - marker.pose.translation_m;
        // A marker that is far off pulls with the same force wherever it is along the pull.
        let (pull, loss) = match *weight < 1.0 {
            true => (off.normalize_or_zero(), weight / off.length()),
            false => (DVec3::ZERO, 0.0),
        };
        let mut lost = DVec3::ZERO;
        for (corner, local) in marker.corners().into_iter().zip(marker.local) {
            let arm = corner - middle;
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
                row.push((OF_MARKER * i + k, weight / all * kept));
            }
        }
    }
    let mut result = shifts.to_vec();
    for axis in turning(ties) {
        let row = carriers.iter().zip(&moments).flat_map(|(i, moments)| {
            let entry = |(k, m): (usize, &DVec3)| (OF_MARKER * i + k, m.dot(*axis) / inertia);
            moments.iter().enumerate().map(entry).collect::<Condition>()
        });
        result.push(row.collect());
    }
    let last = bundle.globals() - OF_SLIDE;
    if ties.x_from_fingers {
        result.extend((0..OF_SLIDE).map(|k| vec![(last + k, 1.0)]));
    }
    let has_fingers = bundle.markers.iter().any(|m| m.slide != 0.0);
    if has_fingers && !ties.zero_from_closed {
        let fingers = bundle
            .markers
            .iter()
            .enumerate()
            .filter(|(_, m)| m.slide != 0.0);
        let row = fingers.flat_map(|(i, m)| {
            let along = bundle.slide * m.slide;
            (0..3).map(move |axis| (OF_MARKER * i + axis, along[axis]))
        });
        result.push(row.collect());
    }
    result
}

/// How far the frame may be from what the description means, by how the markers scatter about it:
/// standard deviations of its origin (m, all axes together) and of its largest turn (rad). None
/// for fewer than three markers.
pub(super) fn scatter(bundle: &Bundle, ties: Ties) -> Option<(f64, f64)> {
    let carriers = carriers(bundle);
    if carriers.len() < 3 {
        return None;
    }
    let count = carriers.len() as f64;
    let places = || carriers.iter().map(|i| &bundle.markers[*i]);
    let squares: f64 = places()
        .map(|m| {
            m.pose
                .translation_m
                .distance_squared(m.nominal.translation_m)
        })
        .sum();
    let middle = places().map(|m| m.pose.translation_m).sum::<DVec3>() / count;
    let fitted = (3 + turning(ties).len()) as f64;
    let variance = squares / (3.0 * count - fitted);
    let (mut origin, mut largest): (f64, f64) = (3.0 * variance / count, 0.0);
    for axis in turning(ties) {
        let lever: f64 = places()
            .map(|m| axis.cross(m.pose.translation_m - middle).length_squared())
            .sum();
        let turn = variance / lever.max(f64::MIN_POSITIVE);
        largest = largest.max(turn);
        // The markers turn about their middle, and the origin with them.
        origin += turn * axis.cross(middle).length_squared();
    }
    Some((origin.sqrt(), largest.sqrt()))
}
