//! Checks that a stored file is a complete image as its record describes it.

use image::ColorType;

use gripcast_imaging::{PixelFormat, decode_png, jpeg};

/// Returns the defect of an image; `None` when it is complete and of the recorded size and type.
pub(super) fn defect(bytes: &[u8], format: PixelFormat, width: u32, height: u32) -> Option<String> {
    let found = match format {
        PixelFormat::Mjpg => jpeg_size(bytes),
        PixelFormat::Yuyv | PixelFormat::Rgb => png_size(bytes, ColorType::Rgb8),
        PixelFormat::Grey => png_size(bytes, ColorType::L8),
        PixelFormat::Z16 => png_size(bytes, ColorType::L16),
    };
    match found {
        Err(defect) => Some(defect),
        Ok((w, h)) if (w, h) != (width, height) => Some(format!(
            "expected {width}×{height} pixels as recorded, found {w}×{h}"
        )),
        Ok(_) => None,
    }
}

/// Returns format, width and height of a complete image.
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
    let image = decode_png(bytes).map_err(|e| format!("incomplete PNG: {e}"))?;
    if image.color() != colour {
        return Err(format!(
            "expected {colour:?} pixels as recorded, found {:?}",
            image.color()
        ));
    }
    Ok((image.width(), image.height()))
}

/// Size of a JPEG whose marker structure is complete; the entropy-coded data is not decoded.
fn jpeg_size(bytes: &[u8]) -> Result<(u32, u32), String> {
    let header = jpeg::inspect(bytes).map_err(|e| e.to_string())?;
    Ok((header.width, header.height))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;

    #[test]
    fn truncated_jpeg_has_no_size() {
        let whole = sample::jpeg(24, 16, 3);
        assert_eq!(jpeg_size(&whole), Ok((24, 16)));
        let mut padded = whole.clone();
        padded.extend([0; 64]);
        assert_eq!(jpeg_size(&padded), Ok((24, 16)));
        // Without its end marker it is still whole.
        for cut in 0..whole.len() - 2 {
            assert!(jpeg_size(&whole[..cut]).is_err(), "cut at {cut}");
        }
        assert!(jpeg_size(b"\xff\xd8\xff\xd9").is_err());
    }
}
