//! Z16 depth.

use image::{ImageBuffer, Luma};

use super::frame::{Frame, PixelFormat};

/// Depth in units of the camera; 0: unknown.
pub type DepthImage = ImageBuffer<Luma<u16>, Vec<u16>>;

/// Minimum and maximum depth of the colour ramp, units (mm for a D435).
const RAMP: (u16, u16) = (100, 1500);

/// Colours from near to far.
const STOPS: [[f32; 3]; 4] = [
    [255.0, 80.0, 60.0],
    [250.0, 220.0, 80.0],
    [60.0, 190.0, 130.0],
    [40.0, 60.0, 160.0],
];

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

/// False colour of a depth: black for unknown, red (up to 100 units) over yellow and green to blue
/// (from 1500 units).
pub(super) fn preview_colour(depth: u16) -> [u8; 3] {
    if depth == 0 {
        return [0; 3];
    }
    let (near, far) = RAMP;
    let fraction = f32::from(depth.clamp(near, far) - near) / f32::from(far - near);
    let position = fraction * (STOPS.len() - 1) as f32;
    let segment = (position as usize).min(STOPS.len() - 2);
    let t = position - segment as f32;
    std::array::from_fn(|c| {
        let (a, b) = (STOPS[segment][c], STOPS[segment + 1][c]);
        (a + (b - a) * t + 0.5) as u8
    })
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

    #[test]
    fn ramp_is_red_to_blue() {
        assert_eq!(preview_colour(0), [0, 0, 0]);
        assert_eq!(preview_colour(1), preview_colour(100));
        assert_eq!(preview_colour(100), [255, 80, 60]);
        assert_eq!(preview_colour(1500), [40, 60, 160]);
        assert_eq!(preview_colour(u16::MAX), preview_colour(1500));
    }
}
