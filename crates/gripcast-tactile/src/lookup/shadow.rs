//! Shadows of the LEDs beside the pad, ray-marched over the height map.

use crate::gaussian::{Gaussian, Region};
use crate::press_depth::SensorGeometry;

/// Directions to the red, green and blue LED in the image, from the column axis towards the row
/// axis: 120° apart, red at the top. These values are a guess, not a measurement.
const AZIMUTHS_DEG: [f64; 3] = [-90.0, 30.0, 150.0];
/// Slope of the light rays over the gel, m/m: a 1 mm edge casts a 2 mm shadow.
const RISE: f64 = 0.5;
/// Fraction of a channel's light that comes from its LED.
const LED_FRACTION: f64 = 0.35;
/// Maximum length of a shadow, m.
const REACH_M: f64 = 3e-3;
/// Standard deviation of the filter that softens shadows, m.
const SOFTNESS_M: f64 = 6e-5;

/// Returns the transmitted fraction of each channel's light, row-major.
pub(super) fn transmitted_light(heights_m: &[f32], grid: &SensorGeometry) -> [Vec<f32>; 3] {
    AZIMUTHS_DEG.map(|azimuth| {
        let mut shade = shade(f64::to_radians(azimuth), heights_m, grid);
        if let Some(region) = Region::nonzero(&shade, grid.width) {
            Gaussian::new(SOFTNESS_M / grid.pixel_m).apply(&mut shade, grid.width, region);
        }
        shade
            .iter()
            .map(|s| 1.0 - LED_FRACTION as f32 * s)
            .collect()
    })
}

/// Returns 1 where something on the way to the LED occludes its light.
fn shade(azimuth_rad: f64, heights_m: &[f32], grid: &SensorGeometry) -> Vec<f32> {
    let top = heights_m.iter().copied().fold(0.0, f32::max);
    let (sin, cos) = azimuth_rad.sin_cos();
    let rise = (RISE * grid.pixel_m) as f32;
    let longest = (REACH_M / grid.pixel_m) as usize;
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
        let shade = shade(std::f64::consts::PI, &heights, &grid);
        let row = &shade[600..660];
        for (column, shade) in row.iter().enumerate() {
            // The light rises 0.05 mm a column: nine columns behind the plateau lie below it.
            let expected = if (30..39).contains(&column) { 1.0 } else { 0.0 };
            assert_eq!(*shade, expected, "{column}");
        }
    }
}
