//! Motion of the skin of a gel of which only the depth is known.
//!
//! A layer of thickness H on a rigid back whose displacement grows linearly from the back to the
//! face: (z/H) u in the plane and −(z/H) w across it, with the depth w of the face. Its elastic
//! energy (Lamé's λ and G) is stationary in u for
//!
//! u − ℓ²∇²u = −a ∇w + (H/G) τ, a = H (λ/G − 1)/2, ℓ² = H² (λ + 2G)/(3G),
//!
//! with the traction τ of the contact on the face (one length ℓ for dilation and shear of the
//! plane), and at the free rim, across it, ∂u/∂n = 3λ/(2λ + 4G) w/H. The skin is squeezed away from the contact where the gel resists compression more than
//! shear (λ > G), and dragged along by the tangential force. The force is spread as the depth of the
//! object is, the torque as a rotation about the middle of the contact. The depth is that of the
//! membrane that the image shows, coarsened.

use crate::{PressDepth, SensorGeometry};

/// Cell of the grid, m.
const CELL_M: f64 = 1e-3;
/// Sweeps of the solution: the rest is then below 0.1 %.
const SWEEPS: usize = 60;

/// Elastic layer: thickness m, Young's modulus Pa and Poisson's ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ElasticLayer {
    pub(crate) thickness_m: f64,
    pub(crate) young_pa: f64,
    pub(crate) poisson: f64,
    /// Length and width of the pad along the columns and rows of the image, m.
    pub(crate) size_m: [f64; 2],
}

impl ElasticLayer {
    fn shear_pa(&self) -> f64 {
        0.5 * self.young_pa / (1.0 + self.poisson)
    }

    /// λ/G.
    fn lame_ratio(&self) -> f64 {
        2.0 * self.poisson / (1.0 - 2.0 * self.poisson)
    }
}

/// Tangential load of a contact on the gel, in the sensor frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactLoad {
    /// Force along the columns and rows, N.
    pub force_n: [f64; 2],
    /// Torque about the z axis through the pad's centre, from x towards y, N m.
    pub torque_n_m: f64,
}

/// Motion of the skin on a grid of cells.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerMotion {
    columns: usize,
    rows: usize,
    /// Displacement of each cell, m, row-major.
    displacement_m: Vec<[f64; 2]>,
}

/// Depth on the cells of the pad.
struct Cells {
    columns: usize,
    rows: usize,
    values: Vec<f64>,
}

impl LayerMotion {
    /// Solves for a press: the depth of the face (`face_m`, m) and of the object on the image's
    /// grid, and the tangential load. Without depth there is no motion.
    pub(crate) fn new(
        face_m: &[f32],
        object: &PressDepth,
        layer: &ElasticLayer,
        load: &ContactLoad,
    ) -> Self {
        let face = Cells::averaged(face_m, &object.geometry, layer.size_m);
        let (columns, rows) = (face.columns, face.rows);
        let still = vec![[0.0; 2]; columns * rows];
        if face.values.iter().all(|w| *w == 0.0) {
            return Self {
                columns,
                rows,
                displacement_m: still,
            };
        }
        let contact = Cells::averaged(&object.depth_m, &object.geometry, layer.size_m);
        let ratio = layer.lame_ratio();
        let squeeze_m = 0.5 * layer.thickness_m * (ratio - 1.0);
        let compliance = layer.thickness_m / layer.shear_pa();
        let traction = contact.traction(load);
        let mut source: Vec<[f64; 2]> = (0..columns * rows)
            .map(|cell| {
                let slope = face.slope(cell % columns, cell / columns);
                [0, 1].map(|axis| compliance * traction[cell][axis] - squeeze_m * slope[axis])
            })
            .collect();
        let length = layer.thickness_m * ((ratio + 2.0) / 3.0).sqrt() / CELL_M;
        // Free rim: beyond it, the displacement goes on as it would without stress.
        let stretch = 1.5 * ratio / (ratio + 2.0) / layer.thickness_m;
        for (cell, source) in source.iter_mut().enumerate() {
            let (column, row) = (cell % columns, cell / columns);
            let beyond_m = CELL_M * stretch * face.values[cell];
            for (axis, index, last) in [(0, column, columns - 1), (1, row, rows - 1)] {
                let outward = f64::from(i8::from(index == last) - i8::from(index == 0));
                source[axis] += length * length * outward * beyond_m;
            }
        }
        let mut motion = Self {
            columns,
            rows,
            displacement_m: still,
        };
        motion.relax(&source, length * length);
        motion
    }

    /// Displacement of the point of the skin that rests at a point of the sensor frame, m.
    #[must_use]
    pub fn displacement_m(&self, at_m: [f64; 2]) -> [f64; 2] {
        let cell = |c: f64, count: usize| {
            let c = (c / CELL_M + 0.5 * (count as f64 - 1.0)).clamp(0.0, count as f64 - 1.0);
            let before = (c as usize).min(count.saturating_sub(2));
            (before, (before + 1).min(count - 1), c - before as f64)
        };
        let (left, right, x) = cell(at_m[0], self.columns);
        let (above, below, y) = cell(at_m[1], self.rows);
        let at = |row: usize, column: usize| self.displacement_m[row * self.columns + column];
        [0, 1].map(|axis| {
            let upper = at(above, left)[axis] * (1.0 - x) + at(above, right)[axis] * x;
            let lower = at(below, left)[axis] * (1.0 - x) + at(below, right)[axis] * x;
            upper * (1.0 - y) + lower * y
        })
    }

    /// Solves u − L²∇²u = source by successive over-relaxation, L in cells. The gradient across the
    /// rim is in the source.
    fn relax(&mut self, source: &[[f64; 2]], length_square: f64) {
        let (columns, rows) = (self.columns, self.rows);
        // The means are equal, and relaxation is slowest there.
        let mean = [0, 1]
            .map(|axis| source.iter().map(|s| s[axis]).sum::<f64>() / source.len().max(1) as f64);
        self.displacement_m.fill(mean);
        let weight = 1.0 / (1.0 + 4.0 * length_square);
        // Optimal for the constant displacement, which one Jacobi sweep damps least.
        let damping = 4.0 * length_square * weight;
        let omega = 2.0 / (1.0 + (1.0 - damping * damping).sqrt());
        for sweep in 0..2 * SWEEPS {
            for row in 0..rows {
                for column in ((row + sweep) % 2..columns).step_by(2) {
                    let here = row * columns + column;
                    let neighbours = [
                        row * columns + column.saturating_sub(1),
                        row * columns + (column + 1).min(columns - 1),
                        row.saturating_sub(1) * columns + column,
                        (row + 1).min(rows - 1) * columns + column,
                    ];
                    for (axis, source) in source[here].iter().enumerate() {
                        let sum: f64 = neighbours
                            .iter()
                            .map(|n| self.displacement_m[*n][axis])
                            .sum();
                        let old = self.displacement_m[here][axis];
                        let new = weight * (source + length_square * sum);
                        self.displacement_m[here][axis] = old + omega * (new - old);
                    }
                }
            }
        }
    }
}

impl Cells {
    /// Means of an image over the cells of the pad; beyond the image its rim holds.
    fn averaged(values: &[f32], geometry: &SensorGeometry, size_m: [f64; 2]) -> Self {
        let [columns, rows] = size_m.map(|m| ((m / CELL_M).round() as usize).max(2));
        let per_cell = CELL_M / geometry.pixel_m;
        let span = |cell: usize, count: usize, pixels: usize| {
            let start = (cell as f64 - 0.5 * count as f64) * per_cell + 0.5 * pixels as f64;
            let first = start.round().clamp(0.0, pixels as f64 - 1.0) as usize;
            let end = (start + per_cell).round().clamp(0.0, pixels as f64) as usize;
            first..end.max(first + 1)
        };
        let mut means = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            let down = span(row, rows, geometry.height);
            for column in 0..columns {
                let across = span(column, columns, geometry.width);
                let count = down.len() * across.len();
                let sum: f64 = down
                    .clone()
                    .flat_map(|y| &values[y * geometry.width..][across.clone()])
                    .map(|v| f64::from(*v))
                    .sum();
                means.push(sum / count as f64);
            }
        }
        Self {
            columns,
            rows,
            values: means,
        }
    }

    /// Central differences, per metre.
    fn slope(&self, column: usize, row: usize) -> [f64; 2] {
        let at = |column: usize, row: usize| self.values[row * self.columns + column];
        let (left, right) = (column.saturating_sub(1), (column + 1).min(self.columns - 1));
        let (above, below) = (row.saturating_sub(1), (row + 1).min(self.rows - 1));
        [
            (at(right, row) - at(left, row)) / (CELL_M * (right - left) as f64),
            (at(column, below) - at(column, above)) / (CELL_M * (below - above) as f64),
        ]
    }

    /// Traction of a load on each cell, Pa: as the depth of the object, and as a rotation about the
    /// middle of the contact.
    fn traction(&self, load: &ContactLoad) -> Vec<[f64; 2]> {
        let place = |cell: usize| {
            let along = |i: usize, n: usize| (i as f64 - 0.5 * (n as f64 - 1.0)) * CELL_M;
            [
                along(cell % self.columns, self.columns),
                along(cell / self.columns, self.rows),
            ]
        };
        let area = CELL_M * CELL_M;
        let sum: f64 = area * self.values.iter().sum::<f64>();
        let [fx, fy] = load.force_n;
        if sum <= 0.0 || (fx == 0.0 && fy == 0.0 && load.torque_n_m == 0.0) {
            return vec![[0.0; 2]; self.values.len()];
        }
        let weighted = |of: &dyn Fn([f64; 2]) -> f64| -> f64 {
            let values = self.values.iter().enumerate();
            area * values.map(|(cell, w)| w * of(place(cell))).sum::<f64>() / sum
        };
        let middle = [weighted(&|p| p[0]), weighted(&|p| p[1])];
        let spread = weighted(&|p| (p[0] - middle[0]).powi(2) + (p[1] - middle[1]).powi(2));
        let remaining = load.torque_n_m - (middle[0] * fy - middle[1] * fx);
        let turn = remaining / spread.max(CELL_M * CELL_M);
        let values = self.values.iter().enumerate();
        values
            .map(|(cell, w)| {
                let [x, y] = place(cell);
                let share = w / sum;
                [
                    share * (fx - turn * (y - middle[1])),
                    share * (fy + turn * (x - middle[0])),
                ]
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GEOMETRY: SensorGeometry = SensorGeometry {
        width: 320,
        height: 240,
        pixel_m: 7e-5,
        gel_thickness_m: 4e-3,
    };
    const LAYER: ElasticLayer = ElasticLayer {
        thickness_m: 4e-3,
        young_pa: 4e5,
        poisson: 0.45,
        size_m: [0.025, 0.020],
    };

    fn motion(depth_m: impl Fn(f64, f64) -> f64, load: ContactLoad) -> LayerMotion {
        let mut press = PressDepth::untouched(GEOMETRY);
        for (pixel, depth) in press.depth_m.iter_mut().enumerate() {
            let [x, y] = GEOMETRY.pixel_to_gel_m((pixel % 320) as f64, (pixel / 320) as f64);
            *depth = depth_m(x, y).max(0.0) as f32;
        }
        LayerMotion::new(&press.depth_m.clone(), &press, &LAYER, &load)
    }

    fn ball(x: f64, y: f64) -> f64 {
        6e-4 - 40.0 * (x * x + y * y)
    }

    #[test]
    fn untouched_gel_is_still() {
        let force_n = [1.0, 0.0];
        let load = ContactLoad {
            force_n,
            ..ContactLoad::default()
        };
        let motion = motion(|_, _| 0.0, load);
        assert_eq!(motion.displacement_m([1e-3, 2e-3]), [0.0; 2]);
    }

    #[test]
    fn skin_is_squeezed_away_from_a_ball() {
        let motion = motion(ball, ContactLoad::default());
        let [right, left] = [4e-3, -4e-3].map(|x| motion.displacement_m([x, 0.0])[0]);
        assert!(right > 2e-5 && right < 5e-4, "{right}");
        assert!((right + left).abs() < 0.02 * right, "{right} {left}");
        let middle = motion.displacement_m([0.0, 0.0]);
        assert!(middle[0].abs() < 0.02 * right && middle[1].abs() < 0.02 * right);
    }

    #[test]
    fn plate_over_the_whole_pad_bulges_the_free_rim() {
        let motion = motion(|_, _| 1e-4, ContactLoad::default());
        let at = |x: f64| motion.displacement_m([x, 0.0])[0];
        let (inner, rim) = (at(6e-3), at(12e-3));
        assert!(
            inner > 0.0 && rim > 2.0 * inner && rim < 3e-4,
            "{inner} {rim}"
        );
    }

    #[test]
    fn plate_under_force_shears_the_layer_as_a_block() {
        let load = ContactLoad {
            force_n: [0.0, 2.0],
            ..ContactLoad::default()
        };
        let free = motion(|_, _| 1e-4, ContactLoad::default());
        let dragged = motion(|_, _| 1e-4, load);
        let shear_pa = 0.5 * LAYER.young_pa / (1.0 + LAYER.poisson);
        let expected = 2.0 * LAYER.thickness_m / (shear_pa * 0.025 * 0.020);
        for at in [[0.0, 0.0], [5e-3, -3e-3]] {
            let moved = dragged.displacement_m(at)[1] - free.displacement_m(at)[1];
            assert!((moved / expected - 1.0).abs() < 0.01, "{moved} {expected}");
        }
    }

    #[test]
    fn torque_turns_the_skin_from_x_towards_y() {
        let load = ContactLoad {
            torque_n_m: 5e-3,
            ..ContactLoad::default()
        };
        let (free, turned) = (motion(ball, ContactLoad::default()), motion(ball, load));
        let by = |at| {
            let (a, b) = (turned.displacement_m(at), free.displacement_m(at));
            [a[0] - b[0], a[1] - b[1]]
        };
        assert!(by([2e-3, 0.0])[1] > 1e-6 && by([0.0, 2e-3])[0] < -1e-6);
        assert!(by([0.0, 0.0])[0].abs() < 1e-7);
    }
}
