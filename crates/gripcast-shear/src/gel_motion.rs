//! What gels and wrist camera show while an object is lifted.

use gripcast_imaging::ObjectMotion;
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

/// What is seen at one moment of a lift.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LiftImage {
    /// Left and right gel.
    pub gels: [GelMotion; 2],
    /// Motion of the object since before the lift, as the wrist camera sees it; `None` where it is
    /// not measured.
    pub object: Option<ObjectMotion>,
}

impl From<[GelMotion; 2]> for LiftImage {
    fn from(gels: [GelMotion; 2]) -> Self {
        Self { gels, object: None }
    }
}

/// Images of one lift, the first taken before it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LiftMotion {
    /// The images.
    pub images: Vec<LiftImage>,
}

impl LiftMotion {
    /// Images of a simulated lift: before it and every 40 ms of the first 20 mm.
    pub const FRAMES: usize = 26;
    /// Largest number of values of [`LiftMotion::gel_values`].
    pub const LEN: usize = Self::FRAMES * 2 * GelMotion::LEN;

    /// Values of the gels in the first [`LiftMotion::FRAMES`] images.
    pub fn gel_values(&self) -> Vec<f64> {
        let gels = self.images.iter().take(Self::FRAMES).flat_map(|i| i.gels);
        gels.flat_map(|gel| gel.to_array()).collect()
    }

    /// Values of the object's motion in the same images; NaN where it is unknown. None if it is in
    /// all.
    pub fn object_values(&self) -> Option<Vec<f64>> {
        let images = self.images.iter().take(Self::FRAMES);
        let motions: Vec<Option<ObjectMotion>> = images.map(|image| image.object).collect();
        let is_known = motions.iter().any(Option::is_some);
        let unknown = [f64::NAN; ObjectMotion::LEN];
        let values = motions.into_iter();
        let values = values.flat_map(|motion| motion.map_or(unknown, ObjectMotion::to_array));
        is_known.then(|| values.collect())
    }

    /// The motion with the values of [`LiftMotion::object_values`]; none if they are not those of all
    /// images or one is infinite.
    pub fn with_object_values(mut self, values: &[f64]) -> Option<Self> {
        let (motions, rest) = values.as_chunks::<{ ObjectMotion::LEN }>();
        let is_whole = motions.len() == self.images.len() && rest.is_empty();
        if !is_whole || values.iter().any(|value| value.is_infinite()) {
            return None;
        }
        for (image, motion) in self.images.iter_mut().zip(motions) {
            let is_known = motion.iter().any(|value| !value.is_nan());
            image.object = is_known.then(|| ObjectMotion::from_array(*motion));
        }
        Some(self)
    }

    /// The motion of [`LiftMotion::gel_values`]; none for a number of values that is not that of
    /// whole images or too large, or if one other than a slip ratio is not finite. Images with a NaN
    /// level end the motion.
    pub fn from_gel_values(values: &[f64]) -> Option<Self> {
        let (gels, rest) = values.as_chunks::<{ GelMotion::LEN }>();
        let (pairs, single) = gels.as_chunks::<2>();
        if values.len() > Self::LEN || !rest.is_empty() || !single.is_empty() {
            return None;
        }
        let known = pairs.iter().take_while(|pair| !pair[0][0].is_nan());
        let images = known.map(|pair| LiftImage::from(pair.map(GelMotion::from_array)));
        let motion = Self {
            images: images.collect(),
        };
        motion.is_finite().then_some(motion)
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        let gels = self.images.iter().flat_map(|image| image.gels);
        let object = self.images.iter().filter_map(|image| image.object);
        gels.flat_map(|gel| {
            let slip_ratio = Some(gel.slip_ratio.unwrap_or_default());
            GelMotion { slip_ratio, ..gel }.to_array()
        })
        .all(f64::is_finite)
            && object
                .flat_map(ObjectMotion::to_array)
                .all(|drop_mm| !drop_mm.is_infinite())
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
        let gels = [[gel(4.0, Some(0.3)), gel(5.0, None)], [gel(3.0, None); 2]];
        let images = gels.map(LiftImage::from).to_vec();
        let motion = LiftMotion { images };
        let values = motion.gel_values();
        assert_eq!(values.len(), 2 * 2 * GelMotion::LEN);
        assert_eq!(LiftMotion::from_gel_values(&values), Some(motion));
        let empty = LiftMotion::default();
        assert_eq!(
            LiftMotion::from_gel_values(&empty.gel_values()),
            Some(empty)
        );
        assert_eq!(LiftMotion::from_gel_values(&values[1..]), None);
        assert_eq!(LiftMotion::from_gel_values(&values[GelMotion::LEN..]), None);
        assert_eq!(
            LiftMotion::from_gel_values(&[0.0; LiftMotion::LEN + 16]),
            None
        );
        let padded = [values.as_slice(), &[f64::NAN; 16]].concat();
        assert_eq!(
            LiftMotion::from_gel_values(&padded).unwrap().images.len(),
            2
        );
        let mut damaged = values;
        damaged[2] = f64::INFINITY;
        assert_eq!(LiftMotion::from_gel_values(&damaged), None);
    }

    #[test]
    fn motion_of_the_object_is_read_back() {
        let mut motion = LiftMotion {
            images: vec![LiftImage::default(); 3],
        };
        assert_eq!(motion.object_values(), None);
        motion.images[0].object = Some(ObjectMotion::NONE);
        motion.images[2].object = Some(ObjectMotion::from_array([0.5, f64::NAN, 1.5]));
        assert!(motion.is_finite());
        let values = motion.object_values().unwrap();
        let gels = LiftMotion::from_gel_values(&motion.gel_values()).unwrap();
        assert_eq!(gels.clone().with_object_values(&values), Some(motion));
        assert_eq!(gels.clone().with_object_values(&values[3..]), None);
        assert_eq!(gels.clone().with_object_values(&values[1..]), None);
        let mut damaged = values;
        damaged[0] = f64::INFINITY;
        assert_eq!(gels.with_object_values(&damaged), None);
    }
}
