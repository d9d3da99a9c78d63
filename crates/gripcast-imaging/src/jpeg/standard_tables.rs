//! Standard Huffman tables, which motion-JPEG streams may omit.

use std::borrow::Cow;

use super::code;
use super::markers::JpegHeader;

/// A Huffman table of ITU T.81 (tables K.3 to K.6).
struct HuffmanTable {
    /// Class (0 = DC, 1 = AC) in the high nibble, slot in the low nibble.
    class_and_slot: u8,
    /// Number of codes of 1–16 bits.
    counts: [u8; 16],
    symbols: &'static [u8],
}

const DC_SYMBOLS: &[u8] = &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];

const TABLES: [HuffmanTable; 4] = [
    HuffmanTable {
        class_and_slot: 0x00,
        counts: [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0],
        symbols: DC_SYMBOLS,
    },
    HuffmanTable {
        class_and_slot: 0x10,
        counts: [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 125],
        symbols: &[
            0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51,
            0x61, 0x07, 0x22, 0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1,
            0x15, 0x52, 0xd1, 0xf0, 0x24, 0x33, 0x62, 0x72, 0x82, 0x09, 0x0a, 0x16, 0x17, 0x18,
            0x19, 0x1a, 0x25, 0x26, 0x27, 0x28, 0x29, 0x2a, 0x34, 0x35, 0x36, 0x37, 0x38, 0x39,
            0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55, 0x56, 0x57,
            0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x73, 0x74, 0x75,
            0x76, 0x77, 0x78, 0x79, 0x7a, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a, 0x92,
            0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7,
            0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3,
            0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8,
            0xd9, 0xda, 0xe1, 0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf1, 0xf2,
            0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9, 0xfa,
        ],
    },
    HuffmanTable {
        class_and_slot: 0x01,
        counts: [0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0],
        symbols: DC_SYMBOLS,
    },
    HuffmanTable {
        class_and_slot: 0x11,
        counts: [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 119],
        symbols: &[
            0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07,
            0x61, 0x71, 0x13, 0x22, 0x32, 0x81, 0x08, 0x14, 0x42, 0x91, 0xa1, 0xb1, 0xc1, 0x09,
            0x23, 0x33, 0x52, 0xf0, 0x15, 0x62, 0x72, 0xd1, 0x0a, 0x16, 0x24, 0x34, 0xe1, 0x25,
            0xf1, 0x17, 0x18, 0x19, 0x1a, 0x26, 0x27, 0x28, 0x29, 0x2a, 0x35, 0x36, 0x37, 0x38,
            0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55, 0x56,
            0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x73, 0x74,
            0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89,
            0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5,
            0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba,
            0xc2, 0xc3, 0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6,
            0xd7, 0xd8, 0xd9, 0xda, 0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf2,
            0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9, 0xfa,
        ],
    },
];

/// Writes `jpeg` to `out` with the standard tables before its first segment; its own tables
/// override them.
pub(super) fn with_standard_tables(jpeg: &[u8], out: &mut Vec<u8>) {
    let (start_of_image, segments) = jpeg.split_at(jpeg.len().min(2));
    out.clear();
    out.extend_from_slice(start_of_image);
    out.extend_from_slice(&[0xff, code::DHT]);
    let length = 2 + TABLES.iter().map(|t| 17 + t.symbols.len()).sum::<usize>();
    out.extend_from_slice(&(length as u16).to_be_bytes());
    for table in &TABLES {
        out.push(table.class_and_slot);
        out.extend_from_slice(&table.counts);
        out.extend_from_slice(table.symbols);
    }
    out.extend_from_slice(segments);
}

/// Converts a frame to a complete file: removes padding and adds missing standard Huffman tables.
#[must_use]
pub fn complete<'a>(bytes: &'a [u8], header: &JpegHeader) -> Cow<'a, [u8]> {
    let image = &bytes[..header.length.min(bytes.len())];
    if header.has_huffman_tables {
        return Cow::Borrowed(image);
    }
    let mut completed = Vec::new();
    with_standard_tables(image, &mut completed);
    Cow::Owned(completed)
}

#[cfg(test)]
mod tests {
    use super::super::{JpegDecoder, JpegScale, inspect};
    use super::*;
    use crate::{encode_jpeg, synthetic_gel};

    /// Removes the DHT segments.
    fn without_tables(jpeg: &[u8]) -> Vec<u8> {
        let mut out = jpeg[..2].to_vec();
        let mut at = 2;
        while jpeg[at + 1] != code::SOS {
            let length = 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
            if jpeg[at + 1] != code::DHT {
                out.extend_from_slice(&jpeg[at..at + length]);
            }
            at += length;
        }
        out.extend_from_slice(&jpeg[at..]);
        out
    }

    #[test]
    fn complete_file_has_tables_and_no_padding() {
        let jpeg = encode_jpeg(&synthetic_gel(16, 16, 1, 0.0), 90).unwrap();
        assert_eq!(complete(&jpeg, &inspect(&jpeg).unwrap()), jpeg);
        let mut sent = without_tables(&jpeg);
        sent.extend([0; 32]);
        let header = inspect(&sent).unwrap();
        assert!(!header.has_huffman_tables);
        let completed = complete(&sent, &header).into_owned();
        let now = inspect(&completed).unwrap();
        assert!(now.has_huffman_tables);
        assert_eq!(now.length, completed.len());
        let mut decoder = JpegDecoder::new().unwrap();
        let pixels = decoder
            .decode(&jpeg, JpegScale::Whole)
            .unwrap()
            .rgb
            .to_vec();
        assert_eq!(
            decoder.decode(&completed, JpegScale::Whole).unwrap().rgb,
            pixels
        );
    }

    #[test]
    fn tables_match_libjpeg() {
        let jpeg = encode_jpeg(&synthetic_gel(16, 16, 1, 0.0), 90).unwrap();
        let mut completed = Vec::new();
        with_standard_tables(&jpeg, &mut completed);
        for table in &TABLES {
            let length = (19 + table.symbols.len()) as u16;
            let mut segment = vec![0xff, code::DHT];
            segment.extend_from_slice(&length.to_be_bytes());
            segment.push(table.class_and_slot);
            segment.extend_from_slice(&table.counts);
            segment.extend_from_slice(table.symbols);
            assert!(jpeg.windows(segment.len()).any(|w| w == segment));
        }
        assert_eq!(completed.len(), jpeg.len() + 4 + 416);
        assert_eq!(completed[completed.len() - jpeg.len() + 2..], jpeg[2..]);
    }

    #[test]
    fn counts_match_symbols() {
        for table in &TABLES {
            let counted: usize = table.counts.iter().map(|n| usize::from(*n)).sum();
            assert_eq!(
                counted,
                table.symbols.len(),
                "table {:02x}",
                table.class_and_slot
            );
            let mut distinct = table.symbols.to_vec();
            distinct.sort_unstable();
            distinct.dedup();
            assert_eq!(
                distinct.len(),
                counted,
                "table {:02x}",
                table.class_and_slot
            );
        }
    }
}
