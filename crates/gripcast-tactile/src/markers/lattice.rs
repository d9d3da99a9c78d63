//! Gel markers at rest, and the field of a motion of the skin.

use std::ops::RangeInclusive;

use gripcast_base::random::{gaussians, scramble};
use gripcast_shear::{GelMarker, MarkerField, MarkerPattern};

use crate::SensorGeometry;

/// Gel markers that are drawn beyond the image, pitches: those can move into it.
const MARGIN: f64 = 2.0;
/// Largest distance of a gel marker from its lattice point, in units of the jitter.
const MAX_JITTER: f64 = 2.5;

/// One gel marker at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RestMarker {
    /// Column and row of the lattice.
    pub(super) index: [i64; 2],
    /// Position in the sensor frame, m from the centre of the image.
    pub(super) rest_m: [f64; 2],
}

/// The gel markers of one gel at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerLattice {
    geometry: SensorGeometry,
    /// Columns and rows of the field, as lattice indices: those with a gel marker in the image.
    field: Option<[RangeInclusive<i64>; 2]>,
    /// All gel markers in the image and around it.
    pub(super) markers: Vec<RestMarker>,
}

impl MarkerLattice {
    /// Places the gel markers of a pattern; the seed selects their distances from the lattice, which
    /// are those of one gel.
    #[must_use]
    pub fn new(pattern: &MarkerPattern, geometry: &SensorGeometry, seed: u64) -> Self {
        let half_m = [geometry.width, geometry.height].map(|n| 0.5 * n as f64 * geometry.pixel_m);
        let reach = |axis: usize| {
            let diagonal = half_m[0].hypot(half_m[1]) + pattern.offset_m[axis].abs();
            (diagonal / pattern.pitch_m[axis] + MARGIN).ceil() as i64
        };
        let inside = |at: [f64; 2], margin: f64| {
            (0..2).all(|axis| at[axis].abs() < half_m[axis] + margin * pattern.pitch_m[axis])
        };
        let (columns, rows) = (reach(0), reach(1));
        let mut markers = Vec::new();
        let mut field: Option<[RangeInclusive<i64>; 2]> = None;
        for row in -rows..=rows {
            for column in -columns..=columns {
                let index = [column, row];
                let rest_m = place(pattern, index, seed);
                if !inside(rest_m, MARGIN) {
                    continue;
                }
                if inside(rest_m, 0.0) {
                    let [across, down] = field.get_or_insert([column..=column, row..=row]);
                    *across = column.min(*across.start())..=column.max(*across.end());
                    *down = row.min(*down.start())..=row.max(*down.end());
                }
                markers.push(RestMarker { index, rest_m });
            }
        }
        Self {
            geometry: *geometry,
            field,
            markers,
        }
    }

    /// Returns the field of a motion of the skin. Gel markers whose centre leaves the image are
    /// lost (confidence 0); lattice points whose gel marker rests outside the image are `None`.
    #[must_use]
    pub fn field(&self, motion: &dyn Fn([f64; 2]) -> [f64; 2]) -> MarkerField {
        let empty = MarkerField {
            columns: 0,
            rows: 0,
            m_per_px: self.geometry.pixel_m,
            markers: Vec::new(),
        };
        let Some([across, down]) = &self.field else {
            return empty;
        };
        let count = |range: &RangeInclusive<i64>| (range.end() - range.start() + 1) as usize;
        let (columns, rows) = (count(across), count(down));
        let mut field = MarkerField {
            columns,
            rows,
            markers: vec![None; columns * rows],
            ..empty
        };
        for marker in &self.markers {
            let [column, row] = marker.index;
            let is_inside = across.contains(&column) && down.contains(&row);
            if !is_inside || !self.shows(marker.rest_m) {
                continue;
            }
            let moved = motion(marker.rest_m);
            let position_m = [0, 1].map(|axis| marker.rest_m[axis] + moved[axis]);
            let at = (row - down.start()) as usize * columns + (column - across.start()) as usize;
            field.markers[at] = Some(GelMarker {
                rest_px: self.pixel(marker.rest_m),
                position_px: self.pixel(position_m),
                confidence: if self.shows(position_m) { 1.0 } else { 0.0 },
            });
        }
        field
    }

    fn shows(&self, at_m: [f64; 2]) -> bool {
        let [x, y] = self.geometry.gel_m_to_pixel(at_m);
        let within = |c: f64, count: usize| (-0.5..count as f64 - 0.5).contains(&c);
        within(x, self.geometry.width) && within(y, self.geometry.height)
    }

    fn pixel(&self, at_m: [f64; 2]) -> [f32; 2] {
        self.geometry.gel_m_to_pixel(at_m).map(|c| c as f32)
    }
}

/// Position of a gel marker at rest, m.
fn place(pattern: &MarkerPattern, [column, row]: [i64; 2], seed: u64) -> [f64; 2] {
    let (sin, cos) = pattern.tilt_deg.to_radians().sin_cos();
    let (x, y) = (
        column as f64 * pattern.pitch_m[0],
        row as f64 * pattern.pitch_m[1],
    );
    let item = scramble(column as u64) ^ scramble(!(row as u64));
    // The jitter is the length of two equal components.
    let part_m = pattern.jitter_m * std::f64::consts::FRAC_1_SQRT_2;
    let jitter = gaussians(seed, item).map(|g| part_m * f64::from(g));
    let length = jitter[0].hypot(jitter[1]);
    let limit = (MAX_JITTER * pattern.jitter_m / length.max(f64::MIN_POSITIVE)).min(1.0);
    [
        pattern.offset_m[0] + cos * x - sin * y + limit * jitter[0],
        pattern.offset_m[1] + sin * x + cos * y + limit * jitter[1],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::markers::pattern::sample_pattern;

    const GEOMETRY: SensorGeometry = SensorGeometry {
        width: 320,
        height: 240,
        pixel_m: 6e-5,
        gel_thickness_m: 4e-3,
    };

    #[test]
    fn field_lists_the_gel_markers_of_the_image() {
        let pattern = MarkerPattern {
            jitter_m: 0.0,
            tilt_deg: 0.0,
            offset_m: [0.0; 2],
            pitch_m: [2.6e-3; 2],
            ..sample_pattern()
        };
        let lattice = MarkerLattice::new(&pattern, &GEOMETRY, 1);
        let field = lattice.field(&|_| [6e-5, -1.2e-4]);
        // 19.2 × 14.4 mm: three pitches and a bit on each side.
        assert_eq!((field.columns, field.rows, field.m_per_px), (7, 5, 6e-5));
        let middle = field.markers[2 * 7 + 3].unwrap();
        assert_eq!(middle.rest_px, [159.5, 119.5]);
        let [dx, dy] = middle.displacement_px();
        assert!((dx - 1.0).abs() < 1e-4 && (dy + 2.0).abs() < 1e-4);
        assert!(field.markers.iter().all(Option::is_some));
    }

    #[test]
    fn gel_marker_that_leaves_the_image_is_lost() {
        let lattice = MarkerLattice::new(&sample_pattern(), &GEOMETRY, 1);
        let field = lattice.field(&|_| [3e-3, 0.0]);
        let lost = field.markers.iter().flatten();
        assert!(lost.clone().any(|m| m.confidence == 0.0));
        assert!(lost.clone().any(|m| m.confidence == 1.0));
    }

    #[test]
    fn jitter_has_its_rms_and_belongs_to_the_gel() {
        let still = MarkerPattern {
            jitter_m: 0.0,
            ..sample_pattern()
        };
        let shaken = MarkerPattern {
            jitter_m: 5e-5,
            pitch_m: [4e-4; 2],
            ..sample_pattern()
        };
        let even = MarkerPattern {
            pitch_m: [4e-4; 2],
            ..still
        };
        let of =
            |pattern: &MarkerPattern, seed| MarkerLattice::new(pattern, &GEOMETRY, seed).markers;
        let (rest, moved) = (of(&even, 1), of(&shaken, 1));
        assert_ne!(of(&shaken, 2), moved);
        assert_eq!(of(&shaken, 1), moved);
        let mut square = 0.0;
        let mut count = 0.0;
        for a in &rest {
            if let Some(b) = moved.iter().find(|b| b.index == a.index) {
                let d = [0, 1].map(|axis| a.rest_m[axis] - b.rest_m[axis]);
                square += d[0] * d[0] + d[1] * d[1];
                count += 1.0;
            }
        }
        let rms: f64 = (square / f64::max(count, 1.0)).sqrt();
        assert!((rms / 5e-5 - 1.0).abs() < 0.1, "{rms}");
    }
}
