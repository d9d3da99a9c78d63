//! Depth images as TIFF with 32-bit floats.
//!
//! LeRobot converts images with torchvision, which reads 16-bit grey images as signed integers:
//! counts above 32,767 would become negative. Floats keep every count.

use std::io::{self, Write as _};

use flate2::Compression;
use flate2::write::ZlibEncoder;

use gripcast_base::error::{Error, Result};
use gripcast_imaging::DepthImage;

/// Offset of the directory, bytes: after the header.
const DIRECTORY: u32 = 8;
/// Number of entries in the directory, and the size of one, bytes.
const ENTRIES: u16 = 10;
const ENTRY_BYTES: u32 = 12;
/// Types of values.
const SHORT: u16 = 3;
const LONG: u16 = 4;

/// Encodes counts as floats, compressed by zlib.
///
/// # Errors
/// `Internal`: a defect of gripcast.
pub(super) fn encode(counts: &DepthImage) -> Result<Vec<u8>> {
    let (width, height) = counts.dimensions();
    let unwritable =
        |e: io::Error| Error::internal("cannot encode the depth image as TIFF").because(e);
    let mut pixels = ZlibEncoder::new(Vec::new(), Compression::default());
    for count in counts.iter() {
        let bytes = f32::from(*count).to_le_bytes();
        pixels.write_all(&bytes).map_err(unwritable)?;
    }
    let pixels = pixels.finish().map_err(unwritable)?;
    let length = u32::try_from(pixels.len())
        .map_err(|e| Error::internal("the depth image is too large for TIFF").because(e))?;
    // After the number of entries, the entries and the offset of the next directory.
    let strip = DIRECTORY + 2 + u32::from(ENTRIES) * ENTRY_BYTES + 4;
    let entries: [(u16, u16, u32); ENTRIES as usize] = [
        (256, LONG, width),
        (257, LONG, height),
        // Bits per sample.
        (258, SHORT, 32),
        // Compression: zlib.
        (259, SHORT, 8),
        // Black is zero.
        (262, SHORT, 1),
        // Offset of the only strip, samples per pixel, rows and bytes of the strip.
        (273, LONG, strip),
        (277, SHORT, 1),
        (278, LONG, height),
        (279, LONG, length),
        // Floating point.
        (339, SHORT, 3),
    ];
    let mut file = b"II*\0".to_vec();
    file.extend(DIRECTORY.to_le_bytes());
    file.extend(ENTRIES.to_le_bytes());
    for (tag, kind, value) in entries {
        file.extend(tag.to_le_bytes());
        file.extend(kind.to_le_bytes());
        file.extend(1_u32.to_le_bytes());
        file.extend(value.to_le_bytes());
    }
    file.extend(0_u32.to_le_bytes());
    file.extend(pixels);
    Ok(file)
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;

    use super::*;

    #[test]
    fn every_count_is_kept() {
        let counts =
            DepthImage::from_fn(3, 2, |x, y| image::Luma([(x * 30_000 + y * 5535) as u16]));
        assert_eq!(counts.iter().max(), Some(&65_535));
        let file = encode(&counts).unwrap();
        let mut pixels = Vec::new();
        let strip = 8 + 2 + 10 * 12 + 4;
        let mut decoder = flate2::read::ZlibDecoder::new(&file[strip..]);
        decoder.read_to_end(&mut pixels).unwrap();
        let floats: Vec<f32> = pixels
            .chunks_exact(4)
            .map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()))
            .collect();
        assert_eq!(
            floats,
            counts.iter().map(|n| f32::from(*n)).collect::<Vec<_>>()
        );
    }
}
