//! Crop and resize.

use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::U8x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use image::RgbImage;

use super::crop::{CropProfile, CropWindow};
use super::damage::FrameDamage;
use super::frame::MAX_SIDE;
use gripcast_base::error::{Error, Result as CrateResult};

/// Maximum size of the pixels of a stored image, bytes.
pub(super) const MAX_STORED_BYTES: u64 = 128 << 20;

/// Checks the size of a stored image.
///
/// # Errors
/// `Input` for a too large image.
pub(super) fn check_stored(width: u32, height: u32, bytes: u64) -> CrateResult<()> {
    let is_valid = width <= MAX_SIDE && height <= MAX_SIDE;
    if is_valid && bytes <= MAX_STORED_BYTES {
        return Ok(());
    }
    Err(Error::input(format!(
        "expected an image of at most {MAX_SIDE} pixels a side and {} MiB, found \
             {width}×{height} pixels that take {} MiB",
        MAX_STORED_BYTES >> 20,
        bytes >> 20
    )))
}

/// RGB pixels, possibly at a reduced scale.
pub(super) struct Source<'a> {
    /// Width of `rgb` in pixels.
    pub(super) width: u32,
    /// Height of `rgb` in pixels.
    pub(super) height: u32,
    /// `height × width × 3` bytes.
    pub(super) rgb: &'a [u8],
    /// Pixels of the original per pixel of `rgb` along each axis.
    pub(super) reduction: u32,
}

/// Crops an image and resizes it to `width` × `height` with an antialiased bilinear filter.
///
/// The filter includes pixels outside the crop.
///
/// # Errors
/// [`FrameDamage`] for an empty crop or an invalid size.
pub fn crop_and_resize(
    image: &RgbImage,
    crop: &CropProfile,
    width: u32,
    height: u32,
) -> Result<RgbImage, FrameDamage> {
    let window = window_of(crop, image.width(), image.height())?;
    let source = Source {
        width: image.width(),
        height: image.height(),
        rgb: image.as_raw(),
        reduction: 1,
    };
    RgbScaler::default().resample(&source, window, width, height)
}

/// The crop window.
pub(super) fn window_of(
    crop: &CropProfile,
    width: u32,
    height: u32,
) -> Result<CropWindow, FrameDamage> {
    crop.window(width, height).ok_or(FrameDamage::NothingLeft {
        crop: crop.name(),
        width,
        height,
    })
}

/// Checks a target size.
pub(super) fn check_target(width: u32, height: u32) -> Result<(), FrameDamage> {
    let valid = 1..=MAX_SIDE;
    if valid.contains(&width) && valid.contains(&height) {
        Ok(())
    } else {
        Err(FrameDamage::TargetSize { width, height })
    }
}

/// Resizes 8-bit RGB images; reuses its buffers.
#[derive(Clone, Debug, Default)]
pub struct RgbScaler(Resizer);

impl RgbScaler {
    /// Enlarges RGB rows of size `from` to `to` by bilinear interpolation.
    ///
    /// # Errors
    /// [`FrameDamage`] for an invalid size.
    pub fn enlarge(
        &mut self,
        rgb: &[u8],
        from: (u32, u32),
        to: (u32, u32),
    ) -> Result<RgbImage, FrameDamage> {
        let interpolation = ResizeAlg::Interpolation(FilterType::Bilinear);
        self.resize(
            rgb,
            from,
            to,
            ResizeOptions::new().resize_alg(interpolation),
        )
    }

    /// Resizes to cover `to` with a Catmull-Rom filter, cropping both sides equally.
    ///
    /// # Errors
    /// [`FrameDamage`] for an invalid size.
    pub fn cover(&mut self, image: &RgbImage, to: (u32, u32)) -> Result<RgbImage, FrameDamage> {
        let options = ResizeOptions::new()
            .resize_alg(ResizeAlg::Convolution(FilterType::CatmullRom))
            .fit_into_destination(None);
        self.resize(image.as_raw(), image.dimensions(), to, options)
    }

    /// Resizes `window`, given in pixels of the original image, to `width` × `height`.
    pub(super) fn resample(
        &mut self,
        source: &Source<'_>,
        window: CropWindow,
        width: u32,
        height: u32,
    ) -> Result<RgbImage, FrameDamage> {
        check_target(width, height)?;
        let scaled = |pixels: u32| f64::from(pixels) / f64::from(source.reduction);
        let options = ResizeOptions::new()
            .resize_alg(ResizeAlg::Convolution(FilterType::Bilinear))
            .crop(
                scaled(window.left),
                scaled(window.top),
                scaled(window.width),
                scaled(window.height),
            );
        let size = (source.width, source.height);
        self.resize(source.rgb, size, (width, height), options)
    }

    // `resize` would compile the kernels of all pixel types.
    fn resize(
        &mut self,
        rgb: &[u8],
        from: (u32, u32),
        (width, height): (u32, u32),
        options: ResizeOptions,
    ) -> Result<RgbImage, FrameDamage> {
        let invalid = || FrameDamage::TargetSize { width, height };
        let mut out = RgbImage::new(width, height);
        let from =
            TypedImageRef::<U8x3>::from_buffer(from.0, from.1, rgb).map_err(|_| invalid())?;
        let mut to =
            TypedImage::<U8x3>::from_buffer(width, height, &mut out).map_err(|_| invalid())?;
        self.0
            .resize_typed(&from, &mut to, &options)
            .map_err(|_| invalid())?;
        Ok(out)
    }
}
