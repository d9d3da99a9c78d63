//! Hand tools.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DQuat, DVec2, DVec3};

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{Knot, circle, closed_line, open_line, rounded, sharp};
use super::plate::{Plate, bent};
use super::shape::{eased, sized, sized_within};
use super::solid::{Form, Role, Solid};
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let forms = [
        "screwdriver",
        "hammer",
        "mallet",
        "wrench",
        "scraper",
        "clamp",
        "hexagon key",
        "awl",
    ];
    match draw.form(forms) {
        "hammer" => Ok(hammer(draw, false)),
        "mallet" => Ok(hammer(draw, true)),
        "wrench" => wrench(draw),
        "scraper" => scraper(draw),
        "clamp" => clamp(draw),
        "hexagon key" => hexagon_key(draw),
        form => screwdriver(draw, form == "awl"),
    }
}

/// A handle with flutes and a shaft, lying along x.
fn screwdriver(draw: &mut Draw, pointed: bool) -> Result<TriangleMesh> {
    let radius = draw.between("handle_radius_m", 0.0085, 0.016);
    let handle = draw.between("handle_m", 0.035, 0.07);
    let shaft = draw.between("shaft_m", 0.02, 0.075);
    let thin = draw.between("shaft_radius_m", 0.0022, 0.0042);
    let waist = draw.between("waist", 0.7, 0.95);
    let flutes = draw.count("flutes", 3, 8);
    let section = Section::lobes(flutes, draw.between("flute_depth", 0.0, 0.09));
    let blade = draw.between("blade", 1.0, 1.7);
    sized_within(2.8e-3, |edge| {
        let end = handle + shaft;
        let knots = [
            sharp(0.0, 0.0),
            rounded(0.9 * radius, 0.0, 0.35 * radius),
            rounded(radius, 0.3 * handle, 0.3 * handle),
            rounded(waist * radius, 0.75 * handle, 0.2 * handle),
            rounded(0.8 * radius, handle, 0.2 * radius),
            sharp(thin, handle + 0.001),
            sharp(thin, end - 0.012),
            sharp(if pointed { 0.0 } else { 0.9 * thin }, end),
            sharp(0.0, end),
        ];
        let knots = if pointed { &knots[..8] } else { &knots[..] };
        let profile = open_line(knots, edge);
        let lathe = Lathe {
            profile: &profile,
            closed: false,
            section: &section,
            share: &|at| {
                f64::from(at.y > 0.05 * handle && at.y < 0.9 * handle && at.x > 0.5 * radius)
            },
            edge,
        };
        let mut mesh = lathe.mesh();
        for v in &mut mesh.vertices {
            // The tip of a flat blade.
            let share = ((v.z - end + 0.012) / 0.012).clamp(0.0, 1.0);
            if !pointed {
                v.y *= 1.0 - 0.65 * share;
                v.x *= 1.0 + (blade - 1.0) * share;
            }
            *v = DVec3::new(v.z, v.x, v.y);
        }
        Ok(mesh)
    })
}

/// A head across a handle that lies along x.
fn hammer(draw: &mut Draw, mallet: bool) -> TriangleMesh {
    let length = draw.between("length_m", 0.085, 0.138);
    let grip = draw.between("grip_m", 0.0055, 0.0095);
    let flat = draw.between("grip_height", 0.75, 1.0);
    let wide = if mallet {
        draw.between("head_m", 0.028, 0.042)
    } else {
        draw.between("head_m", 0.024, 0.034)
    };
    let thick = if mallet {
        draw.between("head_radius_m", 0.011, 0.018)
    } else {
        draw.between("head_radius_m", 0.0065, 0.01)
    };
    let pein = draw.chance("pein", 0.5);
    let mut solid = Solid::new(2.0 * grip * flat);
    let along = DQuat::from_rotation_y(FRAC_PI_2);
    let end = length - thick;
    // The handle swells at its end.
    let middle = DVec3::X * (0.5 * end);
    solid.put(
        Form::Drum([grip, 0.75 * grip], 0.5 * end, 0.3 * grip),
        middle,
        along,
        Role::Add(0.0),
    );
    let knob = DVec3::new(0.28 * end, 0.0, 0.0);
    solid.ball(
        knob,
        DVec3::new(0.3 * end, 1.15 * grip, 1.1 * flat * grip),
        0.004,
    );
    let across = DQuat::from_rotation_x(FRAC_PI_2);
    let head = DVec3::X * end;
    if mallet {
        let form = Form::Drum([thick; 2], wide, 0.0025);
        solid.put(form, head, across, Role::Add(0.001));
        return solid.mesh();
    }
    let block = DVec3::new(0.95 * thick, 0.45 * wide, 0.95 * thick);
    solid.put(
        Form::Block(block, 0.0015),
        head,
        DQuat::IDENTITY,
        Role::Add(0.002),
    );
    let face = head - DVec3::Y * (0.75 * wide);
    solid.put(
        Form::Drum([1.15 * thick; 2], 0.25 * wide, 0.0015),
        face,
        across,
        Role::Add(0.003),
    );
    let back = head + DVec3::Y * (0.4 * wide);
    let tip = head + DVec3::Y * wide;
    if pein {
        solid.ball(back + DVec3::Y * (0.35 * wide), DVec3::splat(thick), 0.005);
    } else {
        for side in [-1.0, 1.0] {
            let spread = DVec3::new(-0.3 * thick, 0.25 * wide, side * 0.55 * thick);
            solid.limb([back, tip + spread], [0.8 * thick, 0.38 * thick], 0.002);
        }
    }
    solid.mesh()
}

/// A handle between an open jaw and a ring.
fn wrench(draw: &mut Draw) -> Result<TriangleMesh> {
    let length = draw.between("length_m", 0.07, 0.12);
    let jaw = draw.between("jaw_radius_m", 0.011, 0.0155);
    let ring = draw.between("ring_radius_m", 0.009, 0.0135);
    let grip = draw.between("grip_m", 0.004, 0.0065);
    let thick = draw.between("thickness_m", 0.0045, 0.008);
    let opening = jaw * draw.between("opening", 0.45, 0.55);
    let tilt = draw.between("tilt_rad", 0.0, 0.26);
    sized_within(2.8e-3, |edge| {
        let mut knots: Vec<Knot> = Vec::new();
        let turned = DVec2::from_angle(tilt);
        let at_jaw = DVec2::X * length;
        // Around the ring, then the jaw with its slot.
        for p in arc(DVec2::ZERO, ring, 0.45, 2.0 * PI - 0.45) {
            knots.push(rounded(p.x, p.y, 0.0));
        }
        knots.push(rounded(ring + 0.012, -grip, 0.01));
        let slot = (opening / jaw).asin();
        for p in arc(DVec2::ZERO, jaw, PI + 0.45 - tilt, 2.0 * PI - slot) {
            let p = at_jaw + turned.rotate(p);
            knots.push(rounded(p.x, p.y, 0.0));
        }
        for (x, y) in [(0.1, -1.0), (-0.15, -0.75), (-0.15, 0.75), (0.1, 1.0)] {
            let p = at_jaw + turned.rotate(DVec2::new(x * jaw, y * opening));
            knots.push(rounded(p.x, p.y, 0.0));
        }
        for p in arc(DVec2::ZERO, jaw, slot, PI - 0.45 - tilt) {
            let p = at_jaw + turned.rotate(p);
            knots.push(rounded(p.x, p.y, 0.0));
        }
        knots.push(rounded(ring + 0.012, grip, 0.01));
        let hole = circle(DVec2::ZERO, 0.58 * ring, edge);
        Plate {
            outline: closed_line(&knots, edge),
            holes: vec![hole],
            heights: &|p, depth| {
                let head = p.x < 1.2 * ring || p.x > length - 1.2 * jaw;
                let half = if head { 0.5 * thick } else { 0.36 * thick };
                let half = half - (0.0006 - 0.5 * depth).max(0.0);
                [-half, half]
            },
            edge,
        }
        .mesh()
    })
}

/// Corners along an arc, m and rad.
fn arc(center: DVec2, radius: f64, from: f64, to: f64) -> impl Iterator<Item = DVec2> {
    let pieces = (radius * (to - from) / 2.2e-3).ceil().max(2.0);
    (0..=pieces as usize).map(move |k| {
        let angle = from + (to - from) * k as f64 / pieces;
        center + radius * DVec2::from_angle(angle)
    })
}

/// A blade that gets thinner towards its edge, and a grip.
fn scraper(draw: &mut Draw) -> Result<TriangleMesh> {
    let blade = draw.between("blade_m", 0.02, 0.035);
    let reach = draw.between("reach_m", 0.03, 0.055);
    let grip = draw.between("grip_m", 0.008, 0.013);
    let length = draw.between("grip_length_m", 0.045, 0.08);
    let thick = draw.between("grip_thickness_m", 0.01, 0.018);
    let thin = draw.between("blade_thickness_m", 0.0018, 0.003);
    sized(|edge| {
        let knots = [
            rounded(-length, -grip, 0.006),
            rounded(-0.35 * length, -0.8 * grip, 0.03),
            rounded(0.0, -grip, 0.002),
            rounded(0.3 * reach, -0.7 * grip, 0.01),
            rounded(reach, -blade, 0.001),
            rounded(reach, blade, 0.001),
            rounded(0.3 * reach, 0.7 * grip, 0.01),
            rounded(0.0, grip, 0.002),
            rounded(-0.35 * length, 0.8 * grip, 0.03),
            rounded(-length, grip, 0.006),
        ];
        Plate {
            outline: closed_line(&knots, edge),
            holes: Vec::new(),
            heights: &|p, depth| {
                let crown = 1.0 - (1.0 - depth / (0.6 * grip)).max(0.0).powi(2);
                let half = 0.5 * thick * (0.55 + 0.45 * crown);
                let half = half + (0.5 * thin - half) * eased(p.x / 0.014 + 0.6);
                [-half, half]
            },
            edge,
        }
        .mesh()
    })
}

/// A C-shaped frame.
fn clamp(draw: &mut Draw) -> Result<TriangleMesh> {
    let wide = draw.between("width_m", 0.03, 0.06);
    let tall = draw.between("height_m", 0.04, 0.09);
    let bar = draw.between("bar_m", 0.006, 0.011);
    let thick = draw.between("thickness_m", 0.006, 0.014);
    let pad = draw.between("pad_m", 0.0, 0.012);
    let fillet = draw.between("fillet_m", 0.002, 0.012);
    let inner = (fillet - 0.7 * bar).max(0.001);
    sized(|edge| {
        let knots = [
            rounded(0.0, 0.0, fillet),
            rounded(wide, 0.0, 0.001),
            rounded(wide, bar + pad, 0.001),
            rounded(wide - 0.009, bar + pad, 0.001),
            rounded(wide - 0.009, bar, 0.0),
            rounded(bar, bar, inner),
            rounded(bar, tall - bar, inner),
            rounded(wide - 0.009, tall - bar, 0.0),
            rounded(wide - 0.009, tall - bar - 0.4 * pad, 0.001),
            rounded(wide, tall - bar - 0.4 * pad, 0.001),
            rounded(wide, tall, 0.001),
            rounded(0.0, tall, fillet),
        ];
        // A pad too low to be one is left out.
        let knots: Vec<Knot> = if pad < 0.004 {
            [0, 1, 2, 5, 6, 9, 10, 11]
                .map(|k: usize| match k {
                    2 => rounded(wide, bar, 0.001),
                    9 => rounded(wide, tall - bar, 0.001),
                    _ => knots[k],
                })
                .to_vec()
        } else {
            knots.to_vec()
        };
        super::plate::flat(closed_line(&knots, edge), Vec::new(), thick, edge)
    })
}

/// A bent hexagonal rod.
fn hexagon_key(draw: &mut Draw) -> Result<TriangleMesh> {
    let radius = draw.between("radius_m", 0.003, 0.0055);
    let long = draw.between("long_m", 0.05, 0.11);
    let short = draw.between("short_m", 0.018, 0.035);
    let bend = radius * draw.between("bend_radius", 2.0, 3.0);
    sized_within(3.0e-3, |edge| {
        let length = long + short + FRAC_PI_2 * bend;
        let knots = [
            sharp(0.0, 0.0),
            rounded(radius, 0.0, 0.0006),
            rounded(radius, length, 0.0006),
            sharp(0.0, length),
        ];
        let profile = open_line(&knots, edge);
        let lathe = Lathe {
            profile: &profile,
            closed: false,
            section: &Section::polygon(6),
            share: &|_| 1.0,
            edge,
        };
        let mut mesh = lathe.mesh();
        for v in &mut mesh.vertices {
            let p = bent(DVec3::new(v.z, v.x, v.y), long, bend, FRAC_PI_2);
            *v = DVec3::new(p.x, -p.z, p.y);
        }
        Ok(mesh)
    })
}
