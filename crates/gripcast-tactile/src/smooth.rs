//! Shape of the gel face under a press.
//!
//! The gel sinks around the contact (see [`ball_sink_m`]); the finite bending radius of its coating
//! is approximated by a Gaussian.

use serde::{Deserialize, Serialize};

use super::gaussian::{Gaussian, Region};
use super::membrane::Membrane;
use super::press_depth::PressDepth;
use gripcast_base::error::{Error, Result};

/// Maximum length, pixels.
const MAX_PX: f64 = 200.0;

/// Parameters of the gel shape around a contact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Smoothing {
    /// Decay length of the indentation around a contact, m; 0 = none.
    pub sink_length_m: f64,
    /// Standard deviation of the Gaussian applied afterwards, m; 0 = none.
    pub sigma_m: f64,
}

impl Smoothing {
    /// Checks the lengths for a pixel size.
    ///
    /// # Errors
    /// `Config` with the key, the expected and the found value.
    pub fn validate(&self, pixel_m: f64) -> Result<()> {
        for (key, length_m) in [
            ("sink_length_m", self.sink_length_m),
            ("sigma_m", self.sigma_m),
        ] {
            let pixels = length_m / pixel_m;
            if !(0.0..=MAX_PX).contains(&pixels) {
                return Err(Error::config(format!(
                    "smoothing.{key} must be 0 to {MAX_PX} pixels (of {pixel_m} m), found \
                         {length_m} m = {pixels} pixels"
                )));
            }
        }
        Ok(())
    }
}

/// A [`Smoothing`] prepared for one pixel size.
#[derive(Clone, Debug)]
pub struct Smoother {
    membrane: Membrane,
    gaussian: Gaussian,
    height: Vec<f32>,
}

impl Smoother {
    /// Prepares the filters.
    pub fn new(smoothing: &Smoothing, pixel_m: f64) -> Self {
        Self {
            membrane: Membrane::new(smoothing.sink_length_m / pixel_m),
            gaussian: Gaussian::new(smoothing.sigma_m / pixel_m),
            height: Vec::new(),
        }
    }

    /// Returns the height of the face towards the camera, m, `width * height`.
    pub fn smooth(&mut self, press: &PressDepth) -> &[f32] {
        let width = press.geometry.width;
        self.height.clear();
        self.height.extend_from_slice(&press.depth_m);
        self.membrane.solve(&mut self.height, width);
        if let Some(region) = Region::nonzero(&self.height, width) {
            self.gaussian.apply(&mut self.height, width, region);
        }
        &self.height
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SensorGeometry;

    const SMOOTHING: Smoothing = Smoothing {
        sink_length_m: 1e-3,
        sigma_m: 2e-4,
    };

    fn ball() -> PressDepth {
        let geometry = SensorGeometry {
            width: 160,
            height: 120,
            pixel_m: 1e-4,
            gel_thickness_m: 4e-3,
        };
        let mut press = PressDepth::untouched(geometry);
        for (i, depth) in press.depth_m.iter_mut().enumerate() {
            let (x, y) = ((i % 160) as f32 - 80.0, (i / 160) as f32 - 60.0);
            *depth = (1e-6 * (400.0 - x * x - y * y)).max(0.0);
        }
        press
    }

    #[test]
    fn gel_sinks_around_contact_and_keeps_its_depth() {
        let press = ball();
        let (middle, outside) = (60 * 160 + 80, 60 * 160 + 80 + 30);
        let height = |smoothing: Smoothing| Smoother::new(&smoothing, 1e-4).smooth(&press).to_vec();
        let plain = height(Smoothing {
            sink_length_m: 0.0,
            ..SMOOTHING
        });
        let sunk = height(SMOOTHING);
        assert!(plain[outside] == 0.0 && sunk[outside] > 1e-6);
        assert!((plain[middle] - sunk[middle]).abs() < 1e-6);
    }

    #[test]
    fn no_contact_gives_flat_face() {
        let press = PressDepth::untouched(ball().geometry);
        let mut smoother = Smoother::new(&SMOOTHING, 1e-4);
        assert!(smoother.smooth(&press).iter().all(|h| *h == 0.0));
    }

    #[test]
    fn smoother_can_be_reused() {
        let press = ball();
        let mut smoother = Smoother::new(&SMOOTHING, 1e-4);
        let first = smoother.smooth(&press).to_vec();
        smoother.smooth(&PressDepth::untouched(press.geometry));
        assert_eq!(smoother.smooth(&press), first);
    }

    #[test]
    fn invalid_lengths_are_refused() {
        for sigma_m in [-1e-4, f64::NAN, 1.0] {
            let smoothing = Smoothing {
                sigma_m,
                ..SMOOTHING
            };
            assert!(smoothing.validate(5e-5).is_err(), "{smoothing:?}");
        }
        assert!(SMOOTHING.validate(5e-5).is_ok());
    }
}
