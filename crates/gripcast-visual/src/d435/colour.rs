//! Model of the colour camera: linear light to 8-bit images.

use image::RgbImage;
use rayon::prelude::*;

use crate::linear_image::{Image, luminance};
use gripcast_base::random::gaussians;
use gripcast_imaging::srgb_encode;

/// Exposure, lens and sensor of the colour camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColourSettings {
    /// Target mean of the automatic exposure, 8-bit levels; usually 100 to 120.
    pub target_mean: f64,
    /// Strength of the automatic white balance towards a grey mean, 0 to 1.
    pub white_balance: f32,
    /// Vignetting: fraction of the light lost in the corners.
    pub vignette: f32,
    /// Standard deviation of the lens blur, image pixels.
    pub blur_px: f32,
    /// Full-well capacity of a pixel, electrons: smaller means more shot noise. A pixel of the 1/6"
    /// sensor holds about 5000 at gain 1; indoor gains of 2 to 8 divide that, pixels averaged from
    /// n × n multiply it by n².
    pub full_well_e: f32,
    /// Standard deviation of the read noise, electrons.
    pub read_noise_e: f32,
    /// Colour saturation factor; 1 leaves colours unchanged.
    pub saturation: f32,
}

impl Default for ColourSettings {
    /// Indoors at moderate gain; 320 × 240 pixels averaged from 3 × 3 each.
    fn default() -> Self {
        Self {
            target_mean: 110.0,
            white_balance: 0.6,
            vignette: 0.18,
            blur_px: 0.45,
            full_well_e: 9.0 * 1500.0,
            read_noise_e: 3.0 * 4.0,
            saturation: 1.08,
        }
    }
}

impl ColourSettings {
    /// Exposure and white balance of the default, without blur and noise of a sensor.
    #[must_use]
    pub fn without_sensor() -> Self {
        Self {
            blur_px: 0.0,
            full_well_e: 1e9,
            read_noise_e: 0.0,
            ..Self::default()
        }
    }
}

/// Range of the exposure search, stops around a mean of 18 %.
const EXPOSURE_RANGE_STOPS: f32 = 12.0;
/// Bisection steps: to 1/700 of a stop.
const EXPOSURE_STEPS: u32 = 14;

/// Simulates the colour camera: returns its 8-bit sRGB image of linear light. The result depends on
/// the arguments alone.
pub fn develop(light: &Image, settings: &ColourSettings, seed: u64) -> RgbImage {
    let mut image = sanitised(light);
    vignette(&mut image, settings.vignette);
    blur(&mut image, settings.blur_px);
    let balance = white_balance(&image, settings.white_balance);
    let gain = exposure(&image, balance, settings);
    let (full_well, read) = (
        settings.full_well_e.max(1.0),
        settings.read_noise_e.max(0.0),
    );
    let pixels: Vec<[u8; 3]> = image
        .pixels
        .par_iter()
        .enumerate()
        .map(|(index, light)| {
            let item = 2 * index as u64;
            let [a, b] = gaussians(seed, item);
            let [c, _] = gaussians(seed, item + 1);
            let noise = [a, b, c];
            let measured = std::array::from_fn(|k| {
                // The white balance amplifies the measured signal including its noise.
                let electrons = (light[k] * gain * full_well).min(full_well);
                let deviation = (electrons + read * read).sqrt();
                (electrons + deviation * noise[k]) / full_well * balance[k]
            });
            tone_mapped(measured, settings.saturation).map(srgb_encode)
        })
        .collect();
    let (width, height) = (image.width as u32, image.height as u32);
    RgbImage::from_raw(width, height, pixels.into_flattened()).unwrap_or_default()
}

/// Replaces negative, infinite and NaN values by 0.
fn sanitised(light: &Image) -> Image {
    let mut image = light.clone();
    for value in image.pixels.iter_mut().flatten() {
        *value = if value.is_finite() {
            value.max(0.0)
        } else {
            0.0
        };
    }
    image
}

/// Applies vignetting proportional to the squared distance from the centre.
fn vignette(image: &mut Image, fraction: f32) {
    let (width, height) = (image.width as f32, image.height as f32);
    let corner = width * width + height * height;
    for (row, pixels) in image.pixels.chunks_mut(image.width.max(1)).enumerate() {
        for (column, pixel) in pixels.iter_mut().enumerate() {
            let x = 2.0 * column as f32 + 1.0 - width;
            let y = 2.0 * row as f32 + 1.0 - height;
            let factor = 1.0 - fraction * (x * x + y * y) / corner;
            *pixel = pixel.map(|v| v * factor);
        }
    }
}

/// Separable Gaussian blur with replicated border.
fn blur(image: &mut Image, sigma: f32) {
    if sigma.is_nan() || sigma < 0.05 {
        return;
    }
    let reach = (3.0 * sigma).ceil().min(64.0) as isize;
    let weights: Vec<f32> = (-reach..=reach)
        .map(|k| (-0.5 * (k as f32 / sigma).powi(2)).exp())
        .collect();
    let total: f32 = weights.iter().sum();
    let (width, height) = (image.width as isize, image.height as isize);
    for (dx, dy) in [(1, 0), (0, 1)] {
        let source = image.pixels.clone();
        let sum_at = |index: usize| {
            let (x, y) = (index as isize % width, index as isize / width);
            let mut sum = [0.0; 3];
            for (k, weight) in (-reach..=reach).zip(&weights) {
                let column = (x + dx * k).clamp(0, width - 1);
                let row = (y + dy * k).clamp(0, height - 1);
                let pixel = source[(row * width + column) as usize];
                for (sum, value) in sum.iter_mut().zip(pixel) {
                    *sum += weight * value;
                }
            }
            sum.map(|v| v / total)
        };
        image
            .pixels
            .par_iter_mut()
            .enumerate()
            .for_each(|(index, pixel)| *pixel = sum_at(index));
    }
}

/// Grey-world gains of the channels from pixels between the 5 % and 95 % luminance quantiles,
/// raised to the power `fraction`; the gain of green is 1.
fn white_balance(image: &Image, fraction: f32) -> [f32; 3] {
    let mut levels: Vec<f32> = image.pixels.iter().map(|p| luminance(*p)).collect();
    levels.sort_unstable_by(f32::total_cmp);
    let quantile = |q: f64| levels.get((q * levels.len() as f64) as usize).copied();
    let (low, high) = (quantile(0.05).unwrap_or(0.0), quantile(0.95).unwrap_or(0.0));
    let mut sum = [0.0_f64; 3];
    for pixel in &image.pixels {
        if (low..=high).contains(&luminance(*pixel)) {
            for (sum, value) in sum.iter_mut().zip(pixel) {
                *sum += f64::from(*value);
            }
        }
    }
    let gain = |k: usize| ((sum[1] / sum[k]) as f32).clamp(0.25, 4.0).powf(fraction);
    if sum.iter().all(|s| *s > 0.0) {
        [gain(0), 1.0, gain(2)]
    } else {
        [1.0; 3]
    }
}

/// Returns the gain at which the mean of the noise-free developed image is the target.
fn exposure(image: &Image, balance: [f32; 3], settings: &ColourSettings) -> f32 {
    let mean = image
        .pixels
        .iter()
        .map(|p| f64::from(luminance(*p)))
        .sum::<f64>()
        / image.pixels.len().max(1) as f64;
    if mean.is_nan() || mean <= 0.0 {
        return 1.0;
    }
    let middle = (0.18 / mean) as f32;
    // Every fifth pixel is enough for the mean.
    let sample: Vec<[f32; 3]> = image.pixels.iter().step_by(5).copied().collect();
    let developed_mean = |gain: f32| {
        let sum: f64 = sample
            .iter()
            .map(|p| {
                let measured = std::array::from_fn(|k| (p[k] * gain).min(1.0) * balance[k]);
                let [r, g, b] = tone_mapped(measured, settings.saturation).map(srgb_encode);
                0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b)
            })
            .sum();
        sum / sample.len().max(1) as f64
    };
    let (mut low, mut high) = (-EXPOSURE_RANGE_STOPS, EXPOSURE_RANGE_STOPS);
    for _ in 0..EXPOSURE_STEPS {
        let stops = 0.5 * (low + high);
        if developed_mean(middle * stops.exp2()) < settings.target_mean {
            low = stops;
        } else {
            high = stops;
        }
    }
    middle * (0.5 * (low + high)).exp2()
}

/// Applies saturation and a soft highlight shoulder to linear values.
fn tone_mapped(light: [f32; 3], saturation: f32) -> [f32; 3] {
    let grey = luminance(light);
    light.map(|v| {
        let v = (grey + saturation * (v - grey)).max(0.0);
        // Linear up to 0.7, then approaching 1.
        if v < 0.7 {
            v
        } else {
            0.7 + 0.3 * (1.0 - (-(v - 0.7) / 0.3).exp())
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn statistics(image: &RgbImage, channel: usize) -> (f64, f64) {
        let n = f64::from(image.width() * image.height());
        let values = image.pixels().map(|p| f64::from(p[channel]));
        let mean = values.clone().sum::<f64>() / n;
        let variance = values.map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        (mean, variance.sqrt())
    }

    fn flat() -> ColourSettings {
        ColourSettings {
            vignette: 0.0,
            ..ColourSettings::default()
        }
    }

    #[test]
    fn exposure_reaches_target_at_any_light_level() {
        for level in [1e-3, 1.0, 500.0] {
            let mut light = Image::filled(80, 60, [level, 0.8 * level, 0.6 * level]);
            for pixel in light.pixels.iter_mut().step_by(7) {
                *pixel = pixel.map(|v| 0.2 * v);
            }
            let image = develop(&light, &ColourSettings::default(), 1);
            let mean = (0..3).map(|c| statistics(&image, c).0).sum::<f64>() / 3.0;
            assert!((mean - 110.0).abs() < 4.0, "{level}: {mean}");
        }
    }

    #[test]
    fn noise_matches_electron_count() {
        let light = Image::filled(200, 150, [0.5; 3]);
        let settings = ColourSettings {
            blur_px: 0.0,
            saturation: 1.0,
            ..flat()
        };
        for full_well in [1500.0_f32, 13_500.0] {
            let settings = ColourSettings {
                full_well_e: full_well,
                ..settings
            };
            let (mean, deviation) = statistics(&develop(&light, &settings, 3), 1);
            assert!((mean - 110.0).abs() < 1.5, "{mean}");
            // 110 of 255 is 0.156 linear; there the transfer function has a slope of 365 levels.
            let electrons = 0.156 * f64::from(full_well);
            let expected = 365.0 * (electrons + 144.0).sqrt() / f64::from(full_well);
            assert!(
                (deviation / expected - 1.0).abs() < 0.1,
                "{deviation} {expected}"
            );
        }
    }

    #[test]
    fn white_balance_corrects_warm_light_partially() {
        let light = Image::filled(40, 30, [1.4, 1.0, 0.5]);
        let ratio = |fraction: f32| {
            let settings = ColourSettings {
                white_balance: fraction,
                ..flat()
            };
            let image = develop(&light, &settings, 0);
            statistics(&image, 0).0 / statistics(&image, 2).0
        };
        assert!(ratio(0.0) > ratio(0.5) && ratio(0.5) > ratio(1.0));
        assert!((ratio(1.0) - 1.0).abs() < 0.02, "{}", ratio(1.0));
    }

    #[test]
    fn vignette_and_blur_are_applied() {
        let light = Image::filled(64, 48, [0.3; 3]);
        let image = develop(&light, &ColourSettings::default(), 5);
        let mean = |x: u32, y: u32| {
            let block = (0..64).map(|k| f64::from(image.get_pixel(x + k % 8, y + k / 8)[1]));
            block.sum::<f64>() / 64.0
        };
        assert!(mean(0, 0) < mean(28, 20) - 3.0);
        let mut edge = Image::filled(9, 1, [0.0; 3]);
        edge.pixels[5..].fill([1.0; 3]);
        blur(&mut edge, 0.6);
        assert!(edge.pixels[4][0] > 0.05 && edge.pixels[5][0] < 0.95);
        assert!((edge.pixels[4][0] + edge.pixels[5][0] - 1.0).abs() < 1e-6);
    }

    #[test]
    fn result_depends_on_seed_and_tolerates_nan() {
        let mut light = Image::filled(16, 16, [0.2, 0.3, 0.4]);
        light.pixels[3] = [f32::NAN, f32::INFINITY, -1.0];
        let once = develop(&light, &ColourSettings::default(), 9);
        assert_eq!(once, develop(&light, &ColourSettings::default(), 9));
        assert_ne!(once, develop(&light, &ColourSettings::default(), 10));
        let dark = Image::filled(4, 4, [0.0; 3]);
        let (mean, _) = statistics(&develop(&dark, &ColourSettings::default(), 1), 1);
        assert!(mean < 20.0);
    }
}
