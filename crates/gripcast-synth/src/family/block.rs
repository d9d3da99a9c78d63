//! Toy blocks.

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec2};

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{Knot, closed_line, open_line, rounded};
use super::plate::{flat, upright};
use super::shape::sized;
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let forms = ["wedge", "arch", "prism", "cross", "star", "step", "column"];
    let form = draw.form(forms);
    if form == "column" {
        return column(draw);
    }
    let width = draw.between("width_m", 0.03, 0.1);
    let height = draw.between("height_m", 0.4, 0.9) * width;
    let depth = draw.between("depth_m", 0.015, 0.05);
    let fillet = draw.between("fillet_m", 0.0005, 0.0025);
    let knots: Vec<Knot> = outline(draw, form, width, height)
        .into_iter()
        .map(|p| rounded(p.x, p.y, fillet))
        .collect();
    sized(|edge| flat(closed_line(&knots, edge), Vec::new(), depth, edge).map(upright))
}

fn outline(draw: &mut Draw, form: &str, width: f64, height: f64) -> Vec<DVec2> {
    let half = 0.5 * width;
    let points = |list: &[(f64, f64)]| list.iter().map(|&(x, y)| DVec2::new(x, y)).collect();
    match form {
        "wedge" => {
            let top = draw.between("top_m", 0.1, 0.5) * width;
            points(&[
                (-half, 0.0),
                (half, 0.0),
                (top - half, height),
                (-half, height),
            ])
        }
        "arch" => {
            let radius = draw.between("opening", 0.5, 0.68) * half;
            let leg = (height - radius - 0.008).max(0.002);
            let mut line: Vec<DVec2> = points(&[
                (half, 0.0),
                (half, radius + leg + 0.006),
                (-half, radius + leg + 0.006),
                (-half, 0.0),
            ]);
            line.extend((0..=12).map(|k| {
                let turn = DVec2::from_angle(PI * (1.0 - f64::from(k) / 12.0));
                DVec2::new(0.0, leg) + radius * turn
            }));
            // The legs of the opening stand on the ground.
            line.insert(4, DVec2::new(-radius, 0.0));
            line.push(DVec2::new(radius, 0.0));
            line
        }
        "cross" => {
            let arm = draw.between("arm", 0.28, 0.45) * half;
            let h = 0.5 * height.max(0.75 * width);
            points(&[
                (-arm, -h),
                (arm, -h),
                (arm, -arm),
                (half, -arm),
                (half, arm),
                (arm, arm),
                (arm, h),
                (-arm, h),
                (-arm, arm),
                (-half, arm),
                (-half, -arm),
                (-arm, -arm),
            ])
        }
        "star" => {
            let count = draw.count("points", 4, 7);
            let inner = draw.between("inner", 0.45, 0.7);
            (0..2 * count)
                .map(|k| {
                    let radius = if k % 2 == 0 { half } else { inner * half };
                    let turn = TAU * (k as f64 / (2 * count) as f64 + 0.25);
                    radius * DVec2::from_angle(turn)
                })
                .collect()
        }
        "step" => {
            let steps = draw.count("steps", 2, 4);
            let mut line = vec![DVec2::new(-half, 0.0), DVec2::new(half, 0.0)];
            for k in 0..steps {
                let (x, y) = (k as f64 / steps as f64, (k + 1) as f64 / steps as f64);
                line.push(DVec2::new(half - x * width, y * height));
                if k + 1 < steps {
                    line.push(DVec2::new(half - width * y, y * height));
                }
            }
            line.push(DVec2::new(-half, height));
            line
        }
        _ => {
            let sides = draw.count("sides", 3, 8);
            let stretch = draw.between("stretch", 0.8, 1.2);
            let start = -0.25 - 0.5 / sides as f64;
            (0..sides)
                .map(|k| {
                    let turn = DVec2::from_angle(TAU * (start + k as f64 / sides as f64));
                    half * turn * DVec2::new(1.0, stretch)
                })
                .collect()
        }
    }
}

/// A prism that may be twisted and taper towards its top.
fn column(draw: &mut Draw) -> Result<TriangleMesh> {
    let section = Section::polygon(draw.count("sides", 3, 6));
    let radius = draw.between("radius_m", 0.01, 0.026);
    let height = draw.between("height_m", 0.03, 0.11);
    let top = radius * draw.between("top", 0.3, 1.0);
    let twist = draw.between("twist_rad", -1.2, 1.2) / height;
    let bevel = draw.between("bevel_m", 0.0006, 0.002);
    sized(|edge| {
        let knots = [
            rounded(0.0, 0.0, 0.0),
            rounded(radius, 0.0, bevel),
            rounded(top, height, bevel),
            rounded(0.0, height, 0.0),
        ];
        let profile = open_line(&knots, edge);
        let lathe = Lathe::prism(&profile, &section, edge);
        let mut mesh = lathe.mesh();
        for v in &mut mesh.vertices {
            *v = DQuat::from_rotation_z(twist * v.z) * *v;
        }
        Ok(mesh)
    })
}
