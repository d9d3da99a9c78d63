//! Brackets of bent sheet with holes, gussets and flanges.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::DVec2;

use super::draw::Draw;
use super::outline::{circle, closed_line, rounded};
use super::plate::{bent, flat, upright};
use super::shape::sized_within;
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    match draw.form(["L", "U", "Z", "plate", "gusset", "flange", "channel"]) {
        "flange" => flange(draw),
        "gusset" => gusset(draw),
        "channel" => channel(draw),
        form => bent_strip(draw, form),
    }
}

/// A strip with round ends and holes, bent once, twice or not at all.
fn bent_strip(draw: &mut Draw, form: &str) -> Result<TriangleMesh> {
    let half = draw.between("half_width_m", 0.008, 0.022);
    let thick = draw.between("thickness_m", 0.0024, 0.005);
    let middle = draw.between("middle_m", 0.02, 0.05);
    let legs = [
        draw.between("leg_a_m", 0.02, 0.05),
        draw.between("leg_b_m", 0.02, 0.05),
    ];
    let radius = thick * draw.between("bend_radius", 1.1, 2.2);
    let angle = if form == "plate" {
        0.0
    } else {
        draw.between("bend_rad", 1.2, FRAC_PI_2)
    };
    let round = draw.between("end_fillet_m", 0.001, 0.98 * half);
    let hole = draw.between("hole_m", 0.0022, 0.0045).min(0.4 * half);
    let count = draw.count("holes", 1, 2);
    let (first, second) = match form {
        "U" => (angle, angle),
        "Z" => (angle, -angle),
        "L" => (angle, 0.0),
        _ => (0.0, 0.0),
    };
    let arcs = [first.abs() * radius, second.abs() * radius];
    // From the end of the first leg: bend, middle, bend, second leg.
    let bends = [legs[0], legs[0] + arcs[0] + middle];
    let total = if form == "L" {
        bends[1]
    } else {
        bends[1] + arcs[1] + legs[1]
    };
    sized_within(2.8e-3, |edge| {
        let corners = [(0.0, -half), (total, -half), (total, half), (0.0, half)];
        let outline = closed_line(&corners.map(|(x, y)| rounded(x, y, round)), edge);
        let mut holes = Vec::new();
        let mut spans = vec![(0.0, legs[0])];
        if form == "L" {
            spans.push((bends[0] + arcs[0], total));
        } else {
            spans.push((total - legs[1], total));
        }
        for (from, to) in spans {
            for k in 0..count {
                let share = (k as f64 + 1.0) / (count as f64 + 1.0);
                let at = DVec2::new(from + (to - from) * share, 0.0);
                holes.push(circle(at, hole.min(0.2 * (to - from)), edge));
            }
        }
        let mut mesh = flat(outline, holes, thick, edge)?;
        for v in &mut mesh.vertices {
            // The later bend first: the earlier one carries it along.
            *v = bent(*v, bends[1], radius, second);
            *v = bent(*v, bends[0], radius, first);
        }
        Ok(mesh)
    })
}

/// A corner piece: a triangle with holes.
fn gusset(draw: &mut Draw) -> Result<TriangleMesh> {
    let wide = draw.between("width_m", 0.03, 0.08);
    let tall = draw.between("height_m", 0.03, 0.08);
    let thick = draw.between("thickness_m", 0.004, 0.012);
    let cut = draw.between("cut", 0.15, 0.35);
    let fillet = draw.between("fillet_m", 0.001, 0.005);
    let hole = draw.between("hole", 0.1, 0.2);
    sized_within(3.2e-3, |edge| {
        let corners = [
            (0.0, 0.0),
            (wide, 0.0),
            (wide, cut * tall),
            (cut * wide, tall),
            (0.0, tall),
        ];
        let outline = closed_line(&corners.map(|(x, y)| rounded(x, y, fillet)), edge);
        let size = hole * wide.min(tall);
        let middle = circle(DVec2::new(0.36 * wide, 0.36 * tall), size, edge);
        Ok(upright(flat(outline, vec![middle], thick, edge)?))
    })
}

/// A profile rail: a short piece of a U, T or L.
fn channel(draw: &mut Draw) -> Result<TriangleMesh> {
    let kind = draw.count("kind", 0, 2);
    let wide = draw.between("width_m", 0.02, 0.05);
    let tall = draw.between("height_m", 0.015, 0.04);
    let wall = draw.between("wall_m", 0.003, 0.005);
    let length = draw.between("length_m", 0.03, 0.12);
    let half = 0.5 * wide;
    let points: Vec<(f64, f64)> = match kind {
        0 => vec![
            (-half, 0.0),
            (half, 0.0),
            (half, tall),
            (half - wall, tall),
            (half - wall, wall),
            (wall - half, wall),
            (wall - half, tall),
            (-half, tall),
        ],
        1 => vec![
            (-half, 0.0),
            (half, 0.0),
            (half, wall),
            (0.5 * wall, wall),
            (0.5 * wall, tall),
            (-0.5 * wall, tall),
            (-0.5 * wall, wall),
            (-half, wall),
        ],
        _ => vec![
            (-half, 0.0),
            (half, 0.0),
            (half, wall),
            (wall - half, wall),
            (wall - half, tall),
            (-half, tall),
        ],
    };
    sized_within(3.6e-3, |edge| {
        let knots: Vec<_> = points.iter().map(|&(x, y)| rounded(x, y, 0.0)).collect();
        Ok(upright(flat(
            closed_line(&knots, edge),
            Vec::new(),
            length,
            edge,
        )?))
    })
}

/// A round or square plate with a bore and a circle of holes.
fn flange(draw: &mut Draw) -> Result<TriangleMesh> {
    let radius = draw.between("radius_m", 0.018, 0.04);
    let thick = draw.between("thickness_m", 0.004, 0.014);
    let bore = radius * draw.between("bore", 0.2, 0.5);
    let hole = draw.between("hole", 0.07, 0.13) * radius;
    let square = draw.chance("square", 0.4);
    let fillet = draw.between("fillet_m", 0.001, 0.45 * radius);
    let count = if square { 4 } else { draw.count("holes", 3, 6) };
    sized_within(3.2e-3, |edge| {
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let outline = if square {
            let corners = corners.map(|(x, y)| rounded(radius * x, radius * y, fillet));
            closed_line(&corners, edge)
        } else {
            circle(DVec2::ZERO, radius, edge)
        };
        let mut holes = vec![circle(DVec2::ZERO, bore, edge)];
        for k in 0..count {
            let turn = TAU * (k as f64 + 0.5) / count as f64;
            let out = if square { 0.98 } else { 0.77 };
            holes.push(circle(out * radius * DVec2::from_angle(turn), hole, edge));
        }
        flat(outline, holes, thick, edge)
    })
}
