//! Line simplification.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Part of a curve between two kept points, with the point farthest from their line.
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

/// Simplifies a line to at most `limit` points and returns their indices (Douglas & Peucker 1973,
/// always splitting at the largest deviation). Points within `tolerance` of the simplified line are
/// dropped; both ends stay.
pub fn simplify(points: &[[f64; 2]], tolerance: f64, limit: usize) -> Vec<usize> {
    if points.len() < 3 {
        return (0..points.len()).collect();
    }
    let mut kept = vec![0, points.len() - 1];
    let mut spans = BinaryHeap::from_iter(span(points, tolerance, 0, points.len() - 1));
    while kept.len() < limit
        && let Some(widest) = spans.pop()
    {
        kept.push(widest.farthest);
        spans.extend(span(points, tolerance, widest.first, widest.farthest));
        spans.extend(span(points, tolerance, widest.farthest, widest.last));
    }
    kept.sort_unstable();
    kept
}

/// Returns none if the straight line is good enough.
fn span(points: &[[f64; 2]], tolerance: f64, first: usize, last: usize) -> Option<Span> {
    let (&from, &to) = (points.get(first)?, points.get(last)?);
    let inner = points.get(first + 1..last)?.iter().enumerate();
    let (offset, deviation) = inner
        .map(|(offset, &point)| (offset, distance(point, from, to)))
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    (deviation > tolerance).then_some(Span {
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
    let fraction = if square > 0.0 {
        ((to[0] * along[0] + to[1] * along[1]) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (to[0] - fraction * along[0]).hypot(to[1] - fraction * along[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn collinear_points_are_dropped_and_corners_stay() {
        let corner: Vec<[f64; 2]> = (0..=10)
            .map(|i| [f64::from(i), f64::from(i.min(5))])
            .collect();
        assert_eq!(simplify(&corner, 1e-9, 512), [0, 5, 10]);
        for few in [&corner[..0], &corner[..1], &corner[..2]] {
            assert_eq!(simplify(few, 1e-9, 512).len(), few.len());
        }
    }

    #[test]
    fn largest_deviations_survive_a_small_limit() {
        let points = [
            [0.0, 0.0],
            [1.0, 0.1],
            [2.0, 0.0],
            [3.0, 2.0],
            [4.0, 0.0],
            [5.0, 0.3],
            [6.0, 0.0],
        ];
        assert_eq!(simplify(&points, 1e-9, 4), [0, 2, 3, 6]);
        assert_eq!(simplify(&points, 0.5, usize::MAX), [0, 2, 3, 4, 6]);
    }
}
