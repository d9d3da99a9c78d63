//! Orthographic z-buffer: per pixel the mesh surface nearest to the sensor.
//!
//! Parallel rays need no acceleration structure: each triangle is projected and rasterised span by
//! span. A pixel belongs to a triangle if its centre lies inside or on its left or top edge, so
//! that neighbours neither overlap nor leave a gap: a shared edge is computed by the same
//! operations for both.

use glam::{DMat3, DVec3};

use super::press_depth::SensorGeometry;
use gripcast_geometry::{Pose, TriangleMesh};

/// Value of [`Rasteriser::nearest_with_triangles`] for pixels without a triangle.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// Projected vertex: column, row (px), z (m).
type Corner = [f64; 3];

/// Z-buffer, reused between frames.
///
/// Sensor frame: x along the columns and y along the rows of the image, z from the gel's back to
/// its face; the origin is the centre of the back.
#[derive(Clone, Debug, Default)]
pub struct Rasteriser {
    corners: Vec<Corner>,
    nearest_m: Vec<f32>,
    triangles: Vec<u32>,
}

impl Rasteriser {
    /// Creates a rasteriser with empty buffers.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns per pixel, row-major, the minimum z (m) of the mesh at or above `range_m[0]`;
    /// `range_m[1]` where nothing is below that.
    ///
    /// The mesh must be valid ([`TriangleMesh::validate`]).
    pub fn nearest(
        &mut self,
        mesh: &TriangleMesh,
        t_sensor_mesh: &Pose,
        grid: &SensorGeometry,
        range_m: [f64; 2],
    ) -> &[f32] {
        self.draw::<false>(mesh, t_sensor_mesh, grid, range_m);
        &self.nearest_m
    }

    /// As [`Rasteriser::nearest`], with the visible triangle of each pixel ([`NO_TRIANGLE`] if
    /// none); the first triangle wins at equal distance.
    pub fn nearest_with_triangles(
        &mut self,
        mesh: &TriangleMesh,
        t_sensor_mesh: &Pose,
        grid: &SensorGeometry,
        range_m: [f64; 2],
    ) -> (&[f32], &[u32]) {
        self.draw::<true>(mesh, t_sensor_mesh, grid, range_m);
        (&self.nearest_m, &self.triangles)
    }

    fn draw<const TRIANGLES: bool>(
        &mut self,
        mesh: &TriangleMesh,
        t_sensor_mesh: &Pose,
        grid: &SensorGeometry,
        range_m: [f64; 2],
    ) {
        self.project(mesh, t_sensor_mesh, grid);
        let pixels = grid.width * grid.height;
        self.nearest_m.clear();
        self.nearest_m.resize(pixels, range_m[1] as f32);
        self.triangles.clear();
        if TRIANGLES {
            self.triangles.resize(pixels, NO_TRIANGLE);
        }
        let mut canvas = Canvas {
            grid: Grid::new(grid),
            range_m,
            nearest_m: &mut self.nearest_m,
            triangles: &mut self.triangles,
        };
        for (index, triangle) in mesh.triangles.iter().enumerate() {
            let corners = triangle.map(|v| &self.corners[v as usize]);
            canvas.draw::<TRIANGLES>(corners, index as u32);
        }
    }

    /// Projects the vertices of the mesh onto the pixel grid.
    fn project(&mut self, mesh: &TriangleMesh, t_sensor_mesh: &Pose, grid: &SensorGeometry) {
        let to_pixels = DVec3::new(1.0 / grid.pixel_m, 1.0 / grid.pixel_m, 1.0);
        let rotation = DMat3::from_diagonal(to_pixels) * t_sensor_mesh.rotation_matrix();
        let middle = DVec3::new(
            0.5 * (grid.width as f64 - 1.0),
            0.5 * (grid.height as f64 - 1.0),
            0.0,
        );
        let shift = to_pixels * t_sensor_mesh.translation_m + middle;
        self.corners.clear();
        let project = |v: &DVec3| (rotation * *v + shift).to_array();
        self.corners.extend(mesh.vertices.iter().map(project));
    }
}

/// Size of the image.
#[derive(Clone, Copy)]
struct Grid {
    width: f64,
    height: f64,
    stride: usize,
}

impl Grid {
    fn new(grid: &SensorGeometry) -> Self {
        Self {
            width: grid.width as f64,
            height: grid.height as f64,
            stride: grid.width,
        }
    }
}

/// Render target.
struct Canvas<'a> {
    grid: Grid,
    range_m: [f64; 2],
    nearest_m: &'a mut [f32],
    triangles: &'a mut [u32],
}

/// Plane of a triangle: z at a vertex, and its slopes along column and row (m per pixel).
struct Plane {
    at: Corner,
    slope: [f64; 2],
    bounds_m: [f32; 2],
}

impl Canvas<'_> {
    #[inline]
    fn draw<const TRIANGLES: bool>(&mut self, corners: [&Corner; 3], index: u32) {
        let [a, b, c] = corners;
        let [near, far] = self.range_m;
        let (lowest, highest) = (min3(a[2], b[2], c[2]), max3(a[2], b[2], c[2]));
        if lowest >= far || highest < near {
            return;
        }
        let left = first_at_or_after(min3(a[0], b[0], c[0]), self.grid.width);
        let right = first_at_or_after(max3(a[0], b[0], c[0]), self.grid.width);
        let top = first_at_or_after(min3(a[1], b[1], c[1]), self.grid.height);
        let bottom = first_at_or_after(max3(a[1], b[1], c[1]), self.grid.height);
        if left >= right || top >= bottom {
            return;
        }
        let Some(slope) = slopes(corners) else { return };
        let plane = Plane {
            at: *a,
            slope,
            bounds_m: [lowest as f32, highest as f32],
        };
        let [upper, middle, lower] = sorted_by_row(corners);
        let long = Edge::new(upper, lower);
        let split = first_at_or_after(middle[1], self.grid.height);
        for (rows, from, to) in [(top..split, upper, middle), (split..bottom, middle, lower)] {
            if rows.is_empty() {
                continue;
            }
            let short = Edge::new(from, to);
            for row in rows {
                let ends = [long.column(row), short.column(row)];
                let start = first_at_or_after(ends[0].min(ends[1]), self.grid.width);
                let end = first_at_or_after(ends[0].max(ends[1]), self.grid.width);
                if start < end {
                    self.span::<TRIANGLES>(row, start..end, &plane, index);
                }
            }
        }
    }

    /// Depth-tests a span of a row.
    #[inline]
    fn span<const TRIANGLES: bool>(
        &mut self,
        row: usize,
        columns: std::ops::Range<usize>,
        plane: &Plane,
        index: u32,
    ) {
        let [column_slope, row_slope] = plane.slope;
        let from = plane.at[2]
            + column_slope * (columns.start as f64 - plane.at[0])
            + row_slope * (row as f64 - plane.at[1]);
        let (from, step) = (from as f32, column_slope as f32);
        // Rounding must not move an edge-on triangle beyond its vertices.
        let [lowest, highest] = plane.bounds_m;
        let near = self.range_m[0] as f32;
        let at = row * self.grid.stride;
        let pixels = at + columns.start..at + columns.end;
        let ids = if TRIANGLES { pixels.clone() } else { 0..0 };
        let depth = &mut self.nearest_m[pixels];
        let ids = &mut self.triangles[ids];
        for (k, depth) in depth.iter_mut().enumerate() {
            let z = (from + k as f32 * step).max(lowest).min(highest);
            if z >= near && z < *depth {
                *depth = z;
                if TRIANGLES {
                    ids[k] = index;
                }
            }
        }
    }
}

/// Slopes of z along column and row; `None` for an edge-on triangle.
#[inline]
fn slopes([a, b, c]: [&Corner; 3]) -> Option<[f64; 2]> {
    let (u, v) = (
        [b[0] - a[0], b[1] - a[1], b[2] - a[2]],
        [c[0] - a[0], c[1] - a[1], c[2] - a[2]],
    );
    let area = u[0] * v[1] - v[0] * u[1];
    if area == 0.0 {
        return None;
    }
    let scale = 1.0 / area;
    Some([
        (u[2] * v[1] - v[2] * u[1]) * scale,
        (u[0] * v[2] - v[0] * u[2]) * scale,
    ])
}

/// Edge of a triangle, traversed downwards.
struct Edge {
    from: [f64; 2],
    columns_per_row: f64,
}

impl Edge {
    #[inline]
    fn new(upper: &Corner, lower: &Corner) -> Self {
        Self {
            from: [upper[0], upper[1]],
            columns_per_row: (lower[0] - upper[0]) / (lower[1] - upper[1]),
        }
    }

    #[inline]
    fn column(&self, row: usize) -> f64 {
        self.from[0] + (row as f64 - self.from[1]) * self.columns_per_row
    }
}

#[inline]
fn sorted_by_row([mut a, mut b, mut c]: [&Corner; 3]) -> [&Corner; 3] {
    if b[1] < a[1] {
        std::mem::swap(&mut a, &mut b);
    }
    if c[1] < b[1] {
        std::mem::swap(&mut b, &mut c);
    }
    if b[1] < a[1] {
        std::mem::swap(&mut a, &mut b);
    }
    [a, b, c]
}

/// Returns the first integer at or after `place`, within 0..=`limit`.
#[inline]
fn first_at_or_after(x: f64, limit: f64) -> usize {
    let x = x.max(0.0).min(limit);
    // `ceil` is a library call without SSE4.1 and dominates small triangles.
    let below = x as u32;
    (below + u32::from(f64::from(below) < x)) as usize
}

#[inline]
fn min3(a: f64, b: f64, c: f64) -> f64 {
    a.min(b).min(c)
}

#[inline]
fn max3(a: f64, b: f64, c: f64) -> f64 {
    a.max(b).max(c)
}

#[cfg(test)]
#[path = "rasteriser_test.rs"]
mod tests;
