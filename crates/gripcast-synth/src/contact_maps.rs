//! Displacement of the gels' faces in view of the tactile images, from the record of a grasp.

use gripcast_shear::ContactMaps;
use gripcast_sim::fem::GelPad;
use gripcast_sim::grasp::GraspRecord;

/// Displacements are rounded to multiples of its inverse, m: a twentieth of the record's quantum.
const ROUNDING: f64 = 1e7;

/// Displacement of both faces before the lift at the centres of the cells of images that show
/// `view_m` (width and height) of the middle of a face. None without gels.
pub(super) fn contact_maps(
    record: &GraspRecord,
    pad: &GelPad,
    view_m: [f64; 2],
) -> Option<ContactMaps> {
    let state = record.states.first()?;
    let [rows, columns] = ContactMaps::CELLS;
    let mut values = Vec::with_capacity(ContactMaps::LEN);
    for face in &state.gels {
        let nodes = Nodes::new(record.face_nodes, pad, &face.displacement_m)?;
        for cell in 0..rows * columns {
            let at = |cell: usize, cells: usize, view_m: f64| {
                ((cell as f64 + 0.5) / cells as f64 - 0.5) * view_m
            };
            let x_m = at(cell % columns, columns, view_m[0]);
            let y_m = at(cell / columns, rows, view_m[1]);
            let [x, y, z] = nodes.displacement([x_m, y_m]);
            // The gel frame has z from the back to the face.
            let rounded = [x, y, -z].map(|value| (value * ROUNDING).round() / ROUNDING);
            values.extend(rounded);
        }
    }
    ContactMaps::new(values)
}

/// Displacements of the nodes of a face, equally spaced over it.
struct Nodes<'a> {
    count: [usize; 2],
    size_m: [f64; 2],
    displacement_m: &'a [[f64; 3]],
}

impl<'a> Nodes<'a> {
    fn new(count: [usize; 2], pad: &GelPad, displacement_m: &'a [[f64; 3]]) -> Option<Self> {
        let is_whole = count[0] * count[1] == displacement_m.len();
        (is_whole && count.iter().all(|count| *count >= 2)).then_some(Self {
            count,
            size_m: pad.size_m,
            displacement_m,
        })
    }

    /// Bilinear interpolation at a point of the face, from its middle; the nearest beyond the rim.
    fn displacement(&self, at_m: [f64; 2]) -> [f64; 3] {
        let [(i, s), (j, t)] = [0, 1].map(|axis| {
            let last = self.count[axis] - 1;
            let at = (at_m[axis] / self.size_m[axis] + 0.5) * last as f64;
            let node = at.clamp(0.0, (last - 1) as f64).floor();
            (node as usize, (at - node).clamp(0.0, 1.0))
        });
        let node = |i: usize, j: usize| self.displacement_m[j * self.count[0] + i];
        let corners = [
            ((1.0 - s) * (1.0 - t), node(i, j)),
            (s * (1.0 - t), node(i + 1, j)),
            ((1.0 - s) * t, node(i, j + 1)),
            (s * t, node(i + 1, j + 1)),
        ];
        [0, 1, 2].map(|axis| corners.iter().map(|(w, d)| w * d[axis]).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::Pose;
    use gripcast_sim::grasp::{GelForce, RecordedFace, RecordedState, StageName};

    fn state() -> RecordedState {
        RecordedState {
            stage: StageName::Lift,
            t_s: 0.0,
            lifted_m: 0.0,
            opening_m: 0.02,
            t_world_object: Pose::IDENTITY,
            force: [GelForce::default(); 2],
            min_gap_m: [None; 2],
            gels: Default::default(),
        }
    }

    #[test]
    fn linear_displacement_is_kept_at_the_cells() {
        let pad = GelPad::default();
        let [nx, ny] = [13, 11];
        let at = |i: usize, n: usize, size_m: f64| (i as f64 / (n - 1) as f64 - 0.5) * size_m;
        let face = |scale: f64| RecordedFace {
            displacement_m: (0..nx * ny)
                .map(|k| {
                    let x = at(k % nx, nx, pad.size_m[0]);
                    let y = at(k / nx, ny, pad.size_m[1]);
                    [scale * x, scale * y, -scale * (x + 2.0 * y)]
                })
                .collect(),
            ..RecordedFace::default()
        };
        let record = GraspRecord {
            t_world_gripper: Pose::IDENTITY,
            face_nodes: [nx, ny],
            states: vec![RecordedState {
                gels: [face(0.01), face(0.02)],
                ..state()
            }],
        };
        let maps = contact_maps(&record, &pad, [0.0186, 0.0143]).unwrap();
        for (gel, scale) in maps.gels().into_iter().zip([0.01, 0.02]) {
            for (cell, found) in gel.chunks(3).enumerate() {
                let x = ((cell % 10) as f64 - 4.5) / 10.0 * 0.0186;
                let y = ((cell / 10) as f64 - 3.5) / 8.0 * 0.0143;
                let expected = [x, y, x + 2.0 * y].map(|value| scale * value);
                for (found, expected) in found.iter().zip(expected) {
                    assert!(
                        (found - expected).abs() < 1e-7,
                        "{cell}: {found} {expected}"
                    );
                }
            }
        }
        let rigid = GraspRecord {
            face_nodes: [0, 0],
            states: vec![state()],
            ..record
        };
        assert_eq!(contact_maps(&rigid, &pad, [0.0186, 0.0143]), None);
    }
}
