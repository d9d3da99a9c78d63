//! Knobs that are turned or pulled.

use std::f64::consts::TAU;

use glam::{DQuat, DVec2, DVec3};

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{open_line, rounded, sharp};
use super::shape::sized_within;
use super::solid::{Form, Role, Solid};
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form([
        "fluted",
        "mushroom",
        "star handle",
        "door knob",
        "pointer",
        "chess piece",
    ]);
    match form {
        "star handle" => Ok(star_handle(draw)),
        "pointer" => Ok(pointer(draw)),
        _ => turned_knob(draw, form),
    }
}

fn turned_knob(draw: &mut Draw, form: &str) -> Result<TriangleMesh> {
    let radius = draw.between("radius_m", 0.012, 0.03);
    let lobes = draw.count("lobes", 6, 14);
    let section = if form == "fluted" {
        Section::lobes(lobes, draw.between("depth", 0.03, 0.08))
    } else {
        Section::circle()
    };
    let tall = draw.between("height", 0.7, 1.4) * radius;
    let neck = radius * draw.between("neck", 0.35, 0.55);
    let stem = radius * draw.between("stem", 0.4, 0.9);
    let foot = radius * draw.between("foot", 0.55, 0.95);
    let high = draw.between("foot_m", 0.003, 0.006);
    let fillet = radius * draw.between("fillet", 0.1, 0.45);
    sized_within(3.2e-3, |edge| {
        let mut knots = vec![sharp(0.0, 0.0)];
        match form {
            "fluted" => {
                knots.push(rounded(radius, 0.0, 0.001));
                knots.push(rounded(0.92 * radius, tall, 0.4 * fillet));
                knots.push(sharp(0.0, tall));
            }
            "chess piece" => {
                let slim = 0.55 * neck;
                let body = 2.2 * radius;
                knots.push(rounded(0.75 * radius, 0.0, 0.001));
                knots.push(rounded(0.75 * radius, high, 0.001));
                knots.push(rounded(0.9 * slim + 0.002, high + 0.5 * body, body));
                knots.push(sharp(slim + 0.001, body));
                knots.push(rounded(0.55 * radius, body + 0.001, 0.0008));
                knots.push(rounded(0.55 * radius, body + 0.004, 0.0008));
                knots.push(sharp(slim + 0.001, body + 0.0045));
                let head = 0.5 * radius;
                knots.push(rounded(head, body + 0.0045 + 0.5 * head, 0.7 * head));
                knots.push(rounded(0.9 * head, body + 0.0045 + 1.8 * head, 0.8 * head));
                knots.push(sharp(0.0, body + 0.0045 + 1.8 * head));
            }
            _ => {
                knots.push(rounded(foot, 0.0, 0.001));
                knots.push(rounded(foot, high, 0.001));
                knots.push(rounded(neck, high, 0.002));
                let under = high + stem;
                knots.push(rounded(neck, under, 0.4 * neck));
                if form == "mushroom" {
                    knots.push(rounded(radius, under + 0.1 * tall, 0.15 * tall));
                } else {
                    knots.push(rounded(radius, under + 0.25 * tall, 0.3 * tall));
                }
                knots.push(rounded(0.85 * radius, under + tall, fillet.max(0.3 * tall)));
                knots.push(sharp(0.0, under + tall));
            }
        }
        let profile = open_line(&knots, edge);
        let lathe = Lathe {
            profile: &profile,
            closed: false,
            section: &section,
            share: &|at| f64::from(at.x > 0.6 * radius),
            edge,
        };
        Ok(lathe.mesh())
    })
}

/// A hub with round arms.
fn star_handle(draw: &mut Draw) -> TriangleMesh {
    let arms = draw.count("arms", 3, 7);
    let radius = draw.between("radius_m", 0.016, 0.032);
    let arm = draw
        .between("arm_m", 0.005, 0.009)
        .min(2.2 * radius / arms as f64);
    let hub = draw.between("hub", 0.5, 0.7) * radius;
    let half = draw.between("half_height_m", 0.005, 0.009);
    let stem = draw.between("stem_m", 0.004, 0.016);
    let mut solid = Solid::new(0.008);
    let drum = Form::Drum([hub; 2], half, 0.002);
    solid.put(drum, DVec3::ZERO, DQuat::IDENTITY, Role::Add(0.0));
    for k in 0..arms {
        let towards = DVec2::from_angle(TAU * k as f64 / arms as f64);
        let end = (radius * towards).extend(0.0);
        let form = Form::Drum([arm; 2], 0.9 * half, 0.0025);
        solid.put(form, end, DQuat::IDENTITY, Role::Add(0.004));
        solid.limb([DVec3::ZERO, end], [0.8 * arm.min(half); 2], 0.003);
    }
    let under = DVec3::NEG_Z * (half + 0.5 * stem - 0.001);
    let form = Form::Drum([0.6 * hub; 2], 0.5 * stem + 0.001, 0.0005);
    solid.put(form, under, DQuat::IDENTITY, Role::Add(0.001));
    solid.mesh()
}

/// A round base with a grip across it.
fn pointer(draw: &mut Draw) -> TriangleMesh {
    let radius = draw.between("radius_m", 0.012, 0.024);
    let base = draw.between("base_m", 0.004, 0.008);
    let grip = draw.between("grip_m", 0.003, 0.0055);
    let high = draw.between("grip_height_m", 0.01, 0.02);
    let reach = radius * draw.between("reach", 0.9, 1.5);
    let tilt = draw.between("tilt_rad", 0.0, 0.2);
    let mut solid = Solid::new(2.0 * grip);
    let drum = Form::Drum([radius, 0.93 * radius], 0.5 * base, 0.0018);
    solid.put(drum, DVec3::ZERO, DQuat::IDENTITY, Role::Add(0.0));
    let middle = DVec3::new(0.5 * (reach - 0.85 * radius), 0.0, 0.5 * high);
    let half = DVec3::new(0.5 * (reach + 0.85 * radius), grip, 0.5 * high);
    let turn = DQuat::from_rotation_y(tilt);
    solid.put(Form::Block(half, 0.0012), middle, turn, Role::Add(0.0015));
    solid.mesh()
}
