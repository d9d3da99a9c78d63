//! Full camera frame around the rendered crop of a sensor.

use std::ops::Range;

use image::RgbImage;

use super::profile::SensorProfile;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::CropWindow;

/// Source position of a column or row of the full frame in the sensor image.
#[derive(Clone, Copy, Debug)]
struct SampleLine {
    /// Index of the source line before it.
    before: usize,
    /// Weight of the next source line.
    fraction: f32,
    /// Distance outside of the crop, relative to its size.
    outside: f32,
}

/// Extends sensor images, which are crops, to full camera frames.
#[derive(Clone, Debug)]
pub struct WholeFrame {
    columns: Vec<SampleLine>,
    rows: Vec<SampleLine>,
    size: (u32, u32),
}

impl WholeFrame {
    /// Frames of `painted` columns and rows that cover a camera frame of `full`, of which `window`
    /// is the crop.
    #[must_use]
    pub fn new(
        profile: &SensorProfile,
        window: CropWindow,
        full: (u32, u32),
        painted: (u32, u32),
    ) -> Self {
        let (width, height) = (profile.geometry.width, profile.geometry.height);
        let across = window.left..window.left + window.width;
        let down = window.top..window.top + window.height;
        Self {
            columns: lines(painted.0, full.0, across, width),
            rows: lines(painted.1, full.1, down, height),
            size: (width as u32, height as u32),
        }
    }

    /// Composes a full frame: `image` inside the crop; outside, the contact fades into the
    /// untouched gel and both into the dark housing.
    ///
    /// # Errors
    /// `Internal` if an image has another size than its profile.
    pub fn compose(&self, image: &RgbImage, untouched: &RgbImage) -> Result<RgbImage> {
        let wrong_size = || {
            let what = "the size of a tactile image differs from its profile";
            Error::internal(what)
        };
        if image.dimensions() != self.size || untouched.dimensions() != self.size {
            return Err(wrong_size());
        }
        let stride = 3 * self.size.0 as usize;
        let mut frame = Vec::with_capacity(3 * self.columns.len() * self.rows.len());
        for row in &self.rows {
            let line = |of: &'_ RgbImage, at: usize| -> Vec<f32> {
                let line = &of.as_raw()[at * stride..][..stride];
                line.iter().map(|level| f32::from(*level)).collect()
            };
            let between = |of: &RgbImage| -> Vec<f32> {
                let (above, below) = (line(of, row.before), line(of, row.before + 1));
                let mixed = above.iter().zip(&below);
                mixed.map(|(a, b)| a + row.fraction * (b - a)).collect()
            };
            let (touched, bare) = (between(image), between(untouched));
            for column in &self.columns {
                let rim = column.outside.hypot(row.outside) / 0.2;
                let light = 1.0 - 0.62 * ease((rim - 0.25) / 0.75);
                let contact = 1.0 - ease((rim - 0.15) / 0.7);
                for channel in 0..3 {
                    let at = 3 * column.before + channel;
                    let mix = |of: &[f32]| of[at] + column.fraction * (of[at + 3] - of[at]);
                    let (touched, bare) = (mix(&touched), mix(&bare));
                    let level = light * (bare + contact * (touched - bare));
                    frame.push((level + 0.5) as u8);
                }
            }
        }
        let size = [self.columns.len(), self.rows.len()].map(|n| n as u32);
        RgbImage::from_raw(size[0], size[1], frame).ok_or_else(wrong_size)
    }
}

/// Source positions of `painted` lines that cover `full` lines, of which `window` is the crop of
/// `size` source lines.
fn lines(painted: u32, full: u32, window: Range<u32>, size: usize) -> Vec<SampleLine> {
    let (first, span) = (
        f64::from(window.start),
        f64::from(window.end - window.start),
    );
    (0..painted)
        .map(|line| {
            let at = (f64::from(line) + 0.5) * f64::from(full) / f64::from(painted);
            let fraction = (at - first) / span;
            let pixel = (fraction * size as f64 - 0.5).clamp(0.0, size as f64 - 1.0);
            let before = (pixel as usize).min(size.saturating_sub(2));
            SampleLine {
                before,
                fraction: (pixel - before as f64) as f32,
                outside: (-fraction).max(fraction - 1.0).max(0.0) as f32,
            }
        })
        .collect()
}

/// Smoothstep from 0 at 0 to 1 at 1.
fn ease(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;
    use gripcast_imaging::{CropProfile, crop_and_resize};
    use gripcast_testing::mean_difference;

    #[test]
    fn crop_reproduces_image_and_rim_is_dark() {
        let profile = SensorProfile::gelsight_mini().unwrap();
        // Waves of 40 pixels show a shift of a fraction of one.
        let wave = |x: u32| 128.0 + 60.0 * (f64::from(x) * std::f64::consts::TAU / 40.0).sin();
        let waves = |shift: u32| {
            RgbImage::from_fn(320, 240, |x, y| {
                image::Rgb([wave(x + shift), wave(y), wave(x + y + shift)].map(|v| v as u8))
            })
        };
        let image = waves(0);
        let full = (640, 480);
        let window = profile.crop_profile.window(full.0, full.1).unwrap();
        let whole = WholeFrame::new(&profile, window, full, full);
        let frame = whole.compose(&image, &image).unwrap();
        let cut = crop_and_resize(&frame, &CropProfile::GSMINI_SEVENTH, 320, 240).unwrap();
        let (off, shifted) = (
            mean_difference(&cut, &image),
            mean_difference(&cut, &waves(1)),
        );
        assert!(off < 0.3 * shifted, "{off} {shifted}");
        let light = |x, y| -> u32 { frame.get_pixel(x, y).0.iter().map(|v| u32::from(*v)).sum() };
        assert!(2 * light(0, 0) < light(320, 240));
    }

    #[test]
    fn image_of_another_size_is_refused() {
        let profile = SensorProfile::gelsight_mini().unwrap();
        let window = profile.crop_profile.window(640, 480).unwrap();
        let whole = WholeFrame::new(&profile, window, (640, 480), (320, 240));
        let error = whole
            .compose(&RgbImage::new(8, 8), &RgbImage::new(8, 8))
            .unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Internal);
    }
}
