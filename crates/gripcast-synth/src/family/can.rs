//! Cans, jars, tins and open cups.

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{Knot, open_line, rounded, sharp};
use super::shape::sized;
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form([
        "can",
        "drink can",
        "jar",
        "tin",
        "cup",
        "flower pot",
        "square tin",
    ]);
    let radius = draw.between("radius_m", 0.016, 0.038);
    let tall = match form {
        "tin" => (0.5, 1.1),
        "square tin" => (0.8, 2.0),
        _ => (1.6, 3.2),
    };
    let height = (radius * draw.between("height", tall.0, tall.1)).min(0.125);
    let knots = match form {
        "can" => can(draw, radius, height),
        "drink can" => drink_can(draw, radius, height),
        "cup" => cup(draw, radius, height, false),
        "flower pot" => cup(draw, radius, height, true),
        _ => jar(draw, radius, height),
    };
    let section = if form == "square tin" {
        Section::oblong(draw.between("aspect", 1.0, 1.6), 6.0)
    } else {
        Section::circle()
    };
    sized(|edge| {
        let profile = open_line(&knots, edge);
        let lathe = Lathe::prism(&profile, &section, edge);
        Ok(lathe.mesh())
    })
}

/// A food can: a rim at both ends that the lids lie back behind.
fn can(draw: &mut Draw, radius: f64, height: f64) -> Vec<Knot> {
    let rim = draw.between("rim_m", 0.0008, 0.0018);
    let wide = draw.between("rim_height_m", 0.002, 0.004);
    let lid = draw.between("lid_depth_m", 0.001, 0.003);
    let inner = radius - 0.004;
    vec![
        sharp(0.0, lid),
        sharp(inner, lid),
        sharp(inner + 0.001, 0.0),
        rounded(radius + rim, 0.0, 0.001),
        sharp(radius + rim, wide),
        sharp(radius, wide + rim),
        sharp(radius, height - wide - rim),
        sharp(radius + rim, height - wide),
        rounded(radius + rim, height, 0.001),
        sharp(inner + 0.001, height),
        sharp(inner, height - lid),
        sharp(0.0, height - lid),
    ]
}

fn drink_can(draw: &mut Draw, radius: f64, height: f64) -> Vec<Knot> {
    let neck = radius * draw.between("neck", 0.78, 0.9);
    let shoulder = draw.between("shoulder_m", 0.006, 0.012);
    let lid = draw.between("lid_depth_m", 0.0015, 0.003);
    vec![
        sharp(0.0, lid),
        sharp(neck - 0.005, lid),
        sharp(neck - 0.003, 0.0),
        sharp(neck, 0.0),
        rounded(radius, 0.7 * shoulder, 0.006),
        rounded(radius, height - shoulder, 0.006),
        sharp(neck, height - 0.0025),
        sharp(neck, height),
        sharp(neck - 0.003, height),
        sharp(neck - 0.0035, height - lid),
        sharp(0.0, height - lid),
    ]
}

/// A body and a lid that is wider or narrower.
fn jar(draw: &mut Draw, radius: f64, height: f64) -> Vec<Knot> {
    let lid = radius * draw.between("lid", 0.8, 1.06);
    let lid_height = height * draw.between("lid_height", 0.15, 0.3);
    let body = height - lid_height;
    let shoulder = draw.between("shoulder_m", 0.001, 0.008).min(0.4 * body);
    let fillet = draw.between("fillet_m", 0.001, 0.005);
    let neck = lid.min(radius) - 0.0015;
    vec![
        sharp(0.0, 0.0),
        rounded(radius, 0.0, fillet),
        rounded(radius, body - shoulder, fillet),
        sharp(neck, body - 0.0012),
        sharp(neck, body),
        rounded(lid, body, 0.0),
        rounded(lid, height, 0.0012),
        sharp(0.0, height),
    ]
}

/// An open cup; a flower pot has a thick rim.
fn cup(draw: &mut Draw, radius: f64, height: f64, pot: bool) -> Vec<Knot> {
    let wall = draw.between("wall_m", 0.0025, 0.0045);
    let base = radius * draw.between("base", 0.65, 0.98);
    let floor = draw.between("floor_m", 0.003, 0.006);
    let mut knots = vec![sharp(0.0, 0.0), rounded(base, 0.0, 0.0015)];
    if pot {
        let rim = draw.between("rim_m", 0.0015, 0.003);
        let from = height * draw.between("rim_from", 0.7, 0.82);
        let waist = base + (radius - base) * from / height;
        knots.push(sharp(waist, from));
        knots.push(sharp(waist + rim, from));
        knots.push(rounded(radius + rim, height, 0.001));
    } else {
        knots.push(rounded(radius, height, 0.001));
    }
    knots.push(rounded(radius - wall, height, 0.001));
    knots.push(rounded(base - wall, floor, 0.003));
    knots.push(sharp(0.0, floor));
    knots
}
