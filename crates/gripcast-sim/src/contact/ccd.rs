//! Continuous collision on straight trajectories: how far a step may go.
//!
//! Additive advance (Li et al. 2021, C-IPC, algorithm 1): the distance over a bound of the relative
//! motion is a time that cannot be too late; walk it, measure again. Each step is the longer of
//! that bound and of the time for which the plane across the closest points still separates both
//! features (conservative advancement, Mirtich 1996), which lets features slide past each other in
//! few steps.
//!
//! With `g = slack · (initial distance)`, both bounds keep the distance at g or more. So up to a
//! returned time, and up to the end of the step if there is none, the distance never falls below
//! g; at the returned time it is at most 1.1 g.

use glam::DVec3;

use super::distance::{Closest, edge_edge, point_triangle};

/// Steps aim at this multiple of the gap that must remain, so that rounding does not go below it.
const AIM: f64 = 1.01;

/// The walk ends when the distance is at most this multiple of the gap that must remain.
const CLOSE_ENOUGH: f64 = 1.1;

/// Bound of the walk; the time reached by then is safe, only early.
const MAX_ITERATIONS: usize = 1000;

/// A stencil with its split into two convex features.
trait Stencil {
    /// Stencil indices of the two features.
    const FIRST: &'static [usize];
    const SECOND: &'static [usize];

    fn closest(x: &[DVec3; 4]) -> Closest;
}

struct PointTriangle;

impl Stencil for PointTriangle {
    const FIRST: &'static [usize] = &[0];
    const SECOND: &'static [usize] = &[1, 2, 3];

    #[inline]
    fn closest(x: &[DVec3; 4]) -> Closest {
        point_triangle(x[0], x[1], x[2], x[3])
    }
}

struct EdgeEdge;

impl Stencil for EdgeEdge {
    const FIRST: &'static [usize] = &[0, 1];
    const SECOND: &'static [usize] = &[2, 3];

    #[inline]
    fn closest(x: &[DVec3; 4]) -> Closest {
        edge_edge(x[0], x[1], x[2], x[3])
    }
}

/// Largest possible decrease of the distance over the whole step, m: the longest motion in each
/// feature, with the mean motion taken away.
#[inline]
fn motion_bound<S: Stencil>(motion: &[DVec3; 4]) -> f64 {
    let mean = (motion[0] + motion[1] + motion[2] + motion[3]) * 0.25;
    let longest = |feature: &[usize]| {
        feature
            .iter()
            .map(|&i| (motion[i] - mean).length_squared())
            .fold(0.0, f64::max)
            .sqrt()
    };
    longest(S::FIRST) + longest(S::SECOND)
}

/// Time for which the features stay at least `gap` apart along `normal`.
#[inline]
fn separated_time<S: Stencil>(x: &[DVec3; 4], motion: &[DVec3; 4], normal: DVec3, gap: f64) -> f64 {
    let mut time = f64::INFINITY;
    for &i in S::FIRST {
        for &j in S::SECOND {
            let closing = normal.dot(motion[j] - motion[i]);
            if closing > 0.0 {
                time = time.min((normal.dot(x[i] - x[j]) - gap) / closing);
            }
        }
    }
    time
}

fn time_of_impact<S: Stencil>(x0: &[DVec3; 4], x1: &[DVec3; 4], slack: f64) -> Option<f64> {
    let motion: [DVec3; 4] = std::array::from_fn(|i| x1[i] - x0[i]);
    let bound = motion_bound::<S>(&motion);
    let mut closest = S::closest(x0);
    let mut distance = closest.distance();
    let gap = slack * distance;
    let aim = AIM * gap;
    if bound <= distance - aim {
        return None;
    }
    if distance <= 0.0 {
        return Some(0.0);
    }
    let mut time = 0.0;
    let mut x = *x0;
    for _ in 0..MAX_ITERATIONS {
        let plane = separated_time::<S>(&x, &motion, closest.offset / distance, aim);
        let next = time + plane.max((distance - aim) / bound);
        if next >= 1.0 {
            return None;
        }
        x = std::array::from_fn(|i| x0[i] + motion[i] * next);
        closest = S::closest(&x);
        distance = closest.distance();
        // Only where the gap is as small as the rounding of positions.
        if distance < gap {
            return Some(time);
        }
        time = next;
        if distance <= CLOSE_ENOUGH * gap {
            break;
        }
    }
    Some(time)
}

/// Time in [0, 1] up to which a point and a triangle may move from `x0` to `x1`, stencil
/// `[p, t0, t1, t2]`, so that `slack` (in (0, 0.9]) of their distance remains; nothing when the whole
/// step may be taken. 0 when they touch already and move against each other.
#[inline]
pub fn point_triangle_toi(x0: &[DVec3; 4], x1: &[DVec3; 4], slack: f64) -> Option<f64> {
    time_of_impact::<PointTriangle>(x0, x1, slack)
}

/// As [`point_triangle_toi`] for two edges, stencil `[a0, a1, b0, b1]`.
#[inline]
pub fn edge_edge_toi(x0: &[DVec3; 4], x1: &[DVec3; 4], slack: f64) -> Option<f64> {
    time_of_impact::<EdgeEdge>(x0, x1, slack)
}

/// As [`point_triangle_toi`] for a point at signed distance `d0` (m) from a half-space that ends
/// the step at `d1` (m); exact. 0 when the point is not outside at first and does not move out.
#[inline]
pub fn half_space_toi(d0: f64, d1: f64, slack: f64) -> Option<f64> {
    if d0 <= 0.0 {
        return (d1 <= d0).then_some(0.0);
    }
    if d1 >= slack * d0 {
        return None;
    }
    Some((1.0 - slack) * d0 / (d0 - d1))
}

#[cfg(test)]
#[path = "ccd_test.rs"]
mod tests;
