//! Whether a stored file is the whole picture that its record describes.

use image::ColorType;

use super::grasp::CameraRecord;
use gripcast_imaging::{PixelFormat, decode_png};

/// Says what is wrong with a picture; `None` when it is whole and of the right size and kind.
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
            "the picture is {}×{}, its record says {}×{}",
            size.0, size.1, camera.width, camera.height
        )),
        Ok(_) => None,
    }
}

/// Format, width and height of a whole picture; the format is the one that is stored so.
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
            "the picture is {:?}, its record says {colour:?}",
            image.color()
        ));
    }
    Ok((image.width(), image.height()))
}

/// Width and height of a JPEG, after following its segments and scans to the end-of-image marker.
/// The entropy-coded data itself is not decoded.
fn jpeg_size(bytes: &[u8]) -> Result<(u32, u32), String> {
    if !bytes.starts_with(&[0xff, 0xd8]) {
        return Err("not a JPEG: it lacks the start marker".into());
    }
    let mut at = 2;
    let mut size = None;
    let mut scans = 0;
    loop {
        at = next_marker(bytes, at, scans > 0)
            .ok_or_else(|| format!("the JPEG breaks off after {} bytes", bytes.len()))?;
        let marker = bytes[at - 1];
        if marker == 0xd9 {
            break;
        }
        let segment = segment(bytes, at)
            .ok_or_else(|| format!("the JPEG breaks off after {} bytes", bytes.len()))?;
        match marker {
            // Start of frame, of any coding; C4, C8 and CC are tables.
            0xc0..=0xcf if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                let field = |i: usize| -> Option<u32> {
                    Some(u32::from(*segment.get(i)?) << 8 | u32::from(*segment.get(i + 1)?))
                };
                size = field(3).zip(field(1));
            }
            0xda => scans += 1,
            _ => {}
        }
        at += 2 + segment.len();
    }
    match size {
        Some(size) if scans > 0 => Ok(size),
        _ => Err("the JPEG holds no picture".into()),
    }
}

/// Position after the next marker from `at` on. `in_scan`: entropy-coded data may come first, with
/// its stuffed zeros and restart markers.
fn next_marker(bytes: &[u8], mut at: usize, in_scan: bool) -> Option<usize> {
    loop {
        match (*bytes.get(at)?, *bytes.get(at + 1)?) {
            (0xff, 0xff) => at += 1,
            (0xff, 0x00 | 0xd0..=0xd7) if in_scan => at += 2,
            (0xff, _) => return Some(at + 2),
            _ if in_scan => at += 1,
            _ => return None,
        }
    }
}

/// Contents of the segment whose length field is at `at`.
fn segment(bytes: &[u8], at: usize) -> Option<&[u8]> {
    let length = usize::from(*bytes.get(at)?) << 8 | usize::from(*bytes.get(at + 1)?);
    bytes.get(at + 2..at + length.max(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::jpeg;

    #[test]
    fn a_jpeg_is_followed_to_its_end() {
        let whole = jpeg(24, 16, 3);
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
