//! Closed bottles.

use glam::DVec3;

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{open_line, rounded, sharp};
use super::shape::sized;
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form([
        "round",
        "square",
        "flat",
        "waisted",
        "dropper",
        "jug-shouldered",
    ]);
    let wide = match form {
        "dropper" => draw.between("radius_m", 0.011, 0.018),
        "flat" => draw.between("radius_m", 0.011, 0.018),
        _ => draw.between("radius_m", 0.015, 0.034),
    };
    let section = match form {
        "square" => Section::oblong(draw.between("aspect", 1.0, 1.25), 6.0),
        "flat" => Section::oblong(draw.between("aspect", 1.6, 2.2), 3.5),
        _ => Section::circle(),
    };
    let body = draw.between("body_m", 1.4, 3.0) * wide;
    let shoulder = draw.between("shoulder_m", 0.35, 1.1) * wide;
    let neck = wide * draw.between("neck", 0.36, 0.6);
    let neck_length = draw.between("neck_length_m", 0.002, 0.012);
    let cap = neck + draw.between("cap_rim_m", 0.0008, 0.003);
    let cap_length = draw.between("cap_length_m", 0.008, 0.02);
    let tip = draw.between("tip_m", 0.01, 0.018);
    let waist = draw.between("waist", 0.12, 0.28);
    let base = draw.between("base_fillet_m", 0.0015, 0.006);
    let above = body + shoulder;
    let under_cap = above + neck_length;
    let top = under_cap + cap_length;
    let scale = (0.145 / (top + tip)).min(1.0);
    sized(|edge| {
        let mut knots = vec![sharp(0.0, 0.0), rounded(wide, 0.0, base)];
        if form == "waisted" {
            let slim = wide * (1.0 - waist);
            knots.push(rounded(wide, 0.25 * body, 0.2 * body));
            knots.push(rounded(slim, 0.5 * body, 0.25 * body));
            knots.push(rounded(wide, 0.8 * body, 0.2 * body));
        }
        let bulge = if form == "jug-shouldered" { 0.35 } else { 0.0 };
        knots.push(rounded(
            wide,
            body + bulge * shoulder,
            0.6 * shoulder.min(wide),
        ));
        knots.push(rounded(neck, above, 0.4 * shoulder));
        knots.push(sharp(neck, under_cap));
        knots.push(rounded(cap, under_cap, 0.0));
        if form == "dropper" {
            knots.push(rounded(cap, under_cap + 0.6 * cap_length, 0.001));
            knots.push(rounded(0.55 * cap, under_cap + 0.6 * cap_length, 0.001));
            knots.push(rounded(0.5 * cap, top + tip, 0.3 * cap));
        } else {
            knots.push(rounded(cap, top, 0.0015));
        }
        let last = knots[knots.len() - 1].at.y;
        knots.push(sharp(0.0, last));
        let profile = open_line(&knots, edge / scale);
        let lathe = Lathe {
            profile: &profile,
            closed: false,
            section: &section,
            share: &|at| 1.0 - ((at.y - body) / shoulder).clamp(0.0, 1.0),
            edge: edge / scale,
        };
        let mut mesh = lathe.mesh();
        for v in &mut mesh.vertices {
            *v *= DVec3::splat(scale);
        }
        Ok(mesh)
    })
}
