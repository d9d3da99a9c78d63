//! Bolts, nuts, gears, spacers.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{circle, closed_line, open_line, rounded, sharp};
use super::plate::flat;
use super::shape::sized_within;
use super::solid::{Form, Role, Solid};
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    match draw.form([
        "bolt",
        "nut",
        "gear",
        "spacer",
        "wing nut",
        "round-head bolt",
    ]) {
        "nut" => nut(draw),
        "gear" => gear(draw),
        "spacer" => spacer(draw),
        "wing nut" => Ok(wing_nut(draw)),
        form => bolt(draw, form == "bolt"),
    }
}

/// A bolt that stands on its head.
fn bolt(draw: &mut Draw, hexagonal: bool) -> Result<TriangleMesh> {
    let shank = draw.between("shank_m", 0.004, 0.011);
    let head = shank * draw.between("head", 1.55, 2.0);
    let high = shank * draw.between("head_height", 1.1, 1.6);
    let length = draw.between("length_m", 0.02, 0.09);
    let collar = shank * draw.between("collar", 0.0, 0.25);
    let section = if hexagonal {
        Section::polygon(6)
    } else {
        Section::circle()
    };
    sized_within(3.0e-3, |edge| {
        let crown = if hexagonal { 0.0008 } else { 0.8 * high };
        let knots = [
            sharp(0.0, 0.0),
            rounded(head, 0.0, crown),
            sharp(head, high),
            sharp(shank + collar, high),
            sharp(shank + collar, high + 0.3 * length),
            sharp(shank, high + 0.3 * length + collar),
            rounded(shank, high + length, 0.0012),
            sharp(0.0, high + length),
        ];
        let profile = open_line(&knots, edge);
        let lathe = Lathe {
            profile: &profile,
            closed: false,
            section: &section,
            share: &|at| f64::from(at.y <= high + 1e-9 && at.x > shank + collar + 1e-6),
            edge,
        };
        Ok(lathe.mesh())
    })
}

fn nut(draw: &mut Draw) -> Result<TriangleMesh> {
    let radius = draw.between("radius_m", 0.011, 0.026);
    let hole = radius * draw.between("hole", 0.5, 0.62);
    let height = radius * draw.between("height", 0.6, 1.2);
    let bevel = draw.between("bevel_m", 0.0006, 0.002);
    let section = Section::polygon(draw.pick_sides());
    sized_within(3.0e-3, |edge| {
        let knots = [
            rounded(hole, 0.0, 0.0006),
            rounded(radius, 0.0, bevel),
            rounded(radius, height, bevel),
            rounded(hole, height, 0.0006),
        ];
        let profile = closed_line(&knots, edge);
        let lathe = Lathe {
            profile: &profile,
            closed: true,
            section: &section,
            share: &|at| ((at.x - hole) / (0.6 * (radius - hole))).clamp(0.0, 1.0),
            edge,
        };
        Ok(lathe.mesh())
    })
}

impl Draw {
    fn pick_sides(&mut self) -> usize {
        if self.chance("square", 0.25) { 4 } else { 6 }
    }
}

/// A gear wheel with trapezoidal teeth.
fn gear(draw: &mut Draw) -> Result<TriangleMesh> {
    let teeth = draw.count("teeth", 8, 18);
    let pitch = draw.between("pitch_m", 0.007, 0.011);
    let thick = draw.between("thickness_m", 0.006, 0.016);
    let radius = (teeth as f64 * pitch / TAU).min(0.038);
    let deep = draw.between("tooth", 0.3, 0.45) * TAU * radius / teeth as f64;
    let bore = radius * draw.between("bore", 0.15, 0.35);
    let spokes = draw.count("openings", 3, 6);
    let opened = draw.chance("opened", 0.5) && radius > 0.02;
    sized_within(2.8e-3, |edge| {
        let mut knots = Vec::new();
        for k in 0..teeth {
            let corners = [(-0.27, -deep), (-0.13, deep), (0.13, deep), (0.27, -deep)];
            for (turn, out) in corners {
                let angle = TAU * (k as f64 + turn) / teeth as f64;
                let p = (radius + 0.6 * out) * DVec2::from_angle(angle);
                knots.push(sharp(p.x, p.y));
            }
        }
        let mut holes = vec![circle(DVec2::ZERO, bore, edge)];
        if opened {
            let between = 0.5 * (bore + radius - deep);
            let room = 0.5 * (radius - deep - bore) - 0.003;
            let apart = TAU * between / spokes as f64;
            let size = room.min(0.5 * apart - 0.002);
            for k in 0..spokes {
                let at = between * DVec2::from_angle(TAU * k as f64 / spokes as f64);
                if size > 0.0025 {
                    holes.push(circle(at, size, edge));
                }
            }
        }
        flat(closed_line(&knots, edge), holes, thick, edge)
    })
}

fn spacer(draw: &mut Draw) -> Result<TriangleMesh> {
    let radius = draw.between("radius_m", 0.01, 0.028);
    let hole = radius * draw.between("hole", 0.3, 0.65);
    let height = draw.between("height_m", 0.006, 0.03);
    let step = draw.between("step", 0.75, 1.0);
    sized_within(3.2e-3, |edge| {
        let narrow = (step * radius).max(hole + 0.003);
        let knots = [
            rounded(hole, 0.0, 0.0006),
            rounded(radius, 0.0, 0.001),
            sharp(radius, 0.4 * height),
            sharp(narrow, 0.4 * height + 0.0008),
            rounded(narrow, height + 0.001, 0.0008),
            rounded(hole, height + 0.001, 0.0006),
        ];
        Ok(super::lathe::turned(&closed_line(&knots, edge), true, edge))
    })
}

fn wing_nut(draw: &mut Draw) -> TriangleMesh {
    let radius = draw.between("radius_m", 0.007, 0.011);
    let hole = radius * draw.between("hole", 0.45, 0.55);
    let half = draw.between("half_height_m", 0.005, 0.008);
    let reach = radius * draw.between("reach", 1.9, 2.6);
    let rise = radius * draw.between("rise", 0.6, 1.6);
    let wing = draw.between("wing_m", 0.0035, 0.005);
    let mut solid = Solid::new(0.0034);
    let still = glam::DQuat::IDENTITY;
    solid.put(
        Form::Drum([1.1 * radius, 0.9 * radius], half, 0.001),
        DVec3::ZERO,
        still,
        Role::Add(0.0),
    );
    for side in [-1.0, 1.0] {
        let tip = DVec3::new(side * reach, 0.0, rise);
        let half = DVec3::new(0.75 * radius, 0.55 * wing, 0.9 * radius);
        let turn = glam::DQuat::from_rotation_y(side * 0.4);
        solid.limb(
            [DVec3::X * (side * 0.8 * radius), tip],
            [0.7 * wing; 2],
            0.002,
        );
        solid.put(
            Form::Ellipsoid(half + DVec3::Y * 0.001),
            tip,
            turn,
            Role::Add(0.003),
        );
    }
    solid.put(
        Form::Drum([hole; 2], 2.0 * half, 0.0),
        DVec3::ZERO,
        still,
        Role::Cut(0.0),
    );
    solid.mesh()
}
