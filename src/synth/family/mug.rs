//! Mugs, tea cups, tankards and jugs with a handle.

use std::f64::consts::FRAC_PI_2;

use glam::{DQuat, DVec3};

use super::draw::Draw;
use super::solid::{Form, Role, Solid};
use crate::error::Result;
use crate::geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form(["mug", "tea cup", "tankard", "angular mug", "espresso cup"]);
    let radius = match form {
        "espresso cup" => draw.between("radius_m", 0.02, 0.026),
        "tea cup" => draw.between("radius_m", 0.028, 0.038),
        _ => draw.between("radius_m", 0.025, 0.035),
    };
    let tall = match form {
        "tea cup" => draw.between("height", 1.1, 1.5),
        "tankard" => draw.between("height", 2.4, 3.2),
        _ => draw.between("height", 1.8, 2.5),
    };
    let half = 0.5 * (radius * tall).min(0.1);
    let base = match form {
        "tea cup" => radius * draw.between("base", 0.55, 0.75),
        "tankard" => radius * draw.between("base", 1.0, 1.12),
        _ => radius * draw.between("base", 0.82, 1.0),
    };
    let wall = draw.between("wall_m", 0.0032, 0.0045);
    let floor = draw.between("floor_m", 0.0035, 0.006);
    let thick = draw.between("handle_m", 0.0032, 0.0048);
    let reach = draw.between("reach_m", 0.016, 0.026);
    let span = half * draw.between("span", 0.5, 0.72);
    let round = draw.between("fillet_m", 0.001, 0.005);
    let mut solid = Solid::new(wall);
    solid.put(
        Form::Drum([base, radius], half, round),
        DVec3::ZERO,
        DQuat::IDENTITY,
        Role::Add(0.0),
    );
    handle(&mut solid, form, [base, radius], half, [thick, reach, span]);
    // The hollow goes on above the rim, at the slope of the outside.
    let (bottom, top) = (floor - half, half + 0.015);
    let inner = |z: f64| base + (radius - base) * (0.5 + 0.5 * z / half) - wall;
    let hollow = Form::Drum(
        [inner(bottom), inner(top)],
        0.5 * (top - bottom),
        0.6 * round + 0.001,
    );
    let middle = DVec3::Z * (0.5 * (top + bottom));
    solid.put(hollow, middle, DQuat::IDENTITY, Role::Cut(0.001));
    Ok(solid.mesh())
}

/// A handle towards +x from `[thickness, reach, half height]`.
fn handle(
    solid: &mut Solid,
    form: &str,
    [base, radius]: [f64; 2],
    half: f64,
    [thick, reach, span]: [f64; 3],
) {
    const BLEND_M: f64 = 0.003;
    let side = |z: f64| base + (radius - base) * (0.5 + 0.5 * z / half) - 0.5 * thick;
    let raise = 0.08 * half;
    if form == "angular mug" {
        let corner = side(0.0) + reach;
        let places = [
            DVec3::new(side(raise + span), 0.0, raise + span),
            DVec3::new(corner, 0.0, raise + span),
            DVec3::new(corner - 0.3 * reach, 0.0, raise - span),
            DVec3::new(side(raise - span), 0.0, raise - span),
        ];
        for pair in places.windows(2) {
            solid.limb([pair[0], pair[1]], [thick; 2], BLEND_M);
        }
        return;
    }
    // Half an ellipse of short limbs; the ends of tea cups' handles point downwards.
    let drop = if form == "tea cup" { 0.15 * span } else { 0.0 };
    let places: [DVec3; 9] = std::array::from_fn(|k| {
        let (sin, cos) = (FRAC_PI_2 * (k as f64 / 4.0 - 1.0)).sin_cos();
        let z = raise + span * sin + drop * cos;
        DVec3::new(side(raise + span * sin) + reach * cos, 0.0, z)
    });
    for pair in places.windows(2) {
        solid.limb([pair[0], pair[1]], [thick; 2], 0.001);
    }
}
