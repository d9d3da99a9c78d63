//! Non-convex shapes that are hard to grasp, and hard for convex pieces and rigid fingers.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::implicit::surface;
use crate::mesh::TriangleMesh;

/// Width of the faces, m.
const CELL_M: f64 = 1.7e-3;

/// Smooth minimum: union of bodies with a fillet of about `width` (m) (quadratic, Quilez, *Smooth
/// minimum*).
fn union(a: f64, b: f64, width: f64) -> f64 {
    let overlap = (width - (a - b).abs()).max(0.0) / width;
    a.min(b) - 0.25 * width * overlap * overlap
}

/// Smooth maximum: intersection of bodies with rounded edges.
fn intersection(a: f64, b: f64, width: f64) -> f64 {
    -union(-a, -b, width)
}

/// Signed distance to a capsule between two points, m.
fn capsule(p: DVec3, [a, b]: [DVec3; 2], radius: f64) -> f64 {
    let along = b - a;
    let fraction = ((p - a).dot(along) / along.length_squared()).clamp(0.0, 1.0);
    p.distance(a + fraction * along) - radius
}

/// Three crossed bars with a knob at each end: six arms of different lengths.
pub(super) fn jack() -> TriangleMesh {
    const ARMS: [f64; 6] = [0.026, 0.023, 0.025, 0.025, 0.022, 0.026];
    const ARM_RADIUS: f64 = 0.0052;
    const KNOB_RADIUS: f64 = 0.0080;
    let ends = || {
        let axes = DVec3::AXES.into_iter().flat_map(|axis| [axis, -axis]);
        axes.zip(ARMS).map(|(axis, length)| length * axis)
    };
    let field = |p: DVec3| {
        ends().fold(f64::INFINITY, |body, end| {
            let arm = capsule(p, [DVec3::ZERO, end], ARM_RADIUS);
            let knob = p.distance(end) - KNOB_RADIUS;
            union(body, union(arm, knob, 0.004), 0.005)
        })
    };
    surface(&field, DVec3::splat(0.036), CELL_M)
}

/// A prism over a star of five rounded points, twisted by 50° over its height.
pub(super) fn star() -> TriangleMesh {
    const RADIUS: f64 = 0.0195;
    const POINT: f64 = 0.0055;
    const HALF_HEIGHT: f64 = 0.025;
    let twist = 50f64.to_radians() / (2.0 * HALF_HEIGHT);
    let field = |p: DVec3| {
        let angle = p.y.atan2(p.x) - twist * p.z;
        let radius = p.truncate().length();
        // Steep flanks: the slope of the outline reduces the distance.
        let off = radius - RADIUS - POINT * (5.0 * angle).cos();
        let slope = 5.0 * POINT * (5.0 * angle).sin() / radius.max(0.8 * RADIUS);
        let side = off / slope.hypot(1.0);
        intersection(side, p.z.abs() - HALF_HEIGHT, 0.004)
    };
    surface(&field, DVec3::new(0.027, 0.027, 0.027), CELL_M)
}

/// A ball with dents of different depths.
pub(super) fn dented() -> TriangleMesh {
    const RADIUS: f64 = 0.028;
    /// Direction and distance of the ball that makes each dent.
    const DENTS: [([f64; 3], f64); 7] = [
        ([1.0, 0.1, 0.2], 0.031),
        ([-0.9, 0.5, 0.2], 0.033),
        ([0.1, 1.0, -0.3], 0.034),
        ([-0.3, -1.0, 0.1], 0.032),
        ([0.2, -0.2, 1.0], 0.035),
        ([0.2, 0.1, -1.0], 0.035),
        ([-0.8, -0.2, -0.8], 0.036),
    ];
    const DENT_RADIUS: f64 = 0.0135;
    let field = |p: DVec3| {
        let body = p.length() - RADIUS;
        DENTS.into_iter().fold(body, |body, (towards, away)| {
            let center = away * DVec3::from_array(towards).normalize();
            intersection(body, DENT_RADIUS - p.distance(center), 0.005)
        })
    };
    surface(&field, DVec3::splat(0.03), CELL_M)
}

/// A ring whose radius, thickness and height vary around it.
pub(super) fn ring() -> TriangleMesh {
    let field = |p: DVec3| {
        let angle = p.y.atan2(p.x);
        let radius = 0.0215 + 0.0022 * (3.0 * angle).cos();
        let height = 0.0035 * (2.0 * angle + 0.6).sin();
        let tube = 0.0085 + 0.0012 * (5.0 * angle + 1.0).cos();
        DVec2::new(p.truncate().length() - radius, p.z - height).length() - tube
    };
    surface(&field, DVec3::new(0.036, 0.036, 0.016), CELL_M)
}

/// A thick saddle for three legs (a monkey saddle) with a round rim.
pub(super) fn saddle() -> TriangleMesh {
    const RADIUS: f64 = 0.029;
    const BEND: f64 = 0.014;
    const HALF_THICKNESS: f64 = 0.0055;
    let field = |p: DVec3| {
        let (u, v) = (p.x / RADIUS, p.y / RADIUS);
        let height = BEND * (u * u * u - 3.0 * u * v * v);
        let slope = 3.0 * BEND / RADIUS * (u * u + v * v);
        let sheet = (p.z - height).abs() / slope.hypot(1.0) - HALF_THICKNESS;
        intersection(sheet, p.truncate().length() - RADIUS, 0.006)
    };
    surface(&field, DVec3::new(0.032, 0.032, 0.026), CELL_M)
}

/// A ball with asymmetric bumps and hollows.
pub(super) fn lump() -> TriangleMesh {
    const RADIUS: f64 = 0.0245;
    /// Waves over the unit sphere: direction, frequency and phase in turns, height, m.
    const WAVES: [([f64; 3], f64, f64, f64); 5] = [
        ([0.3, 1.0, 0.2], 0.62, 0.10, 0.0032),
        ([1.0, -0.4, 0.5], 0.71, 0.35, 0.0030),
        ([-0.2, 0.5, 1.0], 0.80, 0.62, 0.0026),
        ([0.8, 0.7, -0.9], 1.05, 0.20, 0.0020),
        ([-0.6, 0.9, 0.4], 1.25, 0.80, 0.0014),
    ];
    let field = |p: DVec3| {
        let out = p.normalize_or_zero();
        let waves = WAVES
            .into_iter()
            .map(|(towards, frequency, phase, height)| {
                let along = DVec3::from_array(towards).normalize().dot(out);
                height * (TAU * (frequency * along + phase)).sin()
            });
        // Steep bumps: the radius grows faster than the distance.
        0.8 * (p.length() - RADIUS - waves.sum::<f64>())
    };
    surface(&field, DVec3::splat(0.035), CELL_M)
}
