//! Variation between sensors of a kind: LEDs, gel, camera.

use image::{Rgb, RgbImage, imageops};

use super::background::BackgroundFit;
use super::profile::{SensorProfile, ShadingModel};
use super::shading::PolynomialShading;
use gripcast_base::random::SeedStream;

/// Standard deviations between GelSight Minis at spread 1. The mean background colours of seven
/// units differ by 13, 8 and 14 % in red, green and blue; the other values are estimates.
const LIGHT_STD: f64 = 0.10;
const RESPONSE_STD: f64 = 0.12;
/// Maximum change of the background for each low-order term, grey levels.
const TINT_LEVELS: f64 = 6.0;
/// Largest shift of the gel markers, pitches (the gels of real sensors lie anywhere), and largest
/// rotation: 72 clips of real Minis have -0.8° to 0°.
const MARKER_SHIFT: f64 = 0.5;
const MARKER_TILT_DEG: f64 = 0.6;
/// Ranges of the factors on noise and smoothing.
const NOISE: [f64; 2] = [0.6, 2.0];
const SMOOTHING: [f64; 2] = [0.85, 1.25];

/// Difference of a sensor from that of a profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorVariation {
    /// Factor on the background in red, green, blue.
    pub light: [f64; 3],
    /// Factor on the slope response in red, green, blue.
    pub response: [f64; 3],
    /// Factor on the camera noise.
    pub noise: f64,
    /// Factor on the smoothing width.
    pub smoothing: f64,
    /// Whether the background is mirrored left to right.
    pub is_mirrored: bool,
    /// Added to the background, grey levels per channel: x, y, xy, 2x² − 1, 2y² − 1 with x and y in
    /// ±1 across columns and rows.
    pub tint: [[f64; 5]; 3],
    /// Shift of the gel markers along x and y, pitches.
    pub marker_shift: [f64; 2],
    /// Rotation of the lattice of gel markers, degrees.
    pub marker_tilt_deg: f64,
    /// What selects the gel: its markers' distances from their lattice; 0 is that of the profile.
    pub gel: u64,
}

impl SensorVariation {
    /// No variation.
    pub const NONE: Self = Self {
        light: [1.0; 3],
        response: [1.0; 3],
        noise: 1.0,
        smoothing: 1.0,
        is_mirrored: false,
        tint: [[0.0; 5]; 3],
        marker_shift: [0.0; 2],
        marker_tilt_deg: 0.0,
        gel: 0,
    };

    /// Samples a sensor; `spread` 0 gives [`Self::NONE`], 1 the spread of real sensors.
    #[must_use]
    pub fn sample(seed: u64, spread: f64) -> Self {
        let mut stream = SeedStream::named(seed, "tactile sensor");
        // The sum of three uniform numbers has standard deviation 1/2 and bounded support.
        let mut about_one = |std: f64| {
            let sum: f64 = (0..3).map(|_| stream.uniform()).sum();
            1.0 + spread * std * 2.0 * (sum - 1.5)
        };
        let light = [0; 3].map(|_| about_one(LIGHT_STD));
        let response = [0; 3].map(|_| about_one(RESPONSE_STD));
        let mut factor = |[low, high]: [f64; 2]| stream.between_log(low, high).powf(spread);
        let (noise, smoothing) = (factor(NOISE), factor(SMOOTHING));
        let is_mirrored = stream.uniform() < 0.5 * spread;
        let tint =
            [0; 3].map(|_| [0; 5].map(|_| spread * stream.between(-TINT_LEVELS, TINT_LEVELS)));
        let marker_shift =
            [0; 2].map(|_| spread.min(1.0) * stream.between(-MARKER_SHIFT, MARKER_SHIFT));
        let marker_tilt_deg = spread * stream.between(-MARKER_TILT_DEG, MARKER_TILT_DEG);
        let gel = if spread > 0.0 { stream.bits() } else { 0 };
        Self {
            light,
            response,
            noise,
            smoothing,
            is_mirrored,
            tint,
            marker_shift,
            marker_tilt_deg,
            gel,
        }
    }

    /// Returns the profile of the varied sensor.
    #[must_use]
    pub fn apply(&self, profile: &SensorProfile) -> SensorProfile {
        let mut varied = profile.clone();
        varied.noise_std = profile.noise_std.map(|std| self.noise * std);
        varied.smoothing.sigma_m *= self.smoothing;
        self.vary_markers(&mut varied);
        if let ShadingModel::Polynomial(shading) = &mut varied.shading {
            self.scale_response(shading);
        }
        let background = &mut varied.background;
        let image = background.image.get_or_insert_with(|| {
            let geometry = profile.geometry;
            image_of_fit(&background.fit, geometry.width, geometry.height)
        });
        self.vary_background(image);
        background.fit = BackgroundFit::from_image(image, background.fit.degree);
        varied
    }

    fn vary_markers(&self, profile: &mut SensorProfile) {
        let Some(pattern) = &mut profile.markers else {
            return;
        };
        for axis in 0..2 {
            let pitch_m = pattern.pitch_m[axis];
            let moved_m = pattern.offset_m[axis] + self.marker_shift[axis] * pitch_m;
            pattern.offset_m[axis] = moved_m - pitch_m * (moved_m / pitch_m).round();
        }
        pattern.tilt_deg += self.marker_tilt_deg;
        if self.gel != 0 {
            profile.serial = format!("{:016x}", self.gel);
        }
    }

    fn scale_response(&self, shading: &mut PolynomialShading) {
        let channels = [&mut shading.red, &mut shading.green, &mut shading.blue];
        for (channel, factor) in channels.into_iter().zip(self.response) {
            channel.iter_mut().for_each(|value| *value *= factor);
        }
    }

    fn vary_background(&self, image: &mut RgbImage) {
        if self.is_mirrored {
            imageops::flip_horizontal_in_place(image);
        }
        let (width, height) = (f64::from(image.width()), f64::from(image.height()));
        for (column, row, pixel) in image.enumerate_pixels_mut() {
            let x = (2.0 * f64::from(column) + 1.0) / width - 1.0;
            let y = (2.0 * f64::from(row) + 1.0) / height - 1.0;
            let terms = [x, y, x * y, 2.0 * x * x - 1.0, 2.0 * y * y - 1.0];
            let level = |c: usize| {
                let tint: f64 = terms.iter().zip(self.tint[c]).map(|(t, k)| t * k).sum();
                let level = f64::from(pixel[c]) * self.light[c] + tint;
                level.round().clamp(0.0, 255.0) as u8
            };
            *pixel = Rgb([level(0), level(1), level(2)]);
        }
    }
}

fn image_of_fit(fit: &BackgroundFit, width: usize, height: usize) -> RgbImage {
    let planes = fit.planes(width, height);
    RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let at = y as usize * width + x as usize;
        Rgb([0, 1, 2].map(|c| planes[c][at].round().clamp(0.0, 255.0) as u8))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_testing::mean_difference;

    fn shipped() -> SensorProfile {
        SensorProfile::gelsight_mini().unwrap()
    }

    fn background(profile: &SensorProfile) -> RgbImage {
        profile.background.image.clone().unwrap()
    }

    #[test]
    fn spread_0_gives_the_profile() {
        let same = SensorVariation::sample(5, 0.0);
        assert_eq!(same, SensorVariation::NONE);
        let varied = same.apply(&shipped());
        assert_eq!(varied.shading, shipped().shading);
        assert_eq!(varied.noise_std, shipped().noise_std);
        assert_eq!(
            mean_difference(&background(&varied), &background(&shipped())),
            0.0
        );
    }

    #[test]
    fn sensors_vary_like_real_ones_and_stay_valid() {
        let mut differences = Vec::new();
        for seed in 0..40 {
            let varied = SensorVariation::sample(seed, 1.0).apply(&shipped());
            varied.validate().unwrap();
            let off = mean_difference(&background(&varied), &background(&shipped()));
            differences.push(off);
            assert_eq!(varied, SensorVariation::sample(seed, 1.0).apply(&shipped()));
        }
        differences.sort_by(f64::total_cmp);
        assert!(differences[0] > 1.0, "{differences:?}");
        assert!((5.0..20.0).contains(&differences[20]), "{differences:?}");
        assert!(differences[39] < 40.0, "{differences:?}");
    }

    #[test]
    fn background_without_image_comes_from_its_fit() {
        let mut profile = shipped();
        profile.background.image = None;
        let varied = SensorVariation::NONE.apply(&profile);
        let off = mean_difference(&background(&varied), &background(&shipped()));
        assert!(off < 4.0, "{off}");
    }
}
