//! Gel markers: the dots of a gel, their lattice and their displacement.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a sensor profile says of the gel markers.
///
/// The lattice point of column c and row r is at `offset_m` + R(`tilt_deg`) · (c · pitch x,
/// r · pitch y) from the centre of the image, x along the columns of the image and y down.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MarkerPattern {
    /// Distance of neighbouring gel markers along x and y, m.
    pub pitch_m: [f64; 2],
    /// Diameter of a gel marker at half of its darkness, m.
    pub diameter_m: f64,
    /// Position of the gel marker of column 0 and row 0 from the centre of the image, m.
    pub offset_m: [f64; 2],
    /// Rotation of the lattice from x towards y, degrees.
    pub tilt_deg: f64,
    /// Root mean square distance of the gel markers from their lattice points, m.
    pub jitter_m: f64,
    /// Darkness at the centre of a gel marker, fraction of the background, 0 to 1.
    pub darkness: f64,
    /// Width of the edge of a gel marker, from 10 % to 90 % of its darkness, m.
    pub edge_m: f64,
    /// Depth of the marker layer below the face of the gel, m.
    pub depth_m: f64,
}

/// One gel marker in one image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GelMarker {
    /// Position in the initial image, px.
    pub rest_px: [f32; 2],
    /// Position in this image, px; the last known one where the gel marker is lost.
    pub position_px: [f32; 2],
    /// Confidence of the position, 0 to 1; 0 for a lost gel marker.
    pub confidence: f32,
}

impl GelMarker {
    /// Displacement since the initial image, px.
    #[must_use]
    pub fn displacement_px(&self) -> [f32; 2] {
        [0, 1].map(|axis| self.position_px[axis] - self.rest_px[axis])
    }
}

/// The gel markers of one image, by lattice point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MarkerField {
    /// Columns of the lattice.
    pub columns: usize,
    /// Rows of the lattice.
    pub rows: usize,
    /// Scale of the image, m/px.
    pub m_per_px: f64,
    /// Row-major; `None` where the lattice point is outside the image or has no gel marker.
    pub markers: Vec<Option<GelMarker>>,
}

/// Values of one lattice point in [`MarkerField::to_array`].
const VALUES: usize = 5;

impl MarkerField {
    /// The gel markers as an array of rows × columns × 5: rest x, rest y, displacement x,
    /// displacement y (px), confidence. NaN where the lattice point has no gel marker, and for the
    /// displacement of a lost one.
    #[must_use]
    pub fn to_array(&self) -> (Vec<f32>, [usize; 3]) {
        let values = |marker: &Option<GelMarker>| match marker {
            None => [f32::NAN; VALUES],
            Some(marker) => {
                let [x, y] = marker.rest_px;
                let [dx, dy] = match marker.confidence > 0.0 {
                    true => marker.displacement_px(),
                    false => [f32::NAN; 2],
                };
                [x, y, dx, dy, marker.confidence]
            }
        };
        let array = self.markers.iter().flat_map(values).collect();
        (array, [self.rows, self.columns, VALUES])
    }
}
