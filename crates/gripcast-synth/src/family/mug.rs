//! Mugs, tea cups, tankards: a turned cup with a handle as one closed surface.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, TAU};
use std::ops::Range;

use glam::{DVec2, DVec3};

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{Knot, even, open_line, rounded, sharp};
use super::shape::with_edge;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::TriangleMesh;

/// Steps (columns, rows) around the block of 2 × 2 faces that an end of the handle replaces,
/// counter-clockwise seen from outside.
const AROUND: [(i64, i64); 8] = [
    (-1, -1),
    (0, -1),
    (1, -1),
    (1, 0),
    (1, 1),
    (0, 1),
    (-1, 1),
    (-1, 0),
];

struct Handle {
    /// Half width across the mug and half thickness, m.
    half: DVec2,
    /// Distance from the wall, m.
    reach: f64,
    /// Heights of its ends, m.
    ends: [f64; 2],
    /// Exponent of the superellipse: 2 is half an ellipse, more is closer to a rectangle.
    power: f64,
    /// How much the middle is lowered, m.
    drop: f64,
}

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form(&["mug", "tea cup", "tankard", "angular mug", "espresso cup"]);
    let radius = match form {
        "espresso cup" => draw.between(0.019, 0.026),
        "tea cup" => draw.between(0.028, 0.038),
        _ => draw.between(0.024, 0.036),
    };
    let tall = match form {
        "tea cup" => draw.between(1.25, 1.6),
        "tankard" => draw.between(2.6, 3.4),
        _ => draw.between(1.9, 2.6),
    };
    let height = (radius * tall).min(0.1);
    let knots = cup(draw, form, radius, height);
    let middle = height * draw.between(0.5, 0.58);
    let span = height * draw.between(0.24, 0.32);
    let handle = Handle {
        half: DVec2::new(draw.between(0.0034, 0.006), draw.between(0.0026, 0.0042)),
        reach: draw.between(0.016, 0.026),
        ends: [middle + span, middle - span],
        power: match form {
            "angular mug" => 5.0,
            _ => draw.between(1.9, 2.8),
        },
        drop: if form == "tea cup" { 0.15 * span } else { 0.0 },
    };
    with_edge(|edge| {
        let profile = open_line(&knots, edge);
        let columns = 4 * (0.25 * TAU * 0.93 * radius / edge).round().max(4.0) as usize;
        let lathe = Lathe {
            profile: &profile,
            closed: false,
            section: &Section::columns(columns),
            fraction: &|_| 0.0,
            edge,
        };
        let (mut mesh, rings) = lathe.mesh_and_rings();
        // The profile is on the outside up to the rim.
        let rim = profile.iter().position(|p| p.y > height - 0.004);
        let outside = &rings[..rim.unwrap_or(0)];
        handle.add_to(&mut mesh, &profile, outside, columns, edge)?;
        Ok(mesh.without_unused_vertices())
    })
}

/// Profile of the cup.
fn cup(draw: &mut Draw, form: &str, radius: f64, height: f64) -> Vec<Knot> {
    let wall = draw.between(0.0028, 0.0042);
    let floor = draw.between(0.0032, 0.006);
    let base = radius
        * match form {
            "tea cup" => draw.between(0.72, 0.85),
            "tankard" => draw.between(1.0, 1.14),
            _ => draw.between(0.85, 1.0),
        };
    let fillet = draw.between(0.001, 0.008);
    let belly = match form {
        "tea cup" => draw.between(0.06, 0.14),
        "mug" => draw.between(-0.06, 0.1),
        _ => 0.0,
    };
    let bulge = 0.5 * (base + radius) + belly * radius;
    vec![
        sharp(0.0, 0.0),
        rounded(base, 0.0, fillet),
        rounded(bulge, 0.45 * height, 0.4 * height),
        rounded(radius, height, 0.0009),
        rounded(radius - wall, height, 0.0009),
        rounded(bulge - wall, 0.45 * height, 0.4 * height),
        rounded(base - wall, floor, fillet + 0.001),
        sharp(0.0, floor),
    ]
}

impl Handle {
    /// Replaces two blocks of wall faces by the handle, towards +x.
    fn add_to(
        &self,
        mesh: &mut TriangleMesh,
        profile: &[DVec2],
        rings: &[Range<u32>],
        columns: usize,
        edge: f64,
    ) -> Result<()> {
        let rows = self.ends.map(|z| nearest_row(profile, rings, columns, z));
        let [Some(upper), Some(lower)] = rows else {
            return Err(Error::internal("no space for a handle"));
        };
        if upper < lower + 4 {
            return Err(Error::internal("the handle is too short"));
        }
        let vertex = |row: usize, (column, step): (i64, i64)| {
            let ring = &rings[(row as i64 + step) as usize];
            ring.start + column.rem_euclid(columns as i64) as u32
        };
        let mut loops = vec![AROUND.map(|step| vertex(upper, step))];
        let blocks = [upper, lower].map(|row| {
            let mut block = AROUND.map(|step| vertex(row, step)).to_vec();
            block.push(vertex(row, (0, 0)));
            block
        });
        let within = |t: &[u32; 3]| blocks.iter().any(|b| t.iter().all(|v| b.contains(v)));
        mesh.triangles.retain(|t| !within(t));
        let path = self.path(profile[upper], profile[lower], edge);
        for k in 1..path.len() - 1 {
            let along = (path[k + 1] - path[k - 1]).normalize_or_zero();
            loops.push(self.ring(mesh, path[k], along));
        }
        // Along the handle, the lower block is upside down.
        loops.push(AROUND.map(|(column, step)| vertex(lower, (column, -step))));
        for pair in loops.windows(2) {
            for k in 0..8 {
                let n = (k + 1) % 8;
                mesh.triangles.push([pair[0][k], pair[0][n], pair[1][n]]);
                mesh.triangles.push([pair[0][k], pair[1][n], pair[1][k]]);
            }
        }
        Ok(())
    }

    /// Centre line from the upper to the lower end in x and z, m.
    fn path(&self, upper: DVec2, lower: DVec2, edge: f64) -> Vec<DVec2> {
        let dense: Vec<DVec2> = (0..=200)
            .map(|k| {
                let (sin, cos) = (FRAC_PI_2 * (1.0 - f64::from(k) / 100.0)).sin_cos();
                let out = cos.max(0.0).powf(2.0 / self.power);
                let height = sin.signum() * sin.abs().powf(2.0 / self.power);
                let wall = lower.lerp(upper, 0.5 + 0.5 * height);
                wall + DVec2::new(self.reach * out, -self.drop * out)
            })
            .collect();
        even(&dense, edge)
    }

    /// Adds eight vertices around a point, normal to a direction.
    fn ring(&self, mesh: &mut TriangleMesh, center: DVec2, along: DVec2) -> [u32; 8] {
        let out = along.perp();
        std::array::from_fn(|k| {
            let (sin, cos) = (FRAC_PI_4 * (k as f64 - 3.0)).sin_cos();
            let p = center + out * (sin * self.half.y);
            let v = DVec3::new(p.x, cos * self.half.x, p.y);
            mesh.vertices.push(v);
            mesh.vertices.len() as u32 - 1
        })
    }
}

/// Finds the row nearest to a height whose neighbours have the same number of vertices.
fn nearest_row(
    profile: &[DVec2],
    rings: &[Range<u32>],
    columns: usize,
    height: f64,
) -> Option<usize> {
    let is_complete = |row: usize| rings[row].len() == columns && profile[row].y > 0.004;
    (1..rings.len().saturating_sub(1))
        .filter(|&row| is_complete(row - 1) && is_complete(row) && is_complete(row + 1))
        .min_by(|&a, &b| {
            let distance = |row: usize| (profile[row].y - height).abs();
            distance(a).total_cmp(&distance(b))
        })
}
