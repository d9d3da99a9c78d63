//! Boxes with rounded edges.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_4;

use glam::DVec3;

use gripcast_geometry::TriangleMesh;

/// Returns a box of the given size (m) with rounded edges.
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

/// Grid coordinates along an axis, spaced like a tangent in the fillets so that rounding gives
/// equal steps.
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
    let mut vertices = BTreeMap::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let last = [axis, u, v].map(|k| steps[k].len() - 1);
        for end in [0, last[0]] {
            for i in 0..last[1] {
                for j in 0..last[2] {
                    let corner = |(di, dj): (usize, usize)| {
                        let mut at = [0; 3];
                        (at[axis], at[u], at[v]) = (end, i + di, j + dj);
                        *vertices.entry(at).or_insert_with(|| {
                            let vertex = [0, 1, 2].map(|k| steps[k][at[k]]);
                            mesh.vertices.push(DVec3::from_array(vertex));
                            mesh.vertices.len() as u32 - 1
                        })
                    };
                    let mut quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(corner);
                    if end == 0 {
                        quad.reverse();
                    }
                    // Diagonals towards the corners of the box keep the rounding symmetric.
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
