//! Pipes, caps, elbows, tees, squeeze tubes and rolls.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DQuat, DVec2, DVec3};

use super::draw::Draw;
use super::lathe::turned;
use super::outline::{closed_line, even, open_line, rounded, sharp};
use super::plate::{bent, flat, upright};
use super::shape::sized;
use super::solid::{Form, Role, Solid};
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form([
        "pipe",
        "cap",
        "elbow",
        "tee",
        "squeeze tube",
        "roll",
        "flanged pipe",
    ]);
    match form {
        "tee" => return Ok(tee(draw)),
        "roll" => return roll(draw),
        "squeeze tube" => return squeeze_tube(draw),
        _ => {}
    }
    let radius = draw.between("radius_m", 0.008, 0.032);
    let wall = draw.between("wall_m", 0.0026, 0.0045_f64.min(0.5 * radius));
    let length = draw.between("length_m", 0.025, 0.13);
    if form == "cap" {
        let deep = 0.6 * length.min(2.5 * radius);
        return sized(|edge| {
            let knots = [
                sharp(0.0, 0.0),
                rounded(radius, 0.0, 0.002),
                sharp(radius, deep),
                sharp(radius - wall, deep),
                rounded(radius - wall, 1.2 * wall, 0.001),
                sharp(0.0, 1.2 * wall),
            ];
            Ok(turned(&open_line(&knots, edge), false, edge))
        });
    }
    let collar = draw.between("collar_m", 0.002, 0.008);
    let collar_length = draw.between("collar_length_m", 0.004, 0.012);
    let turn = draw.between("bend_rad", 0.6, FRAC_PI_2);
    let bend = radius * draw.between("bend_radius", 1.5, 2.5);
    sized(|edge| {
        let mut knots = vec![sharp(radius - wall, 0.0), sharp(radius, 0.0)];
        if form == "flanged pipe" {
            knots[1] = sharp(radius + collar, 0.0);
            knots.push(sharp(radius + collar, collar_length));
            knots.push(rounded(radius, collar_length, 0.001));
        }
        knots.push(sharp(radius, length));
        knots.push(sharp(radius - wall, length));
        let mut mesh = turned(&closed_line(&knots, edge), true, edge);
        if form == "elbow" {
            let arc = bend * turn;
            let start = 0.5 * (length - arc).max(0.0);
            for v in &mut mesh.vertices {
                let along = bent(DVec3::new(v.z, v.y, v.x), start, bend, turn);
                *v = DVec3::new(along.z, along.y, along.x);
            }
            // The plane of the bend lies on the table.
            for v in &mut mesh.vertices {
                *v = DQuat::from_rotation_x(FRAC_PI_2) * *v;
            }
        }
        Ok(mesh)
    })
}

/// Two pipes in one.
fn tee(draw: &mut Draw) -> TriangleMesh {
    let radius = draw.between("radius_m", 0.009, 0.018);
    let wall = draw.between("wall_m", 0.0033, 0.0045);
    let half = draw.between("half_length_m", 0.02, 0.045);
    let branch = radius * draw.between("branch_radius", 0.7, 0.92);
    let arm = radius + draw.between("branch_m", 0.008, 0.025);
    let across = draw.chance("cross", 0.3);
    let mut solid = Solid::new(wall);
    let flat = DQuat::from_rotation_x(FRAC_PI_2);
    let run = DQuat::from_rotation_y(FRAC_PI_2);
    let (middle, reach) = if across {
        (0.0, arm)
    } else {
        (0.5 * arm, 0.5 * arm)
    };
    let at = DVec3::new(0.0, -middle, 0.0);
    for (role, less, more) in [(Role::Add(0.002), 0.0, 0.0), (Role::Cut(0.0), wall, 0.01)] {
        let main = radius - less;
        solid.put(
            Form::Drum([main; 2], half + more, 0.0),
            DVec3::ZERO,
            run,
            role,
        );
        let side = branch - less;
        let role = if less > 0.0 { Role::Cut(0.0) } else { role };
        let grown = if across { more } else { 0.5 * more };
        let at = at - DVec3::Y * if across { 0.0 } else { grown };
        solid.put(Form::Drum([side; 2], reach + grown, 0.0), at, flat, role);
    }
    solid.mesh()
}

/// A tube that a cap closes at one end and a weld at the other.
fn squeeze_tube(draw: &mut Draw) -> Result<TriangleMesh> {
    let radius = draw.between("radius_m", 0.011, 0.022);
    let length = draw.between("length_m", 0.06, 0.11);
    let cap = radius * draw.between("cap", 0.5, 0.95);
    let cap_length = draw.between("cap_length_m", 0.008, 0.02);
    let weld = draw.between("weld_m", 0.0016, 0.0026);
    sized(|edge| {
        let knots = [
            sharp(0.0, 0.0),
            rounded(cap, 0.0, 0.001),
            sharp(0.94 * cap, cap_length),
            rounded(radius, cap_length + 0.25 * radius, 0.003),
            sharp(radius, length),
            sharp(0.0, length),
        ];
        let mut mesh = turned(&open_line(&knots, edge), false, edge);
        let from = cap_length + 0.25 * radius;
        for v in &mut mesh.vertices {
            // The girth stays: what gets thinner gets wider.
            let share = ((v.z - from) / (length - from)).clamp(0.0, 1.0);
            let thin = 1.0 + (weld / radius - 1.0) * share;
            v.y *= thin;
            v.x *= 1.0 + 0.5 * share * share;
        }
        for v in &mut mesh.vertices {
            *v = DQuat::from_rotation_x(FRAC_PI_2) * *v;
        }
        Ok(mesh)
    })
}

/// A mat rolled up with air between its layers.
fn roll(draw: &mut Draw) -> Result<TriangleMesh> {
    let turns = draw.between("turns", 1.3, 2.4);
    let thick = draw.between("thickness_m", 0.0026, 0.004);
    let gap = draw.between("gap_m", 0.0016, 0.003);
    let inner = draw.between("inner_radius_m", 0.007, 0.012);
    let length = draw.between("length_m", 0.04, 0.12);
    let pitch = (thick + gap) / TAU;
    sized(|edge| {
        let spiral = |from: f64| -> Vec<DVec2> {
            let dense: Vec<DVec2> = (0..=600)
                .map(|k| {
                    let angle = TAU * turns * f64::from(k) / 600.0;
                    (from + pitch * angle) * DVec2::from_angle(angle)
                })
                .collect();
            even(&dense, edge)
        };
        let mut outline = spiral(inner + thick);
        let mut back = spiral(inner);
        back.reverse();
        outline.extend(back);
        Ok(upright(flat(outline, Vec::new(), length, edge)?))
    })
}
