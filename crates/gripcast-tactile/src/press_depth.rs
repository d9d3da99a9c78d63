//! Indentation depth map of a press.

use serde::{Deserialize, Serialize};

/// Pixel grid and gel of a sensor. The grid is centred on the gel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorGeometry {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Pixel size on the gel face, m.
    pub pixel_m: f64,
    /// Gel thickness, the maximum depth, m.
    pub gel_thickness_m: f64,
}

impl SensorGeometry {
    /// Returns the position of a pixel on the gel face: x along the columns, y along the rows, m
    /// from the centre.
    pub fn pixel_to_gel_m(&self, column: f64, row: f64) -> [f64; 2] {
        [
            (column - 0.5 * (self.width as f64 - 1.0)) * self.pixel_m,
            (row - 0.5 * (self.height as f64 - 1.0)) * self.pixel_m,
        ]
    }

    /// Returns the pixel, column and row, of a position on the gel face, m from the centre.
    pub fn gel_m_to_pixel(&self, at_m: [f64; 2]) -> [f64; 2] {
        [
            at_m[0] / self.pixel_m + 0.5 * (self.width as f64 - 1.0),
            at_m[1] / self.pixel_m + 0.5 * (self.height as f64 - 1.0),
        ]
    }
}

/// Indentation depth per pixel, m: how far the face is pushed in, 0 without contact.
#[derive(Clone, Debug, PartialEq)]
pub struct PressDepth {
    /// Pixel grid.
    pub geometry: SensorGeometry,
    /// Row-major, `width * height`.
    pub depth_m: Vec<f32>,
}

impl PressDepth {
    /// Depth map without contact.
    pub fn untouched(geometry: SensorGeometry) -> Self {
        Self {
            geometry,
            depth_m: vec![0.0; geometry.width * geometry.height],
        }
    }

    /// Maximum depth, m.
    pub fn deepest_m(&self) -> f64 {
        f64::from(folded(&self.depth_m, 0.0, f32::max))
    }
}

/// Folds values by an operation whose order does not matter, in loops that vectorise.
pub(super) fn folded(values: &[f32], start: f32, operation: impl Fn(f32, f32) -> f32) -> f32 {
    let mut lanes = [start; 16];
    for block in values.chunks(lanes.len()) {
        for (lane, value) in lanes.iter_mut().zip(block) {
            *lane = operation(*lane, *value);
        }
    }
    lanes.into_iter().fold(start, operation)
}
