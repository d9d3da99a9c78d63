//! JPEG encoder for virtual cameras and tests.

use image::RgbImage;
use turbojpeg::{Compressor, Image, PixelFormat, Subsamp};

use gripcast_base::error::{Error, Result};

/// Encodes a baseline 4:2:2 JPEG with the standard Huffman tables, like UVC cameras. `quality` is 1
/// (worst) to 100.
///
/// # Errors
/// `Input` for an empty or too large image or a quality outside 1–100.
pub fn encode_jpeg(image: &RgbImage, quality: u8) -> Result<Vec<u8>> {
    let (width, height) = image.dimensions();
    let failed = |cause| {
        Error::input(format!(
            "cannot encode a {width}×{height} image as JPEG of quality {quality}"
        ))
        .because(cause)
    };
    if width == 0 || height == 0 || !(1..=100).contains(&quality) {
        return Err(Error::input(format!(
            "cannot encode a {width}×{height} image as JPEG of quality {quality}: \
                 expected at least one pixel and a quality of 1 to 100"
        )));
    }
    let mut compressor = Compressor::new().map_err(failed)?;
    compressor.set_quality(i32::from(quality)).map_err(failed)?;
    compressor.set_subsamp(Subsamp::Sub2x1).map_err(failed)?;
    compressor
        .compress_to_vec(Image {
            pixels: image.as_raw().as_slice(),
            width: width as usize,
            pitch: width as usize * 3,
            height: height as usize,
            format: PixelFormat::RGB,
        })
        .map_err(failed)
}
