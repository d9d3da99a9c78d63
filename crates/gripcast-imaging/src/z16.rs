//! Z16 depth.

use image::{ImageBuffer, Luma};

/// Depth in units of the camera; 0: unknown.
pub type DepthImage = ImageBuffer<Luma<u16>, Vec<u16>>;

/// Little-endian bytes to values; drops an odd byte at the end.
pub(super) fn values(bytes: &[u8]) -> Vec<u16> {
    bytes
        .chunks_exact(2)
        .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_little_endian() {
        assert_eq!(values(&[0x34, 0x12, 0xff, 0x00, 0x7]), [0x1234, 0x00ff]);
    }
}
