//! Random bodies of graded complexity, from a ball with a bump to a tangle, in the spirit of
//! EGAD (Morrison et al., RA-L 2020).

use glam::{DQuat, DVec3};

use super::draw::Draw;
use super::solid::{Operation, Primitive, Solid};
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

/// Minimum thickness of capsules, m.
const MIN_THICKNESS_M: f64 = 0.005;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    draw.form(&["random body"]);
    let complexity = draw.count(1, 6);
    let size = draw.between(0.02, 0.042);
    let blend = draw.between(0.08, 0.3) * size;
    let cuts = draw.count(0, complexity.div_ceil(2));
    let spread = draw.between(0.5, 0.85);
    let mut solid = Solid::new(MIN_THICKNESS_M);
    let core = form(draw, 0.55 * size);
    solid.add(core, DVec3::ZERO, rotation(draw), Operation::Union(0.0));
    let mut ends = vec![DVec3::ZERO];
    for _ in 0..complexity {
        // A capsule connects each primitive to an earlier one.
        let from = ends[(draw.between(0.0, 0.999) * ends.len() as f64) as usize];
        let out = (from.normalize_or_zero() * 0.6 + direction(draw)).normalize_or(DVec3::X);
        let end = from + out * (spread * size * draw.between(0.7, 1.15));
        let end = end.clamp_length_max(1.2 * size);
        let half = size * draw.between(0.22, 0.42);
        let primitive = form(draw, half);
        let capsule = size * draw.between(0.13, 0.24);
        let radius = capsule.max(0.5 * MIN_THICKNESS_M);
        solid.capsule([from, end], [radius; 2], blend);
        solid.add(primitive, end, rotation(draw), Operation::Union(blend));
        ends.push(end);
    }
    for _ in 0..cuts {
        let at = direction(draw) * (size * draw.between(0.55, 0.75));
        let half = size * draw.between(0.2, 0.35);
        let dent = form(draw, half);
        solid.add(
            dent,
            at,
            rotation(draw),
            Operation::Difference(blend.max(0.004)),
        );
    }
    Ok(solid.mesh())
}

/// Draws a primitive of about the given half size (m).
fn form(draw: &mut Draw, size: f64) -> Primitive {
    let [a, b, c] = [0.7, 0.7, 0.7].map(|low| size * draw.between(low, 1.15));
    match (draw.between(0.0, 4.999)) as usize {
        0 => Primitive::Ellipsoid(DVec3::new(a, b, c)),
        1 => Primitive::Box(DVec3::new(a, b, c) * 0.85, 0.1 * size),
        2 => Primitive::Frustum([a, 0.8 * b], c, 0.08 * size),
        3 => Primitive::Torus(a.max(0.5 * size), (0.4 * size).max(0.5 * MIN_THICKNESS_M)),
        _ => Primitive::Ellipsoid(DVec3::splat(a)),
    }
}

fn direction(draw: &mut Draw) -> DVec3 {
    let z = draw.between(-1.0, 1.0);
    let angle = draw.between(0.0, std::f64::consts::TAU);
    let (sin, cos) = angle.sin_cos();
    let flat = (1.0 - z * z).max(0.0).sqrt();
    DVec3::new(flat * cos, flat * sin, z)
}

fn rotation(draw: &mut Draw) -> DQuat {
    let axis = direction(draw);
    DQuat::from_axis_angle(axis.normalize_or(DVec3::X), draw.between(0.0, 3.0))
}
