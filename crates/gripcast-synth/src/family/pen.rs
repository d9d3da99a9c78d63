//! Slender turned things: pencils, markers, brushes, candles, lying along x or standing.

use glam::DVec3;

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{Knot, open_line, rounded, sharp};
use super::shape::sized_within;
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form([
        "pencil", "marker", "brush", "candle", "lipstick", "battery", "dowel",
    ]);
    let (radius, length) = match form {
        "pencil" => (
            draw.between("radius_m", 0.0035, 0.0055),
            draw.between("length_m", 0.06, 0.135),
        ),
        "brush" => (
            draw.between("radius_m", 0.004, 0.008),
            draw.between("length_m", 0.08, 0.145),
        ),
        "lipstick" => (
            draw.between("radius_m", 0.008, 0.012),
            draw.between("length_m", 0.05, 0.08),
        ),
        "battery" => {
            let radius = draw.between("radius_m", 0.005, 0.017);
            let tall = draw.between("height", 1.8, 4.2);
            (radius, (2.0 * radius * tall).clamp(0.03, 0.07))
        }
        "candle" => (
            draw.between("radius_m", 0.008, 0.03),
            draw.between("length_m", 0.035, 0.12),
        ),
        _ => (
            draw.between("radius_m", 0.005, 0.012),
            draw.between("length_m", 0.06, 0.14),
        ),
    };
    let knots = profile(draw, form, radius, length);
    let sides = draw.count("sides", 3, 8);
    let section = match (form, sides) {
        ("pencil", 3..=5) => Section::polygon(6),
        ("candle", 6..=8) => Section::lobes(sides, 0.04),
        ("lipstick", 3..=5) => Section::oblong(1.0, 5.0),
        ("pencil", 6) => Section::lobes(3, 0.07),
        _ => Section::circle(),
    };
    let standing = matches!(form, "candle" | "lipstick" | "battery");
    sized_within(3.2e-3, |edge| {
        let profile = open_line(&knots, edge);
        let lathe = Lathe {
            profile: &profile,
            closed: false,
            section: &section,
            share: &|at| {
                f64::from((form == "candle" || at.y < 0.8 * length) && at.x > 0.5 * radius)
            },
            edge,
        };
        let mut mesh = lathe.mesh();
        if !standing {
            for v in &mut mesh.vertices {
                *v = DVec3::new(v.z, v.x, v.y);
            }
        }
        Ok(mesh)
    })
}

fn profile(draw: &mut Draw, form: &str, radius: f64, length: f64) -> Vec<Knot> {
    let mut knots = vec![sharp(0.0, 0.0)];
    let share = draw.between("share", 0.3, 0.6);
    match form {
        "pencil" => {
            let tip = draw.between("tip", 2.0, 4.0) * radius;
            knots.push(rounded(radius, 0.0, 0.0006));
            knots.push(sharp(radius, length - tip));
            knots.push(sharp(0.22 * radius, length));
        }
        "marker" => {
            let cap = radius * draw.between("cap", 1.06, 1.25);
            let split = length * (1.0 - 0.6 * share);
            knots.push(rounded(0.92 * radius, 0.0, 0.002));
            knots.push(sharp(radius, 0.3 * length));
            knots.push(sharp(radius, split));
            knots.push(sharp(cap, split));
            knots.push(rounded(0.9 * cap, length, 0.002));
        }
        "brush" => {
            let neck = radius * draw.between("neck", 0.4, 0.6);
            let head = draw.between("head", 0.9, 1.8) * radius;
            let bristles = draw.between("bristles_m", 0.014, 0.026);
            let from = length - bristles;
            knots.push(rounded(0.5 * radius, 0.0, 0.002));
            knots.push(rounded(radius, share * length, 0.08));
            knots.push(rounded(neck, from - 0.014, 0.02));
            knots.push(sharp(0.75 * head, from - 0.002));
            knots.push(rounded(head, from + 0.5 * bristles, 0.02));
            knots.push(rounded(0.25 * head, length, 0.001));
        }
        "candle" => {
            let taper = draw.between("taper", 0.7, 1.0);
            knots.push(rounded(radius, 0.0, 0.001));
            knots.push(rounded(taper * radius, length - 0.006, 0.002));
            knots.push(rounded(0.0022, length - 0.006, 0.0));
            knots.push(rounded(0.0018, length, 0.0));
        }
        "lipstick" => {
            let inner = radius * draw.between("inner", 0.7, 0.9);
            knots.push(rounded(radius, 0.0, 0.001));
            knots.push(rounded(radius, share * length, 0.0006));
            knots.push(sharp(inner, share * length));
            knots.push(sharp(inner, 0.7 * length));
            knots.push(sharp(0.8 * inner, 0.7 * length));
            knots.push(rounded(0.75 * inner, length, 0.6 * inner));
        }
        "battery" => {
            let pole = radius * draw.between("pole", 0.35, 0.45);
            knots.push(rounded(radius, 0.0, 0.001));
            knots.push(rounded(radius, length - 0.002, 0.001));
            knots.push(sharp(pole, length - 0.0018));
            knots.push(sharp(pole, length));
        }
        _ => {
            let bevel = draw.between("bevel_m", 0.0006, 0.003);
            knots.push(rounded(radius, 0.0, bevel));
            knots.push(rounded(radius, length, bevel));
        }
    }
    let top = knots[knots.len() - 1].at.y;
    knots.push(sharp(0.0, top));
    knots
}
