//! Bitmap textures: linear RGB albedo in [0, 1].

use image::RgbImage;

use gripcast_base::error::{Error, Result};
use gripcast_imaging::srgb_decode;

/// Repeating texture image with bilinear interpolation in linear light.
///
/// Texture coordinates start at the outer corner of the top-left pixel: u to the right, v **down**
/// (as in glTF; the OBJ reader flips v). The image spans [0, 1]².
#[derive(Clone, Debug, PartialEq)]
pub struct Bitmap {
    width: usize,
    height: usize,
    /// sRGB, row-major; the fourth byte is padding.
    texels: Vec<[u8; 4]>,
}

impl Bitmap {
    /// Texture from an 8-bit sRGB image.
    ///
    /// # Errors
    /// `Input` if the image has no pixels.
    pub fn from_srgb8(image: &RgbImage) -> Result<Self> {
        let (width, height) = image.dimensions();
        if width == 0 || height == 0 {
            return Err(Error::input(format!(
                "a texture must have pixels, found an image of {width}×{height}"
            )));
        }
        Ok(Self {
            width: width as usize,
            height: height as usize,
            texels: image.pixels().map(|p| [p[0], p[1], p[2], 0]).collect(),
        })
    }

    /// Columns and rows.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Returns the 8-bit sRGB image.
    pub fn to_srgb8(&self) -> RgbImage {
        let bytes = self
            .texels
            .iter()
            .flat_map(|t| [t[0], t[1], t[2]])
            .collect();
        RgbImage::from_raw(self.width as u32, self.height as u32, bytes).unwrap_or_default()
    }

    /// Samples linear RGB at texture coordinates.
    #[inline]
    pub fn sample(&self, uv: [f32; 2]) -> [f32; 3] {
        let [x0, x1, fx] = neighbours(uv[0], self.width);
        let [y0, y1, fy] = neighbours(uv[1], self.height);
        let texel = |x: usize, y: usize| {
            let [r, g, b, _] = self.texels[y * self.width + x];
            [r, g, b].map(srgb_decode)
        };
        let (x0, x1, y0, y1) = (x0 as usize, x1 as usize, y0 as usize, y1 as usize);
        let (a, b, c, d) = (texel(x0, y0), texel(x1, y0), texel(x0, y1), texel(x1, y1));
        std::array::from_fn(|k| {
            let top = a[k] + (b[k] - a[k]) * fx;
            let bottom = c[k] + (d[k] - c[k]) * fx;
            top + (bottom - top) * fy
        })
    }
}

/// Returns the two texels around a coordinate, wrapped, and the weight of the second.
#[inline(always)]
fn neighbours(coordinate: f32, count: usize) -> [f32; 3] {
    let size = count as f32;
    // NaN selects the first texel.
    let wrapped = (coordinate - coordinate.floor()).max(0.0);
    let x = wrapped * size - 0.5;
    let low = x.floor();
    let first = if low < 0.0 {
        size - 1.0
    } else {
        low.min(size - 1.0)
    };
    let second = if first + 1.0 >= size {
        0.0
    } else {
        first + 1.0
    };
    [first, second, x - low]
}
