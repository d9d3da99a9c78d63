//! What of a tactile image depends on the force.

use image::RgbImage;

use super::relief::{Relief, ReliefSensor};
use crate::profile::SensorProfile;
use gripcast_base::error::Result;
use gripcast_base::statistics::quantile;
use gripcast_shear::{MarkerField, ShearFrame, ShearSource};

/// Depth from which the skin counts as pressed in, m: above the noise of the relief.
const MIN_DEPTH_M: f32 = 2e-5;
/// Depth of the deep part of a contact, m.
const DEEP_M: f32 = 1e-4;
/// Fraction of the cells that are not deeper than the depth of a contact.
const DEPTH_FRACTION: f64 = 0.995;

/// Features of a press, in units of the gel's thickness h. All numbers grow with the load.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ForceFeatures {
    /// ∫ u dA / h³ of the depth u.
    pub volume: f64,
    /// ∫ u² dA / h⁴.
    pub square: f64,
    /// ∫ u³ dA / h⁵.
    pub cube: f64,
    /// ∫ |∇u| dA / h².
    pub slope: f64,
    /// ∫ |∇u|² dA / h².
    pub bending: f64,
    /// Area that is pressed in / h².
    pub area: f64,
    /// Area that is pressed in by more than 0.1 mm / h².
    pub deep_area: f64,
    /// Depth of the deepest cells / h.
    pub depth: f64,
    /// Whether the gel has markers: such a sensor sees more of its gel, in less detail.
    pub has_markers: bool,
}

impl ForceFeatures {
    /// The numbers as an array, in the order of the fields.
    #[must_use]
    pub fn to_array(self) -> [f64; 8] {
        [
            self.volume,
            self.square,
            self.cube,
            self.slope,
            self.bending,
            self.area,
            self.deep_area,
            self.depth,
        ]
    }

    fn of(relief: &Relief, thickness_m: f64, has_markers: bool) -> Self {
        let mut sums = Self::default();
        for (depth, slope) in relief.depth_m.iter().zip(&relief.slope) {
            let slope = f64::from(*slope);
            sums.slope += slope;
            sums.bending += slope * slope;
            if *depth < MIN_DEPTH_M {
                continue;
            }
            let depth_h = f64::from(*depth) / thickness_m;
            sums.volume += depth_h;
            sums.square += depth_h * depth_h;
            sums.cube += depth_h.powi(3);
            sums.area += 1.0;
            sums.deep_area += f64::from(u8::from(*depth > DEEP_M));
        }
        let mut sorted: Vec<f64> = relief.depth_m.iter().map(|d| f64::from(*d)).collect();
        sorted.sort_by(f64::total_cmp);
        let deepest = quantile(&sorted, DEPTH_FRACTION).unwrap_or_default();
        let cell_h2 = relief.cell_m2 / (thickness_m * thickness_m);
        Self {
            volume: cell_h2 * sums.volume,
            square: cell_h2 * sums.square,
            cube: cell_h2 * sums.cube,
            slope: cell_h2 * sums.slope,
            bending: cell_h2 * sums.bending,
            area: cell_h2 * sums.area,
            deep_area: cell_h2 * sums.deep_area,
            depth: deepest.max(0.0) / thickness_m,
            has_markers,
        }
    }
}

/// How far the skin moved along the face, in units of the gel's thickness h; x and y of the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkinMotion {
    /// What it was measured on.
    pub source: ShearSource,
    /// ∫ u dA / h³ of the displacement u of gel markers; for texture, the displacement of the
    /// contact / h.
    pub motion: [f64; 2],
}

impl SkinMotion {
    fn of(shear: &ShearFrame, thickness_m: f64) -> Option<Self> {
        let summary = shear.summary?;
        match (&shear.field, summary.source) {
            (Some(field), ShearSource::Markers) => Some(Self {
                source: ShearSource::Markers,
                motion: marker_motion(field, thickness_m)?,
            }),
            (_, ShearSource::Texture) => Some(Self {
                source: ShearSource::Texture,
                motion: summary
                    .mean_displacement_mm
                    .map(|mm| 1e-3 * mm / thickness_m),
            }),
            (None, ShearSource::Markers) => None,
        }
    }
}

/// ∫ u dA / h³: the sum over the gel markers, each for the area of its cell.
fn marker_motion(field: &MarkerField, thickness_m: f64) -> Option<[f64; 2]> {
    let pitch_px = field.pitch_px()?;
    let scale_h = field.m_per_px / thickness_m;
    let area_h2 = f64::from(pitch_px[0]) * f64::from(pitch_px[1]) * scale_h * scale_h;
    let mut sum = [0.0; 2];
    for marker in field
        .markers
        .iter()
        .flatten()
        .filter(|m| m.confidence > 0.0)
    {
        for (sum, moved) in sum.iter_mut().zip(marker.displacement_px()) {
            *sum += area_h2 * scale_h * f64::from(moved);
        }
    }
    Some(sum)
}

/// Measures the features of one sensor's images.
#[derive(Clone, Debug)]
pub struct ForceSensor {
    relief: ReliefSensor,
    thickness_m: f64,
    has_markers: bool,
}

impl ForceSensor {
    /// Prepares the sensor of a profile.
    ///
    /// # Errors
    /// `Config` if the profile is invalid.
    pub fn new(profile: &SensorProfile) -> Result<Self> {
        Ok(Self {
            relief: ReliefSensor::new(profile)?,
            thickness_m: profile.geometry.gel_thickness_m,
            has_markers: profile.markers.is_some(),
        })
    }

    /// Thickness h of the gel, m.
    pub fn thickness_m(&self) -> f64 {
        self.thickness_m
    }

    /// Features of `now` against the untouched gel, and the motion of the skin where `shear`
    /// (measured on the same image) has one.
    ///
    /// # Errors
    /// `Input` for an image of another size than the sensor's.
    pub fn features(
        &self,
        initial: &RgbImage,
        now: &RgbImage,
        shear: &ShearFrame,
    ) -> Result<(ForceFeatures, Option<SkinMotion>)> {
        let relief = self.relief.relief(initial, now, shear.field.as_ref())?;
        let features = ForceFeatures::of(&relief, self.thickness_m, self.has_markers);
        Ok((features, SkinMotion::of(shear, self.thickness_m)))
    }
}
