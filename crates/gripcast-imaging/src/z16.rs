//! Z16 depth.

use image::{ImageBuffer, Luma};

use super::frame::{Frame, PixelFormat};

/// Depth in units of the camera; 0: unknown.
pub type DepthImage = ImageBuffer<Luma<u16>, Vec<u16>>;

/// Little-endian bytes to values; drops an odd byte at the end.
pub(super) fn values(bytes: &[u8]) -> Vec<u16> {
    bytes
        .chunks_exact(2)
        .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
        .collect()
}

/// Fraction of the pixels of a Z16 frame that have a depth, 0..1; `None` for other formats.
///
/// 0 is unknown, the largest count is out of range.
#[must_use]
pub fn valid_depth_fraction(frame: &Frame) -> Option<f64> {
    if frame.format != PixelFormat::Z16 {
        return None;
    }
    let pixels = frame.data.chunks_exact(2);
    let all = pixels.len();
    let valid = pixels.filter(|pair| !matches!(pair, [0, 0] | [0xff, 0xff]));
    Some(valid.count() as f64 / all.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_little_endian() {
        assert_eq!(values(&[0x34, 0x12, 0xff, 0x00, 0x7]), [0x1234, 0x00ff]);
    }

    #[test]
    fn unknown_and_out_of_range_pixels_are_not_valid() {
        let frame = |format| Frame {
            format,
            width: 2,
            height: 2,
            data: vec![0, 0, 0xff, 0xff, 0, 1, 0xff, 0].into(),
            sequence: 0,
            driver_time_ns: 0,
            received_ns: 0,
        };
        assert_eq!(valid_depth_fraction(&frame(PixelFormat::Z16)), Some(0.5));
        assert_eq!(valid_depth_fraction(&frame(PixelFormat::Yuyv)), None);
    }
}
