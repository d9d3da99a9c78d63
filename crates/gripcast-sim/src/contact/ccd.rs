//! Continuous collision detection (CCD) on linear trajectories.
//!
//! Additive CCD (Li et al. 2021, C-IPC, algorithm 1): the distance divided by a bound of the
//! relative motion is a safe time step; advance and repeat. Each advance is the longer of that time
//! and the time for which the plane across the closest points still separates both features
//! (conservative advancement, Mirtich 1996), which lets features slide past each other in few
//! steps.
//!
//! With `g = slack · (initial distance)`, both bounds keep the distance at g or more: up to the
//! returned time, or the end of the step if there is none, it never falls below g, and at the
//! returned time it is at most 1.1 g.

use glam::DVec3;

use super::distance::{Closest, edge_edge, point_triangle};

/// Target of an advance as a multiple of the gap that must remain, to absorb rounding.
const TARGET_RATIO: f64 = 1.01;

/// Distance at which the iteration ends, as a multiple of the gap that must remain.
const STOP_RATIO: f64 = 1.1;

/// Iteration limit; the time reached by then is safe, but early.
const MAX_ITERATIONS: usize = 1000;

/// A stencil split into two convex features.
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

/// Upper bound of the decrease of the distance over the whole step, m: the sum of the longest
/// motions of both features relative to the mean motion.
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
    let target = TARGET_RATIO * gap;
    if bound <= distance - target {
        return None;
    }
    if distance <= 0.0 {
        return Some(0.0);
    }
    let mut time = 0.0;
    let mut x = *x0;
    for _ in 0..MAX_ITERATIONS {
        let plane = separated_time::<S>(&x, &motion, closest.offset / distance, target);
        let next = time + plane.max((distance - target) / bound);
        if next >= 1.0 {
            return None;
        }
        x = std::array::from_fn(|i| x0[i] + motion[i] * next);
        closest = S::closest(&x);
        distance = closest.distance();
        // Only if the gap is as small as the rounding of positions.
        if distance < gap {
            return Some(time);
        }
        time = next;
        if distance <= STOP_RATIO * gap {
            break;
        }
    }
    Some(time)
}

/// Time of impact in [0, 1] of a point and a triangle, stencil `[p, t0, t1, t2]`, that move from
/// `x0` to `x1`: the time up to which the fraction `slack` (in (0, 0.9]) of their distance remains.
/// `None` if the whole step is free; 0 if they touch and move against each other.
#[inline]
pub fn point_triangle_toi(x0: &[DVec3; 4], x1: &[DVec3; 4], slack: f64) -> Option<f64> {
    time_of_impact::<PointTriangle>(x0, x1, slack)
}

/// [`point_triangle_toi`] for two edges, stencil `[a0, a1, b0, b1]`.
#[inline]
pub fn edge_edge_toi(x0: &[DVec3; 4], x1: &[DVec3; 4], slack: f64) -> Option<f64> {
    time_of_impact::<EdgeEdge>(x0, x1, slack)
}

/// [`point_triangle_toi`] for a point whose signed distance from a half-space changes from `d0` to
/// `d1` (m); exact. 0 if the point starts inside and does not move outwards.
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
