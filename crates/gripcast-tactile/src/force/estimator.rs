//! The force on the gel of one sensor.

use image::RgbImage;

use super::calibration::ForceCalibration;
use super::features::ForceSensor;
use super::model::{ForceModel, POISSON};
use crate::profile::SensorProfile;
use gripcast_base::error::{Error, Result};
use gripcast_shear::{FingerForce, ShearFrame};
use gripcast_sim::fem::GelPad;

/// Standard deviation of the modulus of an uncalibrated gel, fraction: published moduli of the same
/// gel differ by a factor of two.
const UNCALIBRATED_FRACTION: f64 = 0.5;
/// Maximum difference of a gel's size from that of a GelSight Mini, fraction.
const MAX_OTHER_SIZE: f64 = 0.1;

/// Estimates the force on one gel.
#[derive(Clone, Debug)]
pub struct ForceEstimator {
    sensor: ForceSensor,
    model: ForceModel,
    /// Young's modulus and its relative standard deviation, Pa and fraction.
    young_pa: [f64; 2],
    poisson: f64,
    is_calibrated: bool,
}

impl ForceEstimator {
    /// Prepares the sensor of a profile; without a calibration, with the profile's gel.
    ///
    /// # Errors
    /// `Config` if the profile is invalid, its gel is not as large as that of a GelSight Mini, or the
    /// calibration is of another profile.
    pub fn new(profile: &SensorProfile, calibration: Option<&ForceCalibration>) -> Result<Self> {
        let (found, usual) = (profile.pad().box_m(), GelPad::default().box_m());
        let is_other = |(a, b): (&f64, &f64)| (a / b - 1.0).abs() > MAX_OTHER_SIZE;
        if found.iter().zip(&usual).any(is_other) {
            let mm = |size: [f64; 3]| size.map(|m| format!("{:.1}", 1e3 * m)).join(" × ");
            return Err(Error::config(format!(
                "the force model is for gels of {} mm, the sensor profile `{}` has one of {} mm",
                mm(usual),
                profile.name,
                mm(found)
            )));
        }
        if let Some(calibration) = calibration
            && calibration.sensor_profile != profile.name
        {
            return Err(Error::config(format!(
                "the force calibration is for the sensor profile `{}`, the sensor has `{}`",
                calibration.sensor_profile, profile.name
            ))
            .remedy("run `gripcast calibrate force` with the rig's profile"));
        }
        let [low, high] = POISSON;
        let (young_pa, poisson) = match calibration {
            Some(found) => ([found.young_pa, found.std_fraction], found.poisson),
            None => {
                let gel = &profile.gel;
                let poisson = gel.poisson.clamp(low, high);
                ([gel.young_pa, UNCALIBRATED_FRACTION], poisson)
            }
        };
        Ok(Self {
            sensor: ForceSensor::new(profile)?,
            model: ForceModel::shipped()?,
            young_pa,
            poisson,
            is_calibrated: calibration.is_some(),
        })
    }

    /// Whether known weights calibrated the sensor.
    #[must_use]
    pub fn is_calibrated(&self) -> bool {
        self.is_calibrated
    }

    /// Force on the gel in `now`, against the untouched gel; `shear` was measured on the same image.
    ///
    /// # Errors
    /// `Input` for an image of another size than the sensor's.
    pub fn estimate(
        &self,
        initial: &RgbImage,
        now: &RgbImage,
        shear: &ShearFrame,
    ) -> Result<FingerForce> {
        let (features, motion) = self.sensor.features(initial, now, shear)?;
        let [young_pa, std_fraction] = self.young_pa;
        let scale_n = young_pa * self.sensor.thickness_m().powi(2);
        let normal = self.model.normal(&features, self.poisson);
        let with_modulus = |value_n: f64, std: f64| (scale_n * std).hypot(std_fraction * value_n);
        let normal_n = scale_n * normal.value;
        let shear = motion.map(|motion| self.model.shear(&motion, &features, self.poisson));
        let shear_n = shear.map(|shear| shear.value.map(|value| scale_n * value));
        Ok(FingerForce {
            normal_n,
            normal_std_n: with_modulus(normal_n, normal.std),
            shear_n,
            shear_std_n: shear
                .zip(shear_n)
                .map(|(shear, [x, y])| with_modulus(x.hypot(y), shear.std)),
            is_calibrated: self.is_calibrated,
        })
    }
}
