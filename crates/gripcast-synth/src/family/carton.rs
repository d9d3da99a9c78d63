//! Boxes with bevelled or rounded edges, books, gabled cartons.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_4;

use glam::DVec3;

use super::draw::Draw;
use super::outline::{closed_line, rounded};
use super::plate::{flat, upright};
use super::shape::sized;
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

/// Surface of the largest box, m².
const MAX_AREA_M2: f64 = 0.048;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form(["carton", "soap", "book", "tapered box", "gabled carton"]);
    match form {
        "gabled carton" => gabled(draw),
        "soap" => {
            let size = DVec3::new(
                draw.between("length_m", 0.05, 0.1),
                draw.between("width_m", 0.032, 0.06),
                draw.between("height_m", 0.018, 0.035),
            );
            let fillet = draw.between("fillet_m", 0.25, 0.48) * size.z;
            let crown = draw.between("crown", 0.0, 0.25);
            sized(|edge| {
                let mut mesh = rounded_box(size, fillet, edge);
                for v in &mut mesh.vertices {
                    let out = (2.0 * v.truncate() / size.truncate()).length_squared();
                    v.z *= 1.0 + crown * (1.0 - 0.5 * out);
                }
                Ok(mesh)
            })
        }
        "book" => book(draw),
        _ => {
            let length = draw.between("length_m", 0.03, 0.145);
            let width = draw.between("width_m", 0.02, 0.078_f64.min(length));
            let height = draw.between("height_m", 0.015, 0.12_f64.min(2.5 * width));
            // Not more surface than the triangles suffice for.
            let height = height.min((0.5 * MAX_AREA_M2 - length * width) / (length + width));
            let bevel = draw.between("bevel_m", 0.0007, 0.0025);
            let taper = if form == "tapered box" {
                draw.between("taper", 0.08, 0.4)
            } else {
                0.0
            };
            sized(|edge| {
                let mut mesh = rounded_box(DVec3::new(length, width, height), bevel, edge);
                for v in &mut mesh.vertices {
                    let narrow = 1.0 - taper * (0.5 + v.z / height);
                    (v.x, v.y) = (v.x * narrow, v.y * narrow);
                }
                Ok(mesh)
            })
        }
    }
}

/// A drink carton: its side view is a house.
fn gabled(draw: &mut Draw) -> Result<TriangleMesh> {
    let width = draw.between("width_m", 0.035, 0.07);
    let depth = draw.between("depth_m", 0.035, 0.07);
    let wall = draw.between("wall_height_m", 0.05, 0.095);
    let roof = draw.between("roof_height_m", 0.3, 0.5) * width;
    let fin = draw.between("fin_height_m", 0.006, 0.012);
    let half = 0.5 * width;
    sized(|edge| {
        let line = [
            rounded(-half, 0.0, 0.0015),
            rounded(half, 0.0, 0.0015),
            rounded(half, wall, 0.001),
            rounded(0.002, wall + roof, 0.0),
            rounded(0.002, wall + roof + fin, 0.0),
            rounded(-0.002, wall + roof + fin, 0.0),
            rounded(-0.002, wall + roof, 0.0),
            rounded(-half, wall, 0.001),
        ];
        flat(closed_line(&line, edge), Vec::new(), depth, edge).map(upright)
    })
}

/// A book that lies: its pages lie back behind the covers on the side away from the spine.
fn book(draw: &mut Draw) -> Result<TriangleMesh> {
    let height = draw.between("height_m", 0.07, 0.14);
    let width = draw.between("aspect", 0.55, 0.8) * height;
    let thick = draw.between("thickness_m", 0.008, 0.035);
    let cover = draw.between("cover_m", 0.002, 0.003);
    let overhang = draw.between("overhang_m", 0.002, 0.004);
    let spine = draw.between("spine_fillet_m", 0.001, 0.48 * thick);
    sized(|edge| {
        let pages = width - overhang;
        let line = [
            rounded(0.0, 0.0, spine),
            rounded(width, 0.0, 0.0),
            rounded(width, cover, 0.0),
            rounded(pages, cover, 0.0),
            rounded(pages, thick - cover, 0.0),
            rounded(width, thick - cover, 0.0),
            rounded(width, thick, 0.0),
            rounded(0.0, thick, spine),
        ];
        flat(closed_line(&line, edge), Vec::new(), height, edge).map(upright)
    })
}

/// A box of the given size (m) with rounded edges.
pub(super) fn rounded_box(size: DVec3, fillet: f64, edge: f64) -> TriangleMesh {
    let fillet = fillet.min(0.49 * size.min_element());
    let steps = size.to_array().map(|length| steps(length, fillet, edge));
    let mut mesh = grid(&steps);
    let core = 0.5 * size - fillet;
    for v in &mut mesh.vertices {
        let within = v.clamp(-core, core);
        let off = *v - within;
        *v = within + fillet * off / off.length().max(1e-12);
    }
    mesh
}

/// Coordinates of the grid along an axis: close in the fillets, where they grow like a tangent,
/// so that rounding leaves equal steps.
fn steps(length: f64, fillet: f64, edge: f64) -> Vec<f64> {
    let core = 0.5 * length - fillet;
    let bends = (FRAC_PI_4 * fillet / edge).round().max(1.0);
    let pieces = (2.0 * core / edge - 0.05).ceil().max(1.0);
    let bend = |k: f64| core + fillet * (FRAC_PI_4 * k / bends).tan();
    let mut steps: Vec<f64> = (1..=bends as usize).map(|k| -bend(k as f64)).collect();
    steps.reverse();
    steps.extend((0..=pieces as usize).map(|k| core * (2.0 * k as f64 / pieces - 1.0)));
    steps.extend((1..=bends as usize).map(|k| bend(k as f64)));
    steps
}

/// Surface of a box with vertices at the given coordinates.
fn grid(steps: &[Vec<f64>; 3]) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let mut known = BTreeMap::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let last = [axis, u, v].map(|k| steps[k].len() - 1);
        for end in [0, last[0]] {
            for i in 0..last[1] {
                for j in 0..last[2] {
                    let corner = |(di, dj): (usize, usize)| {
                        let mut at = [0; 3];
                        (at[axis], at[u], at[v]) = (end, i + di, j + dj);
                        *known.entry(at).or_insert_with(|| {
                            let part = |k: usize| steps[k][at[k]];
                            mesh.vertices.push(DVec3::new(part(0), part(1), part(2)));
                            mesh.vertices.len() as u32 - 1
                        })
                    };
                    let mut quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(corner);
                    if end == 0 {
                        quad.reverse();
                    }
                    // Diagonals run towards the corners of the box, or its rounding is lopsided.
                    if (2 * i + 1 < last[1]) == (2 * j + 1 < last[2]) {
                        quad.rotate_left(1);
                    }
                    let [a, b, c, d] = quad;
                    mesh.triangles.push([a, b, c]);
                    mesh.triangles.push([a, c, d]);
                }
            }
        }
    }
    mesh
}
