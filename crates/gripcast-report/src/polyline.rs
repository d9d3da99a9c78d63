//! Lines of a diagram with as few points as can be seen.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

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

/// Numbers of the points that matter most to the shape of a line, at most `limit`: Douglas & Peucker
/// (1973), always splitting where the deviation is greatest. Points within `tolerance` of the line
/// through those that stay are left out; both ends stay.
pub fn thinned(places: &[[f64; 2]], tolerance: f64, limit: usize) -> Vec<usize> {
    if places.len() < 3 {
        return (0..places.len()).collect();
    }
    let mut kept = vec![0, places.len() - 1];
    let mut spans = BinaryHeap::from_iter(span(places, tolerance, 0, places.len() - 1));
    while kept.len() < limit
        && let Some(widest) = spans.pop()
    {
        kept.push(widest.farthest);
        spans.extend(span(places, tolerance, widest.first, widest.farthest));
        spans.extend(span(places, tolerance, widest.farthest, widest.last));
    }
    kept.sort_unstable();
    kept
}

/// None where the straight line is good enough.
fn span(places: &[[f64; 2]], tolerance: f64, first: usize, last: usize) -> Option<Span> {
    let (&from, &to) = (places.get(first)?, places.get(last)?);
    let inner = places.get(first + 1..last)?.iter().enumerate();
    let (offset, deviation) = inner
        .map(|(offset, &place)| (offset, distance(place, from, to)))
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
    fn points_on_a_line_are_left_out_and_corners_stay() {
        let corner: Vec<[f64; 2]> = (0..=10)
            .map(|i| [f64::from(i), f64::from(i.min(5))])
            .collect();
        assert_eq!(thinned(&corner, 1e-9, 512), [0, 5, 10]);
        for few in [&corner[..0], &corner[..1], &corner[..2]] {
            assert_eq!(thinned(few, 1e-9, 512).len(), few.len());
        }
    }

    #[test]
    fn the_greatest_deviations_survive_a_small_limit() {
        let points = [
            [0.0, 0.0],
            [1.0, 0.1],
            [2.0, 0.0],
            [3.0, 2.0],
            [4.0, 0.0],
            [5.0, 0.3],
            [6.0, 0.0],
        ];
        assert_eq!(thinned(&points, 1e-9, 4), [0, 2, 3, 6]);
        assert_eq!(thinned(&points, 0.5, usize::MAX), [0, 2, 3, 4, 6]);
    }
}
