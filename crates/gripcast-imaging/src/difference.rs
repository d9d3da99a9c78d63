//! Difference of tactile images.

use image::RgbImage;

use gripcast_base::error::{Error, Result};

/// Signed difference *grasp − initial* of two tactile images, per channel, in grey levels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TactileDifference {
    width: u32,
    height: u32,
    /// Row-major RGB, −255 to 255.
    levels: Vec<i16>,
}

impl TactileDifference {
    /// Computes the difference *grasp − initial*.
    ///
    /// # Errors
    /// `Input` for different or empty sizes.
    pub fn between(initial: &RgbImage, grasp: &RgbImage) -> Result<Self> {
        let (width, height) = initial.dimensions();
        if grasp.dimensions() != (width, height) || width == 0 || height == 0 {
            return Err(Error::input(format!(
                "the tactile difference requires equal sizes with at least one pixel, found a {}×{} grasp and a {width}×{height} initial image",
                grasp.width(),
                grasp.height(),
            )));
        }
        let levels = grasp
            .as_raw()
            .iter()
            .zip(initial.as_raw())
            .map(|(grasp, initial)| i16::from(*grasp) - i16::from(*initial))
            .collect();
        Ok(Self {
            width,
            height,
            levels,
        })
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// `height × width × 3` differences in grey levels, row-major RGB.
    pub fn levels(&self) -> &[i16] {
        &self.levels
    }

    /// Writes the model input: `[3, height, width]`, planes R, G, B, levels / 255 (−1 to 1).
    ///
    /// # Errors
    /// `Internal` for a length of `out` other than 3 × height × width.
    pub fn write_chw(&self, out: &mut [f32]) -> Result<()> {
        if out.len() != self.levels.len() {
            return Err(Error::internal(format!(
                "a tactile difference of {}×{} fills {} values, the tensor has {}",
                self.width,
                self.height,
                self.levels.len(),
                out.len()
            )));
        }
        let (red, rest) = out.split_at_mut(self.levels.len() / 3);
        let (green, blue) = rest.split_at_mut(self.levels.len() / 3);
        let planes = red.iter_mut().zip(green).zip(blue);
        for (pixel, ((red, green), blue)) in self.levels.chunks_exact(3).zip(planes) {
            *red = f32::from(pixel[0]) / 255.0;
            *green = f32::from(pixel[1]) / 255.0;
            *blue = f32::from(pixel[2]) / 255.0;
        }
        Ok(())
    }

    /// Image for display: 128 means no change, scaled by `gain`. A gain of 0.5 never clips; 2 makes
    /// light contacts visible.
    #[must_use]
    pub fn to_image(&self, gain: f32) -> RgbImage {
        let mut image = RgbImage::new(self.width, self.height);
        for (pixel, level) in image.iter_mut().zip(&self.levels) {
            // The cast saturates at 0 and 255; + 0.5 rounds.
            *pixel = (128.5 + f32::from(*level) * gain) as u8;
        }
        image
    }

    /// Contact strength: mean absolute difference over pixels and channels, in grey levels.
    #[must_use]
    pub fn mean_abs(&self) -> f32 {
        let sum: u64 = self
            .levels
            .iter()
            .map(|level| u64::from(level.unsigned_abs()))
            .sum();
        (sum as f64 / self.levels.len() as f64) as f32
    }

    /// Fraction (0 to 1) of pixels with a channel changed by more than `levels`.
    ///
    /// Presses of a real ball change 11 to 28 % of the pixels by more than 10 levels; sensor noise
    /// stays below 10.
    #[must_use]
    pub fn changed_fraction(&self, levels: u16) -> f32 {
        let changed = self
            .levels
            .chunks_exact(3)
            .filter(|pixel| pixel.iter().any(|level| level.unsigned_abs() > levels))
            .count();
        (changed as f64 * 3.0 / self.levels.len() as f64) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn plain(colour: [u8; 3]) -> RgbImage {
        RgbImage::from_pixel(2, 3, Rgb(colour))
    }

    #[test]
    fn sign_and_channel_order() {
        let d = TactileDifference::between(&plain([10, 100, 50]), &plain([30, 90, 50])).unwrap();
        assert_eq!(&d.levels()[..3], &[20, -10, 0]);
        let mut chw = vec![0.0; 18];
        d.write_chw(&mut chw).unwrap();
        assert_eq!(chw[..6], [20.0 / 255.0; 6]);
        assert_eq!(chw[6..12], [-10.0 / 255.0; 6]);
        assert_eq!(chw[12..], [0.0; 6]);
        assert!((d.mean_abs() - 10.0).abs() < 1e-6);
        assert_eq!(d.to_image(0.5).get_pixel(1, 2).0, [138, 123, 128]);
        assert_eq!(d.to_image(100.0).get_pixel(0, 0).0, [255, 0, 128]);
    }

    #[test]
    fn extreme_differences_do_not_overflow() {
        let d = TactileDifference::between(&plain([0, 7, 255]), &plain([255, 7, 0])).unwrap();
        assert_eq!(&d.levels()[..3], &[255, 0, -255]);
        assert_eq!(d.to_image(0.5).get_pixel(0, 0).0, [255, 128, 1]);
    }

    #[test]
    fn unequal_sizes_are_rejected() {
        let error = TactileDifference::between(&plain([0; 3]), &RgbImage::new(3, 2)).unwrap_err();
        assert!(error.to_string().contains("3×2"), "{error}");
        assert!(TactileDifference::between(&RgbImage::new(0, 0), &RgbImage::new(0, 0)).is_err());
        let d = TactileDifference::between(&plain([0; 3]), &plain([0; 3])).unwrap();
        assert!(d.write_chw(&mut [0.0; 17]).is_err());
    }
}
