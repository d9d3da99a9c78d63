//! Rings, bands, chain links, gaskets.

use std::f64::consts::TAU;

use glam::{DQuat, DVec2};

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{circle, closed_line, even, rounded};
use super::plate::flat;
use super::shape::sized;
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form([
        "torus",
        "band",
        "oval link",
        "wavy ring",
        "polygon ring",
        "signet ring",
        "gasket",
    ]);
    let radius = draw.between("radius_m", 0.014, 0.045);
    if form == "gasket" {
        return gasket(draw, radius);
    }
    let section = match form {
        "oval link" => Section::oblong(draw.between("aspect", 1.3, 1.6), 2.5),
        "wavy ring" => Section::lobes(draw.count("waves", 3, 8), draw.between("depth", 0.03, 0.09)),
        "polygon ring" => Section::polygon(draw.count("sides", 4, 8)),
        _ => Section::circle(),
    };
    let thick = draw.between("thickness_m", 0.004, 0.011).min(0.35 * radius);
    let height = match form {
        "band" | "signet ring" => draw.between("height_m", 0.008, 0.03),
        _ => thick * draw.between("height", 0.7, 1.4),
    };
    let fillet = draw.between("fillet", 0.05, 0.45) * thick.min(height);
    let half = 0.5 * height;
    let face = draw.between("face_m", 0.003, 0.007);
    let upright = form == "signet ring";
    sized(|edge| {
        // A fine profile: the hole is narrower than the outside.
        let profile: Vec<DVec2> = if form == "torus" || form == "oval link" {
            let about = DVec2::new(radius - 0.5 * thick, 0.0);
            circle(about, 0.5 * thick, edge)
        } else {
            let knots = [
                rounded(radius - thick, -half, fillet),
                rounded(radius, -half, fillet),
                rounded(radius, half, fillet),
                rounded(radius - thick, half, fillet),
            ];
            closed_line(&knots, edge)
        };
        let lathe = Lathe {
            profile: &profile,
            closed: true,
            section: &section,
            share: &|_| 1.0,
            edge,
        };
        let mut mesh = lathe.mesh();
        if upright {
            for v in &mut mesh.vertices {
                // A raised face on one side of the band.
                let out = v.truncate().length();
                let towards = (v.y / out).max(0.0).powi(4);
                let outside = ((out - radius + thick) / thick).clamp(0.0, 1.0);
                let wider = 1.0 + outside * towards * face / out;
                (v.x, v.y) = (v.x * wider, v.y * wider);
                *v = DQuat::from_rotation_x(0.25 * TAU) * *v;
            }
        }
        Ok(mesh)
    })
}

/// A flat ring with ears that bolts go through.
fn gasket(draw: &mut Draw, radius: f64) -> Result<TriangleMesh> {
    let ears = draw.count("ears", 2, 4);
    let inner = radius * draw.between("hole", 0.45, 0.6);
    let thick = draw.between("thickness_m", 0.003, 0.008);
    let bolt = draw.between("bolt_m", 0.0022, 0.004).min(0.13 * radius);
    let size = radius.min(0.06);
    sized(|edge| {
        let dense: Vec<DVec2> = (0..=180)
            .map(|k| {
                let angle = TAU * f64::from(k) / 180.0;
                let ear = (0.5 * ears as f64 * angle).cos().powi(6);
                size * (0.82 + 0.4 * ear) * DVec2::from_angle(angle)
            })
            .collect();
        let mut rim = even(&dense, edge);
        rim.pop();
        let mut holes = vec![circle(DVec2::ZERO, inner.min(0.62 * size), edge)];
        for k in 0..ears {
            let at = DVec2::from_angle(TAU * k as f64 / ears as f64) * (0.97 * size);
            holes.push(circle(at, bolt, edge));
        }
        flat(rim, holes, thick, edge)
    })
}
