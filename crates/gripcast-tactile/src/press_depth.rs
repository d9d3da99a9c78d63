//! How deep an object is pressed into the gel, pixel by pixel.

use serde::{Deserialize, Serialize};

/// Pixel grid and gel of a sensor. The middle of the grid lies over the middle of the gel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorGeometry {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Size of a pixel on the gel's face, m.
    pub pixel_m: f64,
    /// Thickness of the gel: no press is deeper, m.
    pub gel_thickness_m: f64,
}

impl SensorGeometry {
    /// Place of a pixel's centre on the gel's face: x along the columns, y along the rows, m from
    /// the middle.
    pub fn pixel_to_gel_m(&self, column: f64, row: f64) -> [f64; 2] {
        [
            (column - 0.5 * (self.width as f64 - 1.0)) * self.pixel_m,
            (row - 0.5 * (self.height as f64 - 1.0)) * self.pixel_m,
        ]
    }
}

/// Depth of the press under each pixel, m: how far the face is pushed in, 0 where nothing touches.
#[derive(Clone, Debug, PartialEq)]
pub struct PressDepth {
    /// The grid.
    pub geometry: SensorGeometry,
    /// Row by row, `width * height`.
    pub depth_m: Vec<f32>,
}

impl PressDepth {
    /// Nothing touches.
    pub fn untouched(geometry: SensorGeometry) -> Self {
        Self {
            geometry,
            depth_m: vec![0.0; geometry.width * geometry.height],
        }
    }

    /// Largest depth, m.
    pub fn deepest_m(&self) -> f64 {
        f64::from(self.depth_m.iter().copied().fold(0.0, f32::max))
    }
}
