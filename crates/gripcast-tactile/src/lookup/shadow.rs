//! Shadows of the LEDs beside the pad, ray-marched over the height map.

use crate::gaussian::{Gaussian, Region};
use crate::press_depth::SensorGeometry;

/// A distant LED with parallel light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShadowLamp {
    /// Channel lit by the LED: 0 red, 1 green, 2 blue.
    pub channel: usize,
    /// Direction to the LED in the image, from the column axis towards the row axis, rad.
    pub azimuth_rad: f64,
    /// Slope of the light rays over the gel, m/m.
    pub rise: f64,
    /// Fraction of the channel's light that comes from the LED.
    pub fraction: f64,
}

/// LEDs and softness of their shadows.
#[derive(Clone, Debug, PartialEq)]
pub struct Shadows {
    /// LEDs.
    pub lamps: Vec<ShadowLamp>,
    /// Maximum length of a shadow, m.
    pub reach_m: f64,
    /// Standard deviation of the filter that softens shadows, m.
    pub softness_m: f64,
}

impl Default for Shadows {
    /// Red, green and blue LEDs at 120°, red at the top of the image, low enough for a 1 mm edge to
    /// cast a 2 mm shadow. A guess, not a measurement.
    fn default() -> Self {
        let lamp = |channel, degrees: f64| ShadowLamp {
            channel,
            azimuth_rad: degrees.to_radians(),
            rise: 0.5,
            fraction: 0.35,
        };
        Self {
            lamps: vec![lamp(0, -90.0), lamp(1, 30.0), lamp(2, 150.0)],
            reach_m: 3e-3,
            softness_m: 6e-5,
        }
    }
}

impl Shadows {
    /// Returns the transmitted fraction of each channel's light, row-major.
    pub(super) fn light(&self, heights_m: &[f32], grid: &SensorGeometry) -> [Vec<f32>; 3] {
        let mut light = [0; 3].map(|_| vec![1.0; heights_m.len()]);
        for lamp in &self.lamps {
            let Some(plane) = light.get_mut(lamp.channel) else {
                continue;
            };
            let mut shade = self.shade(lamp, heights_m, grid);
            if let Some(region) = Region::nonzero(&shade, grid.width) {
                let softness = self.softness_m / grid.pixel_m;
                Gaussian::new(softness).apply(&mut shade, grid.width, region);
            }
            for (light, shade) in plane.iter_mut().zip(shade) {
                *light *= 1.0 - lamp.fraction as f32 * shade;
            }
        }
        light
    }

    /// Returns 1 where something on the way to the LED occludes its light.
    fn shade(&self, lamp: &ShadowLamp, heights_m: &[f32], grid: &SensorGeometry) -> Vec<f32> {
        let top = heights_m.iter().copied().fold(0.0, f32::max);
        let (sin, cos) = lamp.azimuth_rad.sin_cos();
        let rise = (lamp.rise * grid.pixel_m) as f32;
        let longest = (self.reach_m / grid.pixel_m) as usize;
        let step_to = |start: usize, steps: usize, along: f64, side: usize| {
            let target = (start as f64 + steps as f64 * along).round();
            (target >= 0.0 && target < side as f64).then_some(target as usize)
        };
        let is_shaded = |pixel: usize| {
            let (column, row) = (pixel % grid.width, pixel / grid.width);
            let own = heights_m[pixel];
            for steps in 1..=longest {
                let light = own + steps as f32 * rise;
                if light >= top {
                    return false;
                }
                let towards = (
                    step_to(column, steps, cos, grid.width),
                    step_to(row, steps, sin, grid.height),
                );
                let (Some(x), Some(y)) = towards else {
                    return false;
                };
                if heights_m[y * grid.width + x] > light {
                    return true;
                }
            }
            false
        };
        (0..heights_m.len())
            .map(|pixel| f32::from(u8::from(is_shaded(pixel))))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_casts_shadow_away_from_led() {
        let grid = SensorGeometry {
            width: 60,
            height: 20,
            pixel_m: 1e-4,
            gel_thickness_m: 4e-3,
        };
        // A plateau of 0.49 mm over columns 20 to 29.
        let heights: Vec<f32> = (0..1200)
            .map(|i| {
                if (20..30).contains(&(i % 60)) {
                    4.9e-4
                } else {
                    0.0
                }
            })
            .collect();
        let shadows = Shadows {
            lamps: vec![ShadowLamp {
                channel: 1,
                azimuth_rad: std::f64::consts::PI,
                rise: 0.5,
                fraction: 0.4,
            }],
            reach_m: 5e-3,
            softness_m: 0.0,
        };
        let [red, green, _] = shadows.light(&heights, &grid);
        assert!(red.iter().all(|light| *light == 1.0));
        let row = &green[600..660];
        for (column, light) in row.iter().enumerate() {
            // The light rises 0.05 mm a column: nine columns behind the plateau lie below it.
            let expected = if (30..39).contains(&column) { 0.6 } else { 1.0 };
            assert!((light - expected).abs() < 1e-6, "{column}: {light}");
        }
    }
}
