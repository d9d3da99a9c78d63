//! ROC and precision–recall curves with few points, however many samples.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use serde::{Deserialize, Serialize};

use super::ranking::Tie;

/// Most points of a curve.
pub(super) const MAX_POINTS: usize = 512;

/// Points closer than this to the line through those that stay are not needed.
const TOLERANCE: f64 = 1e-9;

/// A point of a receiver operating characteristic (ROC) curve; stable is positive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RocPoint {
    /// Share of the unstable grasps that are predicted stable: the false positive rate.
    pub false_stable_rate: f64,
    /// Share of the stable grasps that are predicted stable: the true positive rate.
    pub true_stable_rate: f64,
    /// Lowest prediction that counts as stable; none where no grasp does.
    pub threshold: Option<f64>,
}

/// A point of a precision–recall curve of the stable class.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PrecisionRecallPoint {
    /// Share of the stable grasps that are predicted stable.
    pub recall: f64,
    /// Share of the grasps predicted stable that are stable.
    pub precision: f64,
    /// Lowest prediction that counts as stable at the end of the step on which the point lies.
    pub threshold: f64,
}

pub(super) fn roc_points(ties: &[Tie]) -> Vec<RocPoint> {
    let (all_stable, all_unstable) = totals(ties);
    if all_stable == 0 || all_unstable == 0 {
        return Vec::new();
    }
    let mut points = vec![RocPoint {
        false_stable_rate: 0.0,
        true_stable_rate: 0.0,
        threshold: None,
    }];
    let (mut stable, mut unstable) = (0, 0);
    for tie in ties {
        stable += tie.stable;
        unstable += tie.unstable;
        points.push(RocPoint {
            false_stable_rate: unstable as f64 / all_unstable as f64,
            true_stable_rate: stable as f64 / all_stable as f64,
            threshold: Some(tie.p_stable),
        });
    }
    thinned(points, MAX_POINTS, |point| {
        [point.false_stable_rate, point.true_stable_rate]
    })
}

pub(super) fn precision_recall_points(ties: &[Tie]) -> Vec<PrecisionRecallPoint> {
    let (all_stable, _) = totals(ties);
    if all_stable == 0 {
        return Vec::new();
    }
    let mut points = Vec::with_capacity(2 * ties.len());
    let (mut stable, mut predicted) = (0, 0);
    for tie in ties {
        let recall_before = stable as f64 / all_stable as f64;
        stable += tie.stable;
        predicted += tie.stable + tie.unstable;
        // A step has one precision over its whole gain in recall.
        for recall in [recall_before, stable as f64 / all_stable as f64] {
            points.push(PrecisionRecallPoint {
                recall,
                precision: stable as f64 / predicted as f64,
                threshold: tie.p_stable,
            });
        }
    }
    thinned(points, MAX_POINTS, |point| [point.recall, point.precision])
}

/// Stable and unstable samples of all groups.
fn totals(ties: &[Tie]) -> (u64, u64) {
    ties.iter().fold((0, 0), |(stable, unstable), tie| {
        (stable + tie.stable, unstable + tie.unstable)
    })
}

/// Part of a curve between two points that stay, and its point farthest from their line.
struct Span {
    first: usize,
    last: usize,
    farthest: usize,
    deviation: f64,
}

impl Ord for Span {
    fn cmp(&self, other: &Self) -> Ordering {
        let by_deviation = self.deviation.total_cmp(&other.deviation);
        by_deviation.then(other.first.cmp(&self.first))
    }
}

impl PartialOrd for Span {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Span {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Span {}

/// The points that matter most to the shape, at most `limit`: Douglas & Peucker (1973), always
/// splitting where the deviation is greatest. Both ends stay.
fn thinned<T: Copy>(points: Vec<T>, limit: usize, place: impl Fn(&T) -> [f64; 2]) -> Vec<T> {
    if points.len() < 3 {
        return points;
    }
    let places: Vec<[f64; 2]> = points.iter().map(place).collect();
    let mut kept = vec![0, points.len() - 1];
    let mut spans = BinaryHeap::from_iter(span(&places, 0, points.len() - 1));
    while kept.len() < limit
        && let Some(widest) = spans.pop()
    {
        kept.push(widest.farthest);
        spans.extend(span(&places, widest.first, widest.farthest));
        spans.extend(span(&places, widest.farthest, widest.last));
    }
    kept.sort_unstable();
    kept.into_iter()
        .filter_map(|index| points.get(index).copied())
        .collect()
}

/// None where the straight line is good enough.
fn span(places: &[[f64; 2]], first: usize, last: usize) -> Option<Span> {
    let (&from, &to) = (places.get(first)?, places.get(last)?);
    let inner = places.get(first + 1..last)?.iter().enumerate();
    let (offset, deviation) = inner
        .map(|(offset, &place)| (offset, distance(place, from, to)))
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    (deviation > TOLERANCE).then_some(Span {
        first,
        last,
        farthest: first + 1 + offset,
        deviation,
    })
}

/// Distance of `p` from the segment from `a` to `b`.
fn distance(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let along = [b[0] - a[0], b[1] - a[1]];
    let to = [p[0] - a[0], p[1] - a[1]];
    let square = along[0] * along[0] + along[1] * along[1];
    let share = if square > 0.0 {
        ((to[0] * along[0] + to[1] * along[1]) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (to[0] - share * along[0]).hypot(to[1] - share * along[1])
}

#[cfg(test)]
#[path = "curve_test.rs"]
mod tests;
