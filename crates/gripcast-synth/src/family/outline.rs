//! Planar lines with rounded corners: profiles of lathes, outlines of plates.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::DVec2;

/// A corner of a line and its fillet radius, m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Knot {
    pub(super) at: DVec2,
    pub(super) fillet: f64,
}

/// Returns a sharp corner (m).
pub(super) fn sharp(x: f64, y: f64) -> Knot {
    rounded(x, y, 0.0)
}

/// Returns a rounded corner (m).
pub(super) fn rounded(x: f64, y: f64, fillet: f64) -> Knot {
    Knot {
        at: DVec2::new(x, y),
        fillet,
    }
}

/// Returns points along an open line through the knots, at most about `edge` (m) apart.
pub(super) fn open_line(knots: &[Knot], edge: f64) -> Vec<DVec2> {
    let last = knots.len() - 1;
    let mut corners = vec![knots[0].at];
    for w in knots.windows(3) {
        corners.extend(corner(w[0].at, w[1], w[2].at, edge));
    }
    corners.push(knots[last].at);
    subdivided(&corners, edge)
}

/// Returns points along a closed line through the knots, at most about `edge` (m) apart.
pub(super) fn closed_line(knots: &[Knot], edge: f64) -> Vec<DVec2> {
    let n = knots.len();
    let mut corners: Vec<DVec2> = (0..n)
        .flat_map(|k| {
            corner(
                knots[(k + n - 1) % n].at,
                knots[k],
                knots[(k + 1) % n].at,
                edge,
            )
        })
        .collect();
    corners.push(corners[0]);
    let mut points = subdivided(&corners, edge);
    points.pop();
    points
}

/// Returns a counter-clockwise circle (m) of at least 8 points.
pub(super) fn circle(center: DVec2, radius: f64, edge: f64) -> Vec<DVec2> {
    let count = ((TAU * radius / edge).round() as usize).max(8);
    (0..count)
        .map(|k| center + radius * DVec2::from_angle(TAU * k as f64 / count as f64))
        .collect()
}

/// Resamples a dense line at equal distances of about `edge` (m), including its ends.
pub(super) fn even(dense: &[DVec2], edge: f64) -> Vec<DVec2> {
    let lengths = arc_lengths(dense);
    let total = lengths[lengths.len() - 1];
    let count = (total / edge).round().max(2.0) as usize;
    (0..=count)
        .map(|k| point_at(dense, &lengths, total * k as f64 / count as f64))
        .collect()
}

/// Returns the arc length of a line at each of its points.
pub(super) fn arc_lengths(line: &[DVec2]) -> Vec<f64> {
    let mut lengths = vec![0.0];
    for w in line.windows(2) {
        lengths.push(lengths[lengths.len() - 1] + w[0].distance(w[1]));
    }
    lengths
}

/// Returns the point of a line at an arc length.
pub(super) fn point_at(line: &[DVec2], lengths: &[f64], length: f64) -> DVec2 {
    let next = lengths.partition_point(|l| *l <= length);
    let next = next.clamp(1, line.len() - 1);
    let step = (lengths[next] - lengths[next - 1]).max(1e-12);
    let fraction = ((length - lengths[next - 1]) / step).clamp(0.0, 1.0);
    line[next - 1].lerp(line[next], fraction)
}

/// Returns a dense spline through the points of a profile (Catmull and Rom, 1974), on the axis only
/// at its ends.
pub(super) fn smooth(profile: &[Knot]) -> impl Iterator<Item = DVec2> {
    const PIECES: usize = 16;
    let at = |k: isize| {
        let last = profile.len() as isize - 1;
        // Beyond the ends the line continues as its mirror image.
        if k < 0 || k > last {
            let inner = profile[if k < 0 { 1 } else { profile.len() - 2 }].at;
            DVec2::new(-inner.x, inner.y)
        } else {
            profile[k as usize].at
        }
    };
    let count = (profile.len() - 1) * PIECES;
    (0..=count).map(move |n| {
        let (k, t) = ((n / PIECES) as isize, (n % PIECES) as f64 / PIECES as f64);
        let [a, b, c, d] = [-1, 0, 1, 2].map(|step| at(k + step));
        let bend = 2.0 * a - 5.0 * b + 4.0 * c - d;
        let twist = 3.0 * (b - c) + d - a;
        let p = b + 0.5 * t * ((c - a) + t * (bend + t * twist));
        let is_end = n == 0 || n == count;
        DVec2::new(if is_end { 0.0 } else { p.x.max(4e-3) }, p.y)
    })
}

/// Returns the points of a rounded corner.
fn corner(before: DVec2, knot: Knot, after: DVec2, edge: f64) -> Vec<DVec2> {
    let (to_before, to_after) = (before - knot.at, after - knot.at);
    let (from, to) = (to_before.normalize_or_zero(), to_after.normalize_or_zero());
    let angle = (-from).angle_to(to);
    let half = (0.5 * angle.abs()).tan();
    let max_reach = 0.48 * to_before.length().min(to_after.length());
    let reach = (knot.fillet * half).min(max_reach);
    if knot.fillet <= 0.0 || angle.abs() < 0.05 || reach < 2e-4 {
        return vec![knot.at];
    }
    let radius = reach / half;
    let count = (angle.abs() * radius / edge)
        .round()
        .max((angle.abs() / FRAC_PI_2).ceil().min(3.0));
    let start = knot.at + reach * from;
    let center = start + radius * angle.signum() * (-from).perp();
    (0..=count as usize)
        .map(|k| center + DVec2::from_angle(angle * k as f64 / count).rotate(start - center))
        .collect()
}

/// Subdivides the sides of a line into equal pieces of at most about `edge`.
fn subdivided(corners: &[DVec2], edge: f64) -> Vec<DVec2> {
    let mut points = vec![corners[0]];
    for w in corners.windows(2) {
        let pieces = (w[0].distance(w[1]) / edge - 0.05).ceil().max(1.0);
        points.extend((1..=pieces as usize).map(|k| w[0].lerp(w[1], k as f64 / pieces)));
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounded_square_keeps_its_sides() {
        let knots = [(0.0, 0.0), (0.02, 0.0), (0.02, 0.02), (0.0, 0.02)];
        let line = closed_line(&knots.map(|(x, y)| rounded(x, y, 0.004)), 0.002);
        let area: f64 = (0..line.len())
            .map(|k| 0.5 * line[k].perp_dot(line[(k + 1) % line.len()]))
            .sum();
        let expected = 4e-4 - (4.0 - std::f64::consts::PI) * 16e-6;
        assert!((area / expected - 1.0).abs() < 0.01, "{area}");
        for (k, p) in line.iter().enumerate() {
            let step = p.distance(line[(k + 1) % line.len()]);
            assert!((0.0009..0.0025).contains(&step), "{step}");
        }
    }

    #[test]
    fn dense_line_is_resampled_evenly() {
        let dense: Vec<DVec2> = (0..=90)
            .map(|k| 0.03 * DVec2::from_angle(f64::from(k).to_radians()))
            .collect();
        let line = even(&dense, 0.004);
        assert_eq!(line.len(), 13);
        assert!(line[12].distance(dense[90]) < 1e-15);
        for w in line.windows(2) {
            assert!((w[0].distance(w[1]) - 0.0039).abs() < 1e-4);
        }
    }
}
