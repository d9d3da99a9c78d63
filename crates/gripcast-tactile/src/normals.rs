//! Unit normals of the deformed gel face.

use super::gaussian::Region;
use super::press_depth::SensorGeometry;

/// Unit normals of a height map as planes of `width * height`; (0, 0, 1) where the face is flat.
///
/// With the height h towards the sensor's camera, n = (−∂h/∂x, −∂h/∂y, 1) / |·|; x along the
/// columns, y along the rows.
#[derive(Clone, Debug, Default)]
pub struct Normals {
    /// Width, px.
    pub width: usize,
    /// x component.
    pub x: Vec<f32>,
    /// y component.
    pub y: Vec<f32>,
    /// z component minus 1, which is precise for small slopes.
    pub z_less_1: Vec<f32>,
    /// Region where the face is not flat.
    pub(super) region: Option<Region>,
}

impl Normals {
    /// Computes the normals of a height map (m, `width * height`) by central differences.
    pub fn compute(&mut self, height_m: &[f32], geometry: &SensorGeometry) {
        let (width, pixel_m) = (geometry.width, geometry.pixel_m);
        let rows = height_m.len() / width.max(1);
        self.width = width;
        for plane in [&mut self.x, &mut self.y, &mut self.z_less_1] {
            plane.clear();
            plane.resize(height_m.len(), 0.0);
        }
        self.region = Region::nonzero(height_m, width).map(|r| r.grown(1, width, rows));
        let Some(region) = self.region else {
            return;
        };
        let per_pixel = (1.0 / pixel_m) as f32;
        for y in region.y0..region.y1 {
            let above = y.saturating_sub(1);
            let below = (y + 1).min(rows - 1);
            let step = per_pixel / (below - above).max(1) as f32;
            let span = |row: usize| &height_m[row * width + region.x0..row * width + region.x1];
            let span_here = y * width + region.x0..y * width + region.x1;
            for (out, (a, b)) in self.y[span_here.clone()]
                .iter_mut()
                .zip(span(above).iter().zip(span(below)))
            {
                *out = (a - b) * step;
            }
            let row = &height_m[y * width..(y + 1) * width];
            row_slopes(row, region, per_pixel, &mut self.x[span_here.clone()]);
            normalise(
                &mut self.x[span_here.clone()],
                &mut self.y[span_here.clone()],
                &mut self.z_less_1[span_here],
            );
        }
    }

    /// Limits the slope: reduces the sine of steeper normals to `steepest`, keeping their
    /// direction.
    pub fn limit_slope(&mut self, steepest: f32) {
        let Some(region) = self.region else {
            return;
        };
        let flatter = (1.0 - steepest * steepest).max(0.0).sqrt() - 1.0;
        for y in region.y0..region.y1 {
            let span = y * self.width + region.x0..y * self.width + region.x1;
            let plane = self.x[span.clone()].iter_mut();
            let plane = plane.zip(self.y[span.clone()].iter_mut());
            for ((x, y), z) in plane.zip(&mut self.z_less_1[span]) {
                let sine = (*x * *x + *y * *y).sqrt();
                let scale = if sine > steepest {
                    steepest / sine
                } else {
                    1.0
                };
                *x *= scale;
                *y *= scale;
                *z = z.max(flatter);
            }
        }
    }
}

/// Computes −∂h/∂x along one row, one-sided at the border.
fn row_slopes(row: &[f32], region: Region, per_pixel: f32, out: &mut [f32]) {
    let last = row.len() - 1;
    let half = 0.5 * per_pixel;
    let inner = region.x0.max(1)..region.x1.min(last);
    for x in [region.x0, region.x1 - 1] {
        if !inner.contains(&x) {
            let (left, right) = (x.saturating_sub(1), (x + 1).min(last));
            out[x - region.x0] = (row[left] - row[right]) * per_pixel;
        }
    }
    if inner.is_empty() {
        return;
    }
    let sides = row[inner.start - 1..].iter().zip(&row[inner.start + 1..]);
    let out = &mut out[inner.start - region.x0..inner.end - region.x0];
    for (out, (left, right)) in out.iter_mut().zip(sides) {
        *out = (left - right) * half;
    }
}

/// Converts slopes to unit normals in place.
fn normalise(x: &mut [f32], y: &mut [f32], z_less_1: &mut [f32]) {
    for ((x, y), z) in x.iter_mut().zip(y.iter_mut()).zip(z_less_1) {
        let square = *x * *x + *y * *y;
        let length = (1.0 + square).sqrt();
        *x /= length;
        *y /= length;
        // 1/l − 1 without cancellation.
        *z = -square / (length * (1.0 + length));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geometry() -> SensorGeometry {
        SensorGeometry {
            width: 12,
            height: 9,
            pixel_m: 1e-4,
            gel_thickness_m: 4e-3,
        }
    }

    #[test]
    fn plane_has_constant_unit_normal() {
        let geometry = geometry();
        let (width, height) = (geometry.width, geometry.height);
        let map: Vec<f32> = (0..width * height)
            .map(|i| 1e-4 * (0.75 * (i % width) as f32 - 0.4 * (i / width) as f32) + 1.0)
            .collect();
        let mut normals = Normals::default();
        normals.compute(&map, &geometry);
        let length = (1.0f32 + 0.75 * 0.75 + 0.4 * 0.4).sqrt();
        for i in 0..map.len() {
            assert!((normals.x[i] + 0.75 / length).abs() < 2e-3);
            assert!((normals.y[i] - 0.4 / length).abs() < 2e-3);
            assert!((normals.z_less_1[i] - (1.0 / length - 1.0)).abs() < 2e-3);
        }
    }

    #[test]
    fn slope_limit_keeps_direction() {
        let map: Vec<f32> = (0..108).map(|i| 3e-4 * (i % 12) as f32).collect();
        let mut normals = Normals::default();
        normals.compute(&map, &geometry());
        normals.limit_slope(0.5);
        assert!((normals.x[50] + 0.5).abs() < 1e-6 && normals.y[50] == 0.0);
        assert!((normals.z_less_1[50] + 1.0 - 0.75f32.sqrt()).abs() < 1e-6);
        let before = normals.clone();
        normals.limit_slope(0.6);
        assert_eq!(normals.x, before.x);
    }

    #[test]
    fn flat_map_has_vertical_normals() {
        let mut normals = Normals::default();
        normals.compute(&[0.0; 108], &geometry());
        assert_eq!(normals.x, [0.0; 108]);
        assert_eq!(normals.z_less_1, [0.0; 108]);
    }
}
