//! Lines in a plane with rounded corners: profiles to turn, outlines to cut out.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::DVec2;

/// A corner of a line and the radius that rounds it, m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Knot {
    pub(super) at: DVec2,
    pub(super) fillet: f64,
}

/// A corner (m) that is not rounded.
pub(super) fn sharp(x: f64, y: f64) -> Knot {
    rounded(x, y, 0.0)
}

/// A corner (m) that is rounded.
pub(super) fn rounded(x: f64, y: f64, fillet: f64) -> Knot {
    Knot {
        at: DVec2::new(x, y),
        fillet,
    }
}

/// Points along an open line through the knots, at most about `edge` (m) apart.
pub(super) fn open_line(knots: &[Knot], edge: f64) -> Vec<DVec2> {
    let last = knots.len() - 1;
    let mut corners = vec![knots[0].at];
    for w in knots.windows(3) {
        corners.extend(corner(w[0].at, w[1], w[2].at, edge));
    }
    corners.push(knots[last].at);
    divided(&corners, edge)
}

/// Points along a closed line through the knots, at most about `edge` (m) apart.
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
    let mut points = divided(&corners, edge);
    points.pop();
    points
}

/// A circle (m), counter-clockwise, of at least 8 points.
pub(super) fn circle(center: DVec2, radius: f64, edge: f64) -> Vec<DVec2> {
    let count = ((TAU * radius / edge).round() as usize).max(8);
    (0..count)
        .map(|k| center + radius * DVec2::from_angle(TAU * k as f64 / count as f64))
        .collect()
}

/// Points at equal distances, about `edge` (m), along a dense smooth line, its ends included.
pub(super) fn even(dense: &[DVec2], edge: f64) -> Vec<DVec2> {
    let mut along = vec![0.0];
    for w in dense.windows(2) {
        along.push(along[along.len() - 1] + w[0].distance(w[1]));
    }
    let length = along[along.len() - 1];
    let count = (length / edge).round().max(2.0) as usize;
    (0..=count)
        .map(|k| {
            let at = length * k as f64 / count as f64;
            let j = along
                .partition_point(|a| *a <= at)
                .clamp(1, dense.len() - 1);
            let step = (along[j] - along[j - 1]).max(1e-12);
            dense[j - 1].lerp(dense[j], ((at - along[j - 1]) / step).clamp(0.0, 1.0))
        })
        .collect()
}

/// A dense smooth line through the points of a profile (Catmull and Rom, 1974), off the axis only
/// at its ends.
pub(super) fn smooth(profile: &[Knot]) -> impl Iterator<Item = DVec2> {
    const PIECES: usize = 16;
    let at = |k: isize| {
        let last = profile.len() as isize - 1;
        // Beyond the ends the line goes on as its mirror image.
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

/// Points of a rounded corner from where the arc starts to where it ends.
fn corner(before: DVec2, knot: Knot, after: DVec2, edge: f64) -> Vec<DVec2> {
    let (to_before, to_after) = (before - knot.at, after - knot.at);
    let (from, to) = (to_before.normalize_or_zero(), to_after.normalize_or_zero());
    let turn = (-from).angle_to(to);
    let half = (0.5 * turn.abs()).tan();
    let room = 0.48 * to_before.length().min(to_after.length());
    let reach = (knot.fillet * half).min(room);
    if knot.fillet <= 0.0 || turn.abs() < 0.05 || reach < 2e-4 {
        return vec![knot.at];
    }
    let radius = reach / half;
    let count = (turn.abs() * radius / edge)
        .round()
        .max((turn.abs() / FRAC_PI_2).ceil().min(3.0));
    let start = knot.at + reach * from;
    let center = start + radius * turn.signum() * (-from).perp();
    (0..=count as usize)
        .map(|k| center + DVec2::from_angle(turn * k as f64 / count).rotate(start - center))
        .collect()
}

/// The line with its sides cut into equal pieces of at most about `edge`.
fn divided(corners: &[DVec2], edge: f64) -> Vec<DVec2> {
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
    fn a_rounded_square_keeps_its_sides_and_loses_its_corners() {
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
    fn a_dense_line_is_cut_into_equal_pieces() {
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
