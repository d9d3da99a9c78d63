//! Bowls, dishes and saucers.

use glam::{DVec2, DVec3};

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{even, open_line, rounded, sharp};
use super::shape::with_edge;
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form(&["bowl", "saucer", "dish", "deep bowl", "lobed bowl"]);
    let radius = draw.between(0.026, 0.062);
    let height = radius
        * match form {
            "saucer" => draw.between(0.22, 0.35),
            "dish" => draw.between(0.4, 0.6),
            "deep bowl" => draw.between(0.9, 1.25),
            _ => draw.between(0.55, 0.9),
        };
    let wall = draw.between(0.0028, 0.0045);
    let foot = radius * draw.between(0.35, 0.55);
    let foot_height = draw.between(0.0015, 0.004);
    // 2 is a quarter ellipse, more is steeper.
    let power = draw.between(1.6, 3.0);
    let section = match form {
        "lobed bowl" => Section::lobes(draw.count(5, 9), draw.between(0.02, 0.05)),
        "dish" => Section::oblong(draw.between(1.0, 1.25), 4.0),
        _ => Section::circle(),
    };
    // Otherwise wide sections exceed the maximum edge length.
    let scale = if form == "dish" { 0.9 } else { 1.0 };
    with_edge(|edge| {
        let inner =
            curve(radius - wall, height - wall, power).map(|p| p + DVec2::Y * (foot_height + wall));
        let outer = curve(radius, height, power).map(|p| p + DVec2::Y * foot_height);
        let side = even(&outside(&outer, foot), edge);
        let standing = [
            sharp(0.0, 0.0),
            rounded(foot, 0.0, 0.001),
            sharp(foot, 0.3 * foot_height),
            sharp(side[0].x, side[0].y),
        ];
        let mut profile = open_line(&standing, edge);
        profile.extend(&side[1..]);
        let mut inside = even(&inner, edge);
        inside.reverse();
        // The rim: one ring between the two sides.
        profile.push(DVec2::new(
            radius - 0.5 * wall,
            height + foot_height + 0.3 * wall,
        ));
        profile.extend(inside);
        let lathe = Lathe {
            profile: &profile,
            closed: false,
            section: &section,
            fraction: &|point| (point.x / radius - 0.3).clamp(0.0, 0.5) * 2.0,
            edge,
        };
        let mut mesh = lathe.mesh();
        for v in &mut mesh.vertices {
            *v *= DVec3::splat(scale);
        }
        Ok(mesh)
    })
}

/// A quarter superellipse from the axis to the rim.
fn curve(radius: f64, height: f64, power: f64) -> [DVec2; 65] {
    std::array::from_fn(|k| {
        let (sin, cos) = (std::f64::consts::FRAC_PI_2 * k as f64 / 64.0).sin_cos();
        let round = DVec2::new(sin.powf(2.0 / power), 1.0 - cos.powf(2.0 / power));
        round * DVec2::new(radius, height)
    })
}

/// The points of a curve outside of a radius.
fn outside(curve: &[DVec2], radius: f64) -> Vec<DVec2> {
    let far = curve.iter().copied().filter(|p| p.x > 1.02 * radius);
    far.collect()
}
