//! Motion of the skin from the face nodes of a simulated gel.

use gripcast_base::error::{Error, Result};
use gripcast_sim::fem::GelGrid;
use gripcast_sim::fields::FaceField;

use crate::scene::MountingAngle;

/// Displacement of the face nodes of a gel, interpolated by cubic Hermite splines along both axes,
/// so that the stretch is continuous. Beyond the face, the displacement of its rim holds.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeMotion {
    /// Node coordinates at rest along x and y of the gel frame, m.
    axes_m: [Vec<f64>; 2],
    /// Displacements in the gel frame, m; x fastest.
    displacement_m: Vec<[f64; 2]>,
    mounting: MountingAngle,
}

impl NodeMotion {
    /// Motion of a face whose nodes are displaced by `displacement_m` (gel frame, x fastest), seen
    /// by a sensor mounted at an angle.
    ///
    /// # Errors
    /// `Input` if the number of nodes is not that of the face, or a displacement is not finite.
    pub fn new(
        grid: &GelGrid,
        displacement_m: Vec<[f64; 2]>,
        mounting: MountingAngle,
    ) -> Result<Self> {
        let [columns, rows, _] = grid.nodes();
        let (expected, found) = (columns * rows, displacement_m.len());
        if expected != found || !displacement_m.iter().flatten().all(|u| u.is_finite()) {
            return Err(Error::input(format!(
                "expected {expected} finite displacements of the gel's face, found {found}"
            ))
            .remedy("use the gel mesh of the snapshot's trace"));
        }
        let [x, y, _] = grid.axes().clone();
        Ok(Self {
            axes_m: [x, y],
            displacement_m,
            mounting,
        })
    }

    /// Motion of a recorded field.
    ///
    /// # Errors
    /// As [`NodeMotion::new`].
    pub fn of_field(grid: &GelGrid, field: &FaceField, mounting: MountingAngle) -> Result<Self> {
        let in_plane = |[x, y, _]: &[f32; 3]| [f64::from(*x), f64::from(*y)];
        Self::new(
            grid,
            field.displacement_m.iter().map(in_plane).collect(),
            mounting,
        )
    }

    /// Displacement of the point of the skin that rests at a point of the sensor frame, m.
    #[must_use]
    pub fn displacement_m(&self, at_m: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.mounting.to_gel(at_m);
        let (across, down) = (
            Weights::at(&self.axes_m[0], x),
            Weights::at(&self.axes_m[1], y),
        );
        let columns = self.axes_m[0].len();
        let mut sum = [0.0; 2];
        for (row, wy) in down.pairs() {
            for (column, wx) in across.pairs() {
                let node = self.displacement_m[row * columns + column];
                for (sum, u) in sum.iter_mut().zip(node) {
                    *sum += wx * wy * u;
                }
            }
        }
        self.mounting.to_sensor(sum)
    }
}

/// Weights of up to four nodes of an axis in a cubic Hermite interpolation whose slopes are those of
/// the parabola through three nodes.
struct Weights {
    first: usize,
    count: usize,
    weights: [f64; 4],
}

impl Weights {
    fn at(axis: &[f64], x: f64) -> Self {
        let last = axis.len() - 1;
        let x = x.clamp(axis[0], axis[last]);
        let cell = axis.partition_point(|c| *c <= x).clamp(1, last) - 1;
        let first = cell.saturating_sub(1);
        let count = (cell + 2).min(last) - first + 1;
        let width = axis[cell + 1] - axis[cell];
        let t = (x - axis[cell]) / width;
        let (t2, t3) = (t * t, t * t * t);
        let mut weights = [0.0; 4];
        weights[cell - first] += 2.0 * t3 - 3.0 * t2 + 1.0;
        weights[cell + 1 - first] += 3.0 * t2 - 2.0 * t3;
        let at_start = width * (t3 - 2.0 * t2 + t);
        let at_end = width * (t3 - t2);
        for (node, factor) in [(cell, at_start), (cell + 1, at_end)] {
            for (index, slope) in slope_weights(axis, node) {
                weights[index - first] += factor * slope;
            }
        }
        Self {
            first,
            count,
            weights,
        }
    }

    fn pairs(&self) -> impl Iterator<Item = (usize, f64)> {
        (0..self.count).map(|i| (self.first + i, self.weights[i]))
    }
}

/// Nodes and weights of the derivative at a node; one-sided at the ends.
fn slope_weights(axis: &[f64], node: usize) -> impl Iterator<Item = (usize, f64)> {
    let before = (node > 0).then(|| axis[node] - axis[node - 1]);
    let after = axis.get(node + 1).map(|next| next - axis[node]);
    let weights = match (before, after) {
        (Some(b), Some(a)) => [
            (node - 1, -a / (b * (a + b))),
            (node, (a - b) / (a * b)),
            (node + 1, b / (a * (a + b))),
        ],
        (None, Some(a)) => [(node, -1.0 / a), (node + 1, 1.0 / a), (node, 0.0)],
        (Some(b), None) => [(node - 1, -1.0 / b), (node, 1.0 / b), (node, 0.0)],
        (None, None) => [(node, 0.0); 3],
    };
    weights.into_iter()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_sim::fem::{GelPad, GelResolution};

    fn motion(of: impl Fn(f64, f64) -> [f64; 2], mounting: MountingAngle) -> NodeMotion {
        let grid = GelPad::default().grid(GelResolution::Default).unwrap();
        let [columns, rows, layers] = grid.nodes();
        let first = grid.node(0, 0, layers - 1);
        let face = &grid.positions()[first..];
        assert_eq!(face.len(), columns * rows);
        let values = face.iter().map(|p| of(p.x, p.y)).collect();
        NodeMotion::new(&grid, values, mounting).unwrap()
    }

    #[test]
    fn quadratic_motion_is_exact_inside() {
        let of = |x: f64, y: f64| [3.0 * x * x + 0.1 * y, x * y - 2.0 * y * y];
        let motion = motion(of, MountingAngle::default());
        for (x, y) in [(0.0, 0.0), (1.1e-3, -2.3e-3), (-7.7e-3, 6.1e-3)] {
            let (found, expected) = (motion.displacement_m([x, y]), of(x, y));
            for axis in 0..2 {
                assert!((found[axis] - expected[axis]).abs() < 1e-12);
            }
        }
        let beyond = motion.displacement_m([1.0, 0.0]);
        assert!((beyond[0] - of(12.5e-3, 0.0)[0]).abs() < 1e-12);
    }

    #[test]
    fn mounting_turns_points_and_displacements() {
        let of = |x: f64, _: f64| [0.1 * x, 0.0];
        let turned = motion(of, MountingAngle::from_degrees(90).unwrap());
        // The columns run along the gel's y axis, the rows against its x axis.
        let [u, v] = turned.displacement_m([0.0, -4e-3]);
        assert!(u.abs() < 1e-15 && (v + 4e-4).abs() < 1e-15, "{u} {v}");
    }

    #[test]
    fn wrong_number_of_nodes_is_refused() {
        let grid = GelPad::default().grid(GelResolution::Coarse).unwrap();
        let error =
            NodeMotion::new(&grid, vec![[0.0; 2]; 3], MountingAngle::default()).unwrap_err();
        assert!(error.to_string().contains("found 3"), "{error}");
    }
}
