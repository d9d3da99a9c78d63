//! PNG files: colour, grey and 16-bit depth. Reads WebP files too.

use std::io::Cursor;

use image::codecs::png::{CompressionType, FilterType, PngDecoder, PngEncoder};
use image::codecs::webp::WebPDecoder;
use image::{
    DynamicImage, ExtendedColorType, GrayImage, ImageDecoder as _, ImageEncoder, Limits, RgbImage,
};

use super::resample::{MAX_STORED_BYTES, check_stored};
use super::z16::DepthImage;
use gripcast_base::error::{Error, Result};

/// RGB image to PNG, with fast compression.
///
/// # Errors
/// `Input` for an empty image.
pub fn encode_png_rgb(image: &RgbImage) -> Result<Vec<u8>> {
    let (width, height) = image.dimensions();
    encode(image.as_raw(), width, height, ExtendedColorType::Rgb8)
}

/// 8-bit grey image to PNG, with fast compression.
///
/// # Errors
/// `Input` for an empty image.
pub fn encode_png_grey8(image: &GrayImage) -> Result<Vec<u8>> {
    let (width, height) = image.dimensions();
    encode(image.as_raw(), width, height, ExtendedColorType::L8)
}

/// 16-bit depth to PNG, with fast compression.
///
/// # Errors
/// `Input` for an empty image.
pub fn encode_png_grey16(image: &DepthImage) -> Result<Vec<u8>> {
    let (width, height) = image.dimensions();
    // The encoder takes 16-bit samples in native byte order.
    let bytes: Vec<u8> = image.iter().flat_map(|v| v.to_ne_bytes()).collect();
    encode(&bytes, width, height, ExtendedColorType::L16)
}

fn encode(bytes: &[u8], width: u32, height: u32, colour: ExtendedColorType) -> Result<Vec<u8>> {
    let failed = || Error::input(format!("cannot write a {width}×{height} image as PNG"));
    if width == 0 || height == 0 {
        return Err(failed());
    }
    let mut out = Vec::new();
    PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Adaptive)
        .write_image(bytes, width, height, colour)
        .map_err(|cause| failed().because(cause))?;
    Ok(out)
}

/// PNG to RGB; converts grey, drops transparency.
///
/// # Errors
/// `Input` for a damaged or unsupported file.
pub fn decode_png_rgb(bytes: &[u8]) -> Result<RgbImage> {
    decode_png(bytes).map(DynamicImage::into_rgb8)
}

/// 16-bit grey PNG to depth.
///
/// # Errors
/// `Input` for a damaged or unsupported file.
pub fn decode_png_grey16(bytes: &[u8]) -> Result<DepthImage> {
    match decode_png(bytes)? {
        DynamicImage::ImageLuma16(depth) => Ok(depth),
        other => Err(Error::input(format!(
            "expected a 16-bit grey PNG (depth), found pixels of type {:?}",
            other.color()
        ))),
    }
}

/// Decodes a PNG of a supported size.
///
/// # Errors
/// `Input` for a damaged, unsupported or too large file.
pub fn decode_png(bytes: &[u8]) -> Result<DynamicImage> {
    let unreadable = |cause| Error::input("cannot read the PNG").because(cause);
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_STORED_BYTES);
    let decoder = PngDecoder::with_limits(Cursor::new(bytes), limits).map_err(unreadable)?;
    // Before decoding: a small file may have a huge image.
    let (width, height) = decoder.dimensions();
    check_stored(width, height, decoder.total_bytes())?;
    DynamicImage::from_decoder(decoder).map_err(unreadable)
}

/// WebP to RGB: the first image of an animation; drops transparency.
///
/// # Errors
/// `Input` for a damaged, unsupported or too large file.
pub(super) fn decode_webp_rgb(bytes: &[u8]) -> Result<RgbImage> {
    let unreadable = |cause| Error::input("damaged WebP image").because(cause);
    let decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(unreadable)?;
    let (width, height) = decoder.dimensions();
    check_stored(width, height, decoder.total_bytes())?;
    let image = DynamicImage::from_decoder(decoder).map_err(unreadable)?;
    Ok(image.into_rgb8())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_round_trip() {
        let rgb = RgbImage::from_fn(7, 5, |x, y| image::Rgb([x as u8, y as u8, 200]));
        assert_eq!(decode_png_rgb(&encode_png_rgb(&rgb).unwrap()).unwrap(), rgb);
        let grey = GrayImage::from_fn(7, 5, |x, y| image::Luma([(x * y) as u8]));
        let back = decode_png_rgb(&encode_png_grey8(&grey).unwrap()).unwrap();
        assert!(
            back.pixels()
                .zip(grey.pixels())
                .all(|(a, b)| a.0 == [b.0[0]; 3])
        );
        let depth = DepthImage::from_fn(7, 5, |x, y| image::Luma([(x * 9000 + y) as u16]));
        let bytes = encode_png_grey16(&depth).unwrap();
        assert_eq!(decode_png_grey16(&bytes).unwrap(), depth);
    }

    #[test]
    fn invalid_files_are_rejected() {
        let rgb = encode_png_rgb(&RgbImage::new(2, 2)).unwrap();
        let text = decode_png_grey16(&rgb).unwrap_err().to_string();
        assert!(text.contains("16-bit grey"), "{text}");
        assert!(decode_png_rgb(&rgb[..rgb.len() / 2]).is_err());
        assert!(decode_png_rgb(b"").is_err());
        assert!(encode_png_rgb(&RgbImage::new(0, 4)).is_err());
    }

    #[test]
    fn huge_image_is_rejected_before_decoding() {
        let mut bomb = encode_png_grey16(&DepthImage::new(1, 1)).unwrap();
        // Width and height are the first fields of the chunk IHDR.
        bomb[16..20].copy_from_slice(&9000_u32.to_be_bytes());
        bomb[20..24].copy_from_slice(&9000_u32.to_be_bytes());
        let mut checksum = flate2::Crc::new();
        checksum.update(&bomb[12..29]);
        bomb[29..33].copy_from_slice(&checksum.sum().to_be_bytes());
        let text = decode_png_grey16(&bomb).unwrap_err().to_string();
        assert!(text.contains("9000×9000"), "{text}");
    }
}
