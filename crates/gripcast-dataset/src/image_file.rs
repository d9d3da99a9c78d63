//! Whether a stored file is the whole image that its record describes.

use image::ColorType;

use super::grasp::CameraRecord;
use gripcast_imaging::{PixelFormat, decode_png, jpeg};

/// Says what is wrong with an image; `None` when it is whole and of the right size and kind.
pub(super) fn fault(bytes: &[u8], camera: &CameraRecord) -> Option<String> {
    let found = match camera.format {
        PixelFormat::Mjpg => jpeg_size(bytes),
        PixelFormat::Yuyv | PixelFormat::Rgb => png_size(bytes, ColorType::Rgb8),
        PixelFormat::Grey => png_size(bytes, ColorType::L8),
        PixelFormat::Z16 => png_size(bytes, ColorType::L16),
    };
    match found {
        Err(fault) => Some(fault),
        Ok(size) if size != (camera.width, camera.height) => Some(format!(
            "the image is {}×{}, its record says {}×{}",
            size.0, size.1, camera.width, camera.height
        )),
        Ok(_) => None,
    }
}

/// Format, width and height of a whole image; the format is the one that is stored so.
pub(super) fn recognise(bytes: &[u8]) -> Option<(PixelFormat, u32, u32)> {
    if let Ok((width, height)) = jpeg_size(bytes) {
        return Some((PixelFormat::Mjpg, width, height));
    }
    [
        (PixelFormat::Yuyv, ColorType::Rgb8),
        (PixelFormat::Grey, ColorType::L8),
        (PixelFormat::Z16, ColorType::L16),
    ]
    .into_iter()
    .find_map(|(format, colour)| {
        let (width, height) = png_size(bytes, colour).ok()?;
        Some((format, width, height))
    })
}

fn png_size(bytes: &[u8], colour: ColorType) -> Result<(u32, u32), String> {
    let image = decode_png(bytes).map_err(|e| format!("not a whole PNG: {e}"))?;
    if image.color() != colour {
        return Err(format!(
            "the image is {:?}, its record says {colour:?}",
            image.color()
        ));
    }
    Ok((image.width(), image.height()))
}

/// Size of a JPEG whose marker structure is whole; the entropy-coded data is not decoded.
fn jpeg_size(bytes: &[u8]) -> Result<(u32, u32), String> {
    let header = jpeg::inspect(bytes).map_err(|e| e.to_string())?;
    Ok((header.width, header.height))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;

    #[test]
    fn a_jpeg_is_followed_to_its_end() {
        let whole = sample::jpeg(24, 16, 3);
        assert_eq!(jpeg_size(&whole), Ok((24, 16)));
        let mut padded = whole.clone();
        padded.extend([0; 64]);
        assert_eq!(jpeg_size(&padded), Ok((24, 16)));
        for cut in 0..whole.len() {
            assert!(jpeg_size(&whole[..cut]).is_err(), "cut at {cut}");
        }
        assert!(jpeg_size(b"\xff\xd8\xff\xd9").is_err());
    }
}
