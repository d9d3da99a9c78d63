//! Images in linear light.

use image::RgbImage;

use gripcast_base::error::{Error, Result};
use gripcast_imaging::srgb_encode;

/// Weights of linear R, G, B in luminance (ITU-R BT.709).
pub(super) const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Linear RGB image, row-major from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// `width * height` RGB values.
    pub pixels: Vec<[f32; 3]>,
}

impl Image {
    /// Image of a constant colour.
    pub fn filled(width: usize, height: usize, colour: [f32; 3]) -> Self {
        Self {
            width,
            height,
            pixels: vec![colour; width * height],
        }
    }

    /// Image from row-major pixels.
    ///
    /// # Errors
    /// `Input` if there are no pixels or not `width * height` of them.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Result<Self> {
        if width == 0 || height == 0 || pixels.len() != width * height {
            let found = pixels.len();
            return Err(Error::input(format!(
                "an image of {width}×{height} must have as many pixels, found {found}"
            )));
        }
        Ok(Self {
            width,
            height,
            pixels,
        })
    }

    /// Returns the pixel in a column and row.
    pub fn at(&self, column: usize, row: usize) -> [f32; 3] {
        self.pixels[row * self.width + column]
    }

    /// Returns the mean of each channel.
    pub fn mean(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for pixel in &self.pixels {
            for (sum, value) in sum.iter_mut().zip(pixel) {
                *sum += f64::from(*value);
            }
        }
        sum.map(|s| s / self.pixels.len().max(1) as f64)
    }

    /// Returns the root-mean-square difference over pixels and channels to an image of the same
    /// size.
    ///
    /// # Errors
    /// `Input` if the sizes differ.
    pub fn rmse(&self, other: &Self) -> Result<f64> {
        if (self.width, self.height) != (other.width, other.height) {
            let [a, b] = [self, other].map(|p| format!("{}×{}", p.width, p.height));
            return Err(Error::input(format!(
                "images of {a} and {b} cannot be compared"
            )));
        }
        let mut sum = 0.0;
        for (a, b) in self.pixels.iter().zip(&other.pixels) {
            for (a, b) in a.iter().zip(b) {
                sum += f64::from(a - b).powi(2);
            }
        }
        Ok((sum / (3 * self.pixels.len()).max(1) as f64).sqrt())
    }

    /// Converts to 8-bit sRGB: scales by `exposure`, clips to [0, 1], applies the transfer function
    /// of IEC 61966-2-1 and rounds. NaN becomes 0.
    pub fn to_srgb8(&self, exposure: f32) -> RgbImage {
        let bytes = self.pixels.iter().flatten();
        let bytes = bytes.map(|v| srgb_encode(v * exposure)).collect();
        RgbImage::from_raw(self.width as u32, self.height as u32, bytes).unwrap_or_default()
    }
}

/// Returns the luminance of a linear RGB value.
#[inline(always)]
pub(super) fn luminance(rgb: [f32; 3]) -> f32 {
    LUMINANCE[0] * rgb[0] + LUMINANCE[1] * rgb[1] + LUMINANCE[2] * rgb[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_scales_linear_light() {
        let image = Image::filled(2, 1, [0.09, 0.5, -1.0]);
        let pixel = image.to_srgb8(2.0).get_pixel(1, 0).0;
        assert_eq!(pixel, [118, 255, 0]);
    }

    #[test]
    fn mean_and_rmse_of_known_images() {
        let a = Image::filled(2, 2, [1.0, 2.0, 3.0]);
        let b = Image::filled(2, 2, [1.0, 2.0, 6.0]);
        assert_eq!(a.mean(), [1.0, 2.0, 3.0]);
        assert!((a.rmse(&b).unwrap() - 3f64.sqrt()).abs() < 1e-12);
        let text = a.rmse(&Image::filled(1, 4, [0.0; 3])).unwrap_err();
        assert!(text.to_string().contains("2×2 and 1×4"), "{text}");
        assert!(Image::from_pixels(0, 3, Vec::new()).is_err());
    }
}
