//! Thin things: cards, coasters, bent and wavy sheets, trays.

use std::f64::consts::TAU;

use glam::DVec2;

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{circle, closed_line, open_line, rounded, sharp};
use super::plate::{bent, flat};
use super::shape::sized;
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form([
        "card",
        "bent sheet",
        "wavy sheet",
        "folded sheet",
        "tray",
        "coaster",
        "tag",
    ]);
    let length = draw.between("length_m", 0.045, 0.13);
    let width = draw.between("width_m", 0.025, 0.078_f64.min(0.95 * length));
    let thick = draw.between("thickness_m", 0.002, 0.0048);
    if form == "tray" {
        return tray(draw, width);
    }
    let fillet = draw.between("fillet_m", 0.0005, 0.012);
    let bend = draw.between("bend_rad", 0.5, 2.4);
    let waves = draw.between("waves", 1.0, 3.0);
    let height = draw.between("wave_m", 0.0015, 0.006);
    let hole = draw.between("hole_m", 0.0025, 0.005);
    let sides = draw.count("sides", 3, 8);
    sized(|edge| {
        let half = 0.5 * width;
        let corners = [(0.0, -half), (length, -half), (length, half), (0.0, half)];
        let mut outline = closed_line(&corners.map(|(x, y)| rounded(x, y, fillet)), edge);
        let mut holes = Vec::new();
        if form == "coaster" {
            outline = coaster(half.min(0.5 * length), sides, fillet, edge);
        }
        if form == "tag" {
            holes.push(circle(
                DVec2::new(length - 2.2 * hole - 0.003, 0.0),
                hole,
                edge,
            ));
        }
        let mut mesh = flat(outline, holes, thick, edge)?;
        for v in &mut mesh.vertices {
            match form {
                "bent sheet" => *v = bent(*v, 0.0, length / bend, bend),
                "folded sheet" => *v = bent(*v, 0.45 * length, 2.5 * thick, 0.8 * bend),
                "wavy sheet" => v.z += height * (TAU * waves * v.x / length).sin(),
                _ => {}
            }
        }
        Ok(mesh)
    })
}

/// A disc or a polygon.
fn coaster(radius: f64, sides: usize, fillet: f64, edge: f64) -> Vec<DVec2> {
    if sides > 6 {
        return circle(DVec2::ZERO, radius, edge);
    }
    let knots: Vec<_> = (0..sides)
        .map(|k| {
            let p = radius * DVec2::from_angle(TAU * k as f64 / sides as f64);
            rounded(p.x, p.y, fillet)
        })
        .collect();
    closed_line(&knots, edge)
}

/// A shallow tray: a turned vessel with an oblong section.
fn tray(draw: &mut Draw, width: f64) -> Result<TriangleMesh> {
    let radius = 0.5 * width;
    let aspect = draw.between("aspect", 1.0, 1.8).min(0.07 / radius);
    let height = draw.between("height_m", 0.008, 0.02);
    let wall = draw.between("wall_m", 0.0025, 0.004);
    let slope = height * draw.between("slope", 0.0, 0.5);
    let section = Section::oblong(aspect.max(1.0), draw.between("power", 3.0, 7.0));
    sized(|edge| {
        let knots = [
            sharp(0.0, 0.0),
            rounded(radius - slope, 0.0, 0.001),
            rounded(radius, height, 0.0008),
            rounded(radius - wall, height, 0.0008),
            rounded(radius - slope - wall, wall, 0.001),
            sharp(0.0, wall),
        ];
        let profile = open_line(&knots, edge);
        let lathe = Lathe::prism(&profile, &section, edge);
        Ok(lathe.mesh())
    })
}
