//! Height map of Taxim (Si & Yuan 2022, §III-B): the gel around a contact, as a pyramid of
//! Gaussian filters that each put the object's own shape back where it is pressed deep.

use serde::Deserialize;

use crate::gaussian::{Gaussian, Region};
use crate::press_depth::PressDepth;
use gripcast_base::error::{Error, ErrorKind, Result};

/// Parameters of the height map, in pixels of Taxim's picture; and that picture.
#[derive(Clone, Debug, PartialEq)]
pub struct TaximHeights {
    /// Size of a pixel of Taxim's picture, m.
    pub pixel_m: f64,
    /// Columns and rows of Taxim's picture.
    pub image_size: [usize; 2],
    /// Standard deviations of the filters of the pyramid, in order, pixels.
    pub pyramid_px: Vec<f64>,
    /// Standard deviation of the filter that ends it, pixels.
    pub last_px: f64,
    /// Where the press is deeper than this share of its deepest point, the object's shape is put
    /// back.
    pub kept_share: f64,
}

impl Default for TaximHeights {
    /// The published ones, of kernels of 201, 101, 51, 21, 11 and 5 pixels and a last one of 5, on
    /// pictures of 640 × 480 at 0.0295 mm.
    fn default() -> Self {
        Self {
            pixel_m: 2.95e-5,
            image_size: [640, 480],
            pyramid_px: vec![30.5, 15.5, 8.0, 3.5, 2.0, 1.1],
            last_px: 1.1,
            kept_share: 0.4,
        }
    }
}

impl TaximHeights {
    /// The parameters of a calibration of PyPI's `taxim` (`params.json`).
    ///
    /// # Errors
    /// `Input` where the text is no such file or a value cannot be computed with.
    pub fn from_json(text: &str) -> Result<Self> {
        let file: ParamsFile = serde_json::from_str(text).map_err(|cause| {
            Error::new(ErrorKind::Input, "these are no parameters of Taxim").because(cause)
        })?;
        let ParamsFile { sensor, simulator } = file;
        // Sigmas are shares of the width, then of the height; both give the same in pixels.
        let width = sensor.w as f64;
        let heights = Self {
            pixel_m: sensor.pixmm * 1e-3,
            image_size: [sensor.w, sensor.h],
            pyramid_px: simulator.deform_pyramid_sigma_rel[0]
                .iter()
                .map(|share| share * width)
                .collect(),
            last_px: simulator.deform_final_sigma_rel[0] * width,
            kept_share: simulator.contact_scale,
        };
        heights.validate()?;
        Ok(heights)
    }

    fn validate(&self) -> Result<()> {
        let sigmas = self.pyramid_px.iter().chain([&self.last_px]);
        let is_fine = self.pixel_m > 0.0
            && self.pixel_m.is_finite()
            && self.image_size.iter().all(|side| *side > 0)
            && sigmas.into_iter().all(|s| (0.0..1000.0).contains(s))
            && self.kept_share.is_finite();
        if is_fine {
            Ok(())
        } else {
            Err(Error::new(
                ErrorKind::Input,
                format!("these parameters of Taxim cannot be computed with: {self:?}"),
            ))
        }
    }

    /// Height of the face towards the camera under each pixel, m.
    pub(super) fn heights(&self, press: &PressDepth) -> Vec<f32> {
        let grid = &press.geometry;
        let own_pixels = self.pixel_m / grid.pixel_m;
        let kept = (self.kept_share * press.deepest_m()) as f32;
        let mut heights = press.depth_m.clone();
        let Some(mut region) = Region::of_nonzero(&heights, grid.width) else {
            return heights;
        };
        for sigma in &self.pyramid_px {
            region = Gaussian::new(sigma * own_pixels).apply(&mut heights, grid.width, region);
            for (height, depth) in heights.iter_mut().zip(&press.depth_m) {
                if *depth > kept {
                    *height = *depth;
                }
            }
        }
        Gaussian::new(self.last_px * own_pixels).apply(&mut heights, grid.width, region);
        heights
    }
}

#[derive(Deserialize)]
struct ParamsFile {
    simulator: SimulatorParams,
    sensor: SensorParams,
}

#[derive(Deserialize)]
struct SimulatorParams {
    contact_scale: f64,
    deform_pyramid_sigma_rel: [Vec<f64>; 2],
    deform_final_sigma_rel: [f64; 2],
}

#[derive(Deserialize)]
struct SensorParams {
    pixmm: f64,
    h: usize,
    w: usize,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::press_depth::SensorGeometry;

    fn bump() -> PressDepth {
        let geometry = SensorGeometry {
            width: 80,
            height: 60,
            pixel_m: 6e-5,
            gel_thickness_m: 4e-3,
        };
        let depth = |i: usize| {
            let (x, y) = ((i % 80) as f32 - 40.0, (i / 80) as f32 - 30.0);
            if x * x + y * y < 144.0 { 1e-3 } else { 0.0 }
        };
        PressDepth {
            geometry,
            depth_m: (0..4800).map(depth).collect(),
        }
    }

    #[test]
    fn the_gel_rises_around_the_contact_and_keeps_it() {
        let press = bump();
        let heights = TaximHeights::default().heights(&press);
        let at = |x: usize, y: usize| heights[y * 80 + x];
        assert!((at(40, 30) - 1e-3).abs() < 1e-6, "{}", at(40, 30));
        let beside = [54, 58, 64, 72].map(|x| at(x, 30));
        assert!(beside.windows(2).all(|w| w[0] > w[1]), "{beside:?}");
        assert!(beside[0] > 1e-4 && beside[3] > 0.0);
        let untouched = PressDepth::untouched(press.geometry);
        assert_eq!(
            TaximHeights::default().heights(&untouched),
            untouched.depth_m
        );
    }

    #[test]
    fn published_parameters_are_read() {
        let text = r#"{"simulator": {"contact_scale": 0.4,
            "deform_pyramid_sigma_rel": [[0.04765625, 0.003125], [0.0635, 0.00417]],
            "deform_final_sigma_rel": [0.003125, 0.00417], "fan_angle": 0.1},
            "sensor": {"pixmm": 0.0295, "num_bins": 125, "h": 480, "w": 640}}"#;
        let heights = TaximHeights::from_json(text).unwrap();
        assert_eq!(heights.pyramid_px, [30.5, 2.0]);
        assert_eq!((heights.last_px, heights.kept_share), (2.0, 0.4));
        assert!((heights.pixel_m - 2.95e-5).abs() < 1e-18);
        assert!(TaximHeights::from_json("{}").is_err());
        assert!(TaximHeights::from_json(&text.replace("0.0295", "0.0")).is_err());
    }
}
