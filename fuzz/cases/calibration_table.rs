//! The calibration table that a D435 answers with over its UVC extension unit.
//!
//! The checksum is put right, or nearly every input would end there.

use gripcast_capture::calibration::ColourTable;

const HEADER_BYTES: usize = 16;
const CHECKSUM: std::ops::Range<usize> = 12..16;

/// Panics where something is wrong.
pub(crate) fn check(input: &[u8]) {
    let mut payload = input.to_vec();
    let size = payload.get(4..8).and_then(|b| b.try_into().ok());
    let size = size.map_or(0, u32::from_le_bytes) as usize;
    if let Some(table) = payload
        .get(HEADER_BYTES..)
        .and_then(|rest| rest.get(..size))
    {
        let checksum = crc32(table).to_le_bytes();
        payload[CHECKSUM].copy_from_slice(&checksum);
    }
    if let Ok(table) = ColourTable::parse(&payload) {
        for (width, height) in [(640, 480), (1920, 1080), (424, 240), (1, 1)] {
            if let Ok(intrinsics) = table.intrinsics(width, height) {
                intrinsics
                    .validate()
                    .expect("intrinsics that were given are valid");
            }
        }
    }
}

/// CRC-32 (IEEE 802.3).
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg())
        })
    })
}
