//! Gel markers: the dots of a gel, their lattice and their displacement.

use gripcast_base::linear::NormalEquations;
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

/// Pixels of an image of this width and height within `radius` of the centres, row-major: those that
/// gel markers cover.
pub fn covered(
    [width, height]: [usize; 2],
    centres_px: impl Iterator<Item = [f32; 2]>,
    radius_px: f32,
) -> Vec<bool> {
    let mut is_covered = vec![false; width * height];
    for [x, y] in centres_px {
        let range = |middle: f32, reach: f32, size: usize| {
            let from = (middle - reach).ceil().max(0.0) as usize;
            let to = (middle + reach + 1.0).max(0.0) as usize;
            from.min(size)..to.min(size)
        };
        for row in range(y, radius_px, height) {
            let square = radius_px * radius_px - (row as f32 - y).powi(2);
            let half = square.max(0.0).sqrt();
            is_covered[row * width..][range(x, half, width)].fill(true);
        }
    }
    is_covered
}

/// Minimum gel markers for the gradient of the displacement.
const MIN_GRADIENT_MARKERS: usize = 4;
/// Values of one lattice point in [`MarkerField::to_array`].
const VALUES: usize = 5;

impl MarkerField {
    /// The gel marker at a lattice point, unless it is lost.
    pub(crate) fn tracked(&self, at: usize) -> Option<&GelMarker> {
        let marker = self.markers.get(at)?.as_ref()?;
        (marker.confidence > 0.0).then_some(marker)
    }

    /// Median distance of neighbouring gel markers at rest along x and y, px; `None` without two
    /// neighbours along each.
    #[must_use]
    pub fn pitch_px(&self) -> Option<[f32; 2]> {
        let rest = |at: usize| self.markers.get(at)?.as_ref().map(|m| m.rest_px);
        let median = |mut distances: Vec<f32>| {
            distances.sort_by(f32::total_cmp);
            distances.get(distances.len() / 2).copied()
        };
        let between = |step: usize, axis: usize| {
            let pairs = (0..self.markers.len())
                .filter(|at| step == self.columns || (at + 1) % self.columns.max(1) != 0);
            let distance = |at: usize| Some((rest(at + step)?[axis] - rest(at)?[axis]).abs());
            median(pairs.filter_map(distance).collect())
        };
        Some([between(1, 0)?, between(self.columns, 1)?])
    }

    /// Gradient of the displacement (u, v) at a lattice point, by least squares over the gel marker
    /// and its up to eight neighbours: [[∂u/∂x, ∂u/∂y], [∂v/∂x, ∂v/∂y]]. `None` where too few of
    /// them are tracked.
    ///
    /// The small strain is its symmetric part, the divergence its trace, the curl ∂v/∂x − ∂u/∂y.
    #[must_use]
    pub fn gradient(&self, column: usize, row: usize) -> Option<[[f32; 2]; 2]> {
        if column >= self.columns || row >= self.rows {
            return None;
        }
        let centre = self.tracked(row * self.columns + column)?;
        let rows = row.saturating_sub(1)..(row + 2).min(self.rows);
        let columns = column.saturating_sub(1)..(column + 2).min(self.columns);
        let around = rows.flat_map(|r| columns.clone().map(move |c| r * self.columns + c));
        let mut systems = [NormalEquations::<3>::zero(), NormalEquations::<3>::zero()];
        let mut count = 0;
        for marker in around.filter_map(|at| self.tracked(at)) {
            let offset = [0, 1].map(|a| f64::from(marker.rest_px[a] - centre.rest_px[a]));
            let displacement = marker.displacement_px();
            for (system, value) in systems.iter_mut().zip(displacement) {
                system.add(&[1.0, offset[0], offset[1]], f64::from(value), 1.0);
            }
            count += 1;
        }
        if count < MIN_GRADIENT_MARKERS {
            return None;
        }
        let [u, v] = systems.map(|system| system.solve());
        let gradient = [u?, v?].map(|[_, x, y]| [x as f32, y as f32]);
        gradient
            .iter()
            .flatten()
            .all(|value| value.is_finite())
            .then_some(gradient)
    }

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
