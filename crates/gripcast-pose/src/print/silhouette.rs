//! Silhouette of an object on the sheet from above.

use glam::DVec2;

use super::contour::{Outline, chain, simplify};
use gripcast_geometry::TriangleMesh;

/// Minimum distance of samples, mm.
const PITCH_MM: f64 = 0.1;
/// Maximum number of samples along a side.
const MAX_SAMPLES: f64 = 3000.0;

/// Binary samples on a grid.
pub(super) struct Silhouette {
    /// Centre of the first sample, mm.
    first: DVec2,
    pitch: f64,
    columns: usize,
    rows: usize,
    covered: Vec<bool>,
    /// Corners of the bounding box, mm.
    pub(super) low: DVec2,
    pub(super) high: DVec2,
}

impl Silhouette {
    /// Projects a non-empty mesh (m) along z.
    pub(super) fn new(mesh: &TriangleMesh) -> Self {
        let bounds = mesh.bounds();
        let (low, high) = (1e3 * bounds.min.truncate(), 1e3 * bounds.max.truncate());
        let size = high - low;
        let pitch = PITCH_MM.max(size.max_element() / MAX_SAMPLES);
        // Uncovered samples all around close the outlines.
        let count = |length: f64| (length / pitch).ceil() as usize + 3;
        let (columns, rows) = (count(size.x), count(size.y));
        let mut silhouette = Self {
            first: low - pitch,
            pitch,
            columns,
            rows,
            covered: vec![false; columns * rows],
            low,
            high,
        };
        for corners in mesh.all_corners() {
            silhouette.fill(corners.map(|c| 1e3 * c.truncate()));
        }
        silhouette
    }

    /// Covers the samples in a triangle, mm.
    fn fill(&mut self, corners: [DVec2; 3]) {
        let [a, b, c] = corners.map(|p| (p - self.first) / self.pitch);
        let top = a.y.min(b.y).min(c.y).ceil().max(0.0) as usize;
        let bottom = a.y.max(b.y).max(c.y).floor().max(0.0) as usize;
        for row in top..=bottom.min(self.rows - 1) {
            let y = row as f64;
            let mut span = [f64::INFINITY, f64::NEG_INFINITY];
            for (p, q) in [(a, b), (b, c), (c, a)] {
                if (p.y - y) * (q.y - y) > 0.0 {
                    continue;
                }
                let ends = if p.y == q.y {
                    [p.x, q.x]
                } else {
                    [p.x + (y - p.y) / (q.y - p.y) * (q.x - p.x); 2]
                };
                for x in ends {
                    span = [span[0].min(x), span[1].max(x)];
                }
            }
            let from = span[0].ceil().max(0.0) as usize;
            let to = (span[1].floor().max(-1.0) + 1.0) as usize;
            for column in from..to.min(self.columns) {
                self.covered[row * self.columns + column] = true;
            }
        }
    }

    /// Whether the rectangle from `low` to `high`, mm, touches the object.
    pub(super) fn touches(&self, low: DVec2, high: DVec2) -> bool {
        let index = |p: DVec2| (p - self.first) / self.pitch;
        let (from, to) = (index(low).floor(), index(high).ceil());
        let range = |from: f64, to: f64, count: usize| {
            let clamp = |v: f64| v.clamp(0.0, count as f64) as usize;
            clamp(from)..clamp(to + 1.0)
        };
        let columns = range(from.x, to.x, self.columns);
        range(from.y, to.y, self.rows).any(|row| {
            columns
                .clone()
                .any(|c| self.covered[row * self.columns + c])
        })
    }

    /// Outlines in mm.
    pub(super) fn outlines(&self) -> Vec<Outline> {
        let position = |[x, y]: [i64; 2]| {
            // Corners lie between the samples.
            self.first + (DVec2::new(x as f64, y as f64) - 0.5) * self.pitch
        };
        let smooth = |corners: Vec<[i64; 2]>| {
            let outline = Outline {
                points: corners.into_iter().map(position).collect(),
                closed: true,
            };
            simplify(&outline, 0.9 * self.pitch)
        };
        self.borders().into_iter().map(smooth).collect()
    }

    /// Corners of the closed boundaries between covered and uncovered samples.
    fn borders(&self) -> Vec<Vec<[i64; 2]>> {
        let is_covered = |x: i64, y: i64| {
            let (column, row) = (x as usize, y as usize);
            x >= 0
                && y >= 0
                && column < self.columns
                && row < self.rows
                && self.covered[row * self.columns + column]
        };
        // Boundary sides of the covered samples, oriented, by row.
        let mut sides: Vec<([i64; 2], [i64; 2])> = Vec::new();
        for y in 0..self.rows as i64 {
            for x in 0..self.columns as i64 {
                if !is_covered(x, y) {
                    continue;
                }
                let [a, b, c, d] = [[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]];
                for (free, side) in [
                    (!is_covered(x, y - 1), (a, b)),
                    (!is_covered(x + 1, y), (b, c)),
                    (!is_covered(x, y + 1), (c, d)),
                    (!is_covered(x - 1, y), (d, a)),
                ] {
                    if free {
                        sides.push(side);
                    }
                }
            }
        }
        let walks = chain(&sides).into_iter().map(|(corners, _)| corners);
        walks.filter(|corners| corners.len() >= 4).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::builtin;

    #[test]
    fn silhouette_of_a_mug_has_its_handle() {
        let silhouette = Silhouette::new(&builtin("mug").unwrap());
        assert!((silhouette.high.x - 63.0).abs() < 0.2 && (silhouette.low.x + 30.0).abs() < 0.2);
        let at = |x: f64, y: f64| silhouette.touches(DVec2::new(x, y), DVec2::new(x, y));
        // The wall, the bottom and the handle.
        assert!(at(-29.0, 0.0) && at(0.0, 0.0) && at(60.0, 0.0));
        assert!(!at(60.0, 20.0) && !at(-25.0, 25.0) && !at(200.0, 0.0));
        let outlines = silhouette.outlines();
        assert_eq!(outlines.len(), 1);
        let far = |p: &DVec2| p.length();
        let outer = &outlines[0].points;
        assert!(outer.len() < 500, "{}", outer.len());
        for point in outer.iter().filter(|p| p.x < 0.0) {
            assert!((far(point) - 30.0).abs() < 0.15, "{point}");
        }
    }

    #[test]
    fn silhouette_of_a_ring_has_an_inner_outline() {
        let mesh = builtin("mug").unwrap();
        // The wall without the bottom.
        let is_wall = |t: &&[u32; 3]| {
            let centre = t
                .iter()
                .map(|v| mesh.vertices[*v as usize])
                .sum::<glam::DVec3>()
                / 3.0;
            centre.truncate().length() > 0.0255
        };
        let ring = TriangleMesh {
            vertices: mesh.vertices.clone(),
            triangles: mesh.triangles.iter().filter(is_wall).copied().collect(),
        };
        let silhouette = Silhouette::new(&ring);
        assert_eq!(silhouette.outlines().len(), 2);
        assert!(!silhouette.touches(DVec2::splat(-5.0), DVec2::splat(5.0)));
        assert!(silhouette.touches(DVec2::splat(-22.0), DVec2::splat(22.0)));
    }
}
