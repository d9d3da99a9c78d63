//! What the gels show while an object is lifted.

use serde::{Deserialize, Serialize};

use crate::{ShearFrame, ShearSource};

/// What a gel shows in one image, relative to its initial image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GelMotion {
    /// Mean absolute change, grey levels: grows with the force.
    pub level: f64,
    /// Fraction of the image in contact, 0 to 1.
    pub contact_fraction: f64,
    /// Mean displacement of the skin in contact, mm: x right, y down in the image. 0 where nothing
    /// is tracked.
    pub displacement_mm: [f64; 2],
    /// Mean curl of the displacement: twice the rotation in radians.
    pub curl: f64,
    /// Slip ratio, 0 to 1; `None` where it is not measured.
    pub slip_ratio: Option<f64>,
    /// Confidence of the motion, 0 to 1.
    pub confidence: f64,
    /// Whether it was measured on gel markers.
    pub has_markers: bool,
}

impl GelMotion {
    /// Number of values of [`GelMotion::to_array`].
    pub const LEN: usize = 8;

    /// Motion of a gel whose image differs from the initial one by `level`.
    pub fn new(level: f64, shear: &ShearFrame) -> Self {
        let Some(summary) = &shear.summary else {
            return Self {
                level,
                ..Self::default()
            };
        };
        Self {
            level,
            contact_fraction: summary.contact_fraction,
            displacement_mm: summary.mean_displacement_mm,
            curl: summary.curl,
            slip_ratio: summary.slip_ratio,
            confidence: summary.confidence,
            has_markers: summary.source == ShearSource::Markers,
        }
    }

    /// All values in the order of the fields; NaN for an unknown slip ratio.
    pub fn to_array(&self) -> [f64; Self::LEN] {
        let [x, y] = self.displacement_mm;
        [
            self.level,
            self.contact_fraction,
            x,
            y,
            self.curl,
            self.slip_ratio.unwrap_or(f64::NAN),
            self.confidence,
            f64::from(u8::from(self.has_markers)),
        ]
    }

    /// The motion of an array of [`GelMotion::to_array`].
    pub fn from_array([level, contact, x, y, curl, slip, confidence, markers]: [f64; 8]) -> Self {
        Self {
            level,
            contact_fraction: contact,
            displacement_mm: [x, y],
            curl,
            slip_ratio: (!slip.is_nan()).then_some(slip),
            confidence,
            has_markers: markers > 0.5,
        }
    }
}

/// Motion of the left and the right gel in images of one lift, the first taken before it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LiftMotion {
    /// Left and right gel of each image.
    pub frames: Vec<[GelMotion; 2]>,
}

impl LiftMotion {
    /// Images of a simulated lift: before it and every 40 ms of the first 20 mm.
    pub const FRAMES: usize = 26;
    /// Largest number of values of [`LiftMotion::to_values`].
    pub const LEN: usize = Self::FRAMES * 2 * GelMotion::LEN;

    /// Values of the first [`LiftMotion::FRAMES`] images.
    pub fn to_values(&self) -> Vec<f64> {
        let frames = self.frames.iter().flatten().take(2 * Self::FRAMES);
        frames.flat_map(GelMotion::to_array).collect()
    }

    /// The motion of [`LiftMotion::to_values`]; none for a number of values that is not that of
    /// whole images or too large, or if one other than a slip ratio is not finite. Images with a NaN
    /// level end the motion.
    pub fn from_values(values: &[f64]) -> Option<Self> {
        let (gels, rest) = values.as_chunks::<{ GelMotion::LEN }>();
        let (pairs, single) = gels.as_chunks::<2>();
        if values.len() > Self::LEN || !rest.is_empty() || !single.is_empty() {
            return None;
        }
        let known = pairs.iter().take_while(|pair| !pair[0][0].is_nan());
        let frames = known.map(|pair| pair.map(GelMotion::from_array));
        let motion = Self {
            frames: frames.collect(),
        };
        motion.is_finite().then_some(motion)
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        let gels = self.frames.iter().flatten();
        gels.flat_map(|gel| {
            let slip_ratio = Some(gel.slip_ratio.unwrap_or_default());
            GelMotion { slip_ratio, ..*gel }.to_array()
        })
        .all(f64::is_finite)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_back() {
        let gel = |level: f64, slip_ratio| GelMotion {
            level,
            contact_fraction: 0.25,
            displacement_mm: [0.1, -0.2],
            curl: 0.01,
            slip_ratio,
            confidence: 0.9,
            has_markers: slip_ratio.is_some(),
        };
        let frames = vec![[gel(4.0, Some(0.3)), gel(5.0, None)], [gel(3.0, None); 2]];
        let motion = LiftMotion { frames };
        let values = motion.to_values();
        assert_eq!(values.len(), 2 * 2 * GelMotion::LEN);
        assert_eq!(LiftMotion::from_values(&values), Some(motion));
        let empty = LiftMotion::default();
        assert_eq!(LiftMotion::from_values(&empty.to_values()), Some(empty));
        assert_eq!(LiftMotion::from_values(&values[1..]), None);
        assert_eq!(LiftMotion::from_values(&values[GelMotion::LEN..]), None);
        assert_eq!(LiftMotion::from_values(&[0.0; LiftMotion::LEN + 16]), None);
        let padded = [values.as_slice(), &[f64::NAN; 16]].concat();
        assert_eq!(LiftMotion::from_values(&padded).unwrap().frames.len(), 2);
        let mut damaged = values;
        damaged[2] = f64::INFINITY;
        assert_eq!(LiftMotion::from_values(&damaged), None);
    }
}
