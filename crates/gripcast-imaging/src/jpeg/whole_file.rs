//! JPEG files of the frames that cameras send.

use std::borrow::Cow;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::code;
use super::damage::JpegDamage;
use super::entropy::{Walked, walk};
use super::markers::{JpegHeader, inspect_scan};
use super::standard_tables::standard_tables_segment;

/// Differences of a JPEG file from the frame that the camera sent. Its pixels are the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct JpegRepairs {
    /// Bytes removed before the start-of-image marker.
    #[serde(skip_serializing_if = "is_zero")]
    pub removed_before_start: u64,
    /// Stray bytes removed before restart markers and the end-of-image marker.
    #[serde(skip_serializing_if = "is_zero")]
    pub removed_before_markers: u64,
    /// Bytes removed behind the image.
    #[serde(skip_serializing_if = "is_zero")]
    pub removed_after_end: u64,
    /// Whether the standard Huffman tables were added.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub added_huffman_tables: bool,
    /// Whether the end-of-image marker was added.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub added_end_marker: bool,
}

impl fmt::Display for JpegRepairs {
    /// What the camera sent besides the image or left out: `4 bytes before the image, no end
    /// marker`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let bytes = |count: u64, place: &str| (count > 0).then(|| format!("{count} bytes {place}"));
        let parts = [
            bytes(self.removed_before_start, "before the image"),
            bytes(self.removed_before_markers, "before markers"),
            bytes(self.removed_after_end, "after the image"),
            self.added_huffman_tables
                .then(|| "no Huffman tables".to_owned()),
            self.added_end_marker.then(|| "no end marker".to_owned()),
        ];
        f.write_str(&parts.into_iter().flatten().collect::<Vec<_>>().join(", "))
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "signature of serde")]
fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// Converts a frame to a JPEG file that every decoder reads without warnings: removes what is not
/// part of the image, adds what motion JPEG may omit. Without repairs the bytes stay as they are.
///
/// # Errors
/// The damage of the marker structure.
pub fn whole_file(bytes: &[u8]) -> Result<(Cow<'_, [u8]>, Option<JpegRepairs>), JpegDamage> {
    let (header, scan) = inspect_scan(bytes)?;
    let walked = scan.and_then(|scan| walk(bytes, &scan));
    let walked = walked.filter(|walked| walked.stray_bytes > 0);
    let repairs = JpegRepairs {
        removed_before_start: header.start as u64,
        removed_before_markers: walked
            .as_ref()
            .map_or(0, |walked| walked.stray_bytes as u64),
        removed_after_end: (bytes.len() - header.end) as u64,
        added_huffman_tables: !header.has_huffman_tables,
        added_end_marker: !header.has_end_marker,
    };
    if repairs == JpegRepairs::default() {
        return Ok((Cow::Borrowed(bytes), None));
    }
    let mut file = Vec::new();
    write_file(bytes, &header, walked.as_ref(), &mut file);
    Ok((Cow::Owned(file), Some(repairs)))
}

/// Writes the file of a frame to `out`; without its stray bytes if it was `walked`.
pub(super) fn write_file(
    bytes: &[u8],
    header: &JpegHeader,
    walked: Option<&Walked>,
    out: &mut Vec<u8>,
) {
    out.clear();
    let image = &bytes[header.start..header.end];
    let (start_of_image, segments) = image.split_at(image.len().min(2));
    out.extend_from_slice(start_of_image);
    if !header.has_huffman_tables {
        standard_tables_segment(out);
    }
    match walked.and_then(|walked| Some((walked.intervals.first()?.start, walked))) {
        None => out.extend_from_slice(segments),
        Some((data, walked)) => {
            out.extend_from_slice(&bytes[header.start + 2..data]);
            for (number, interval) in walked.intervals.iter().enumerate() {
                if number > 0 {
                    out.extend([0xff, code::RST0 + ((number - 1) % 8) as u8]);
                }
                out.extend_from_slice(&bytes[interval.clone()]);
            }
        }
    }
    if walked.is_some() || !header.has_end_marker {
        out.extend([0xff, code::EOI]);
    }
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
        assert_eq!(whole_file(&jpeg), Ok((jpeg.as_slice().into(), None)));
        let mut sent = without_tables(&jpeg);
        sent.extend([0; 32]);
        let header = inspect(&sent).unwrap();
        assert!(!header.has_huffman_tables);
        let (completed, repairs) = whole_file(&sent).unwrap();
        let expected = JpegRepairs {
            removed_after_end: 32,
            added_huffman_tables: true,
            ..JpegRepairs::default()
        };
        assert_eq!(repairs, Some(expected));
        assert_eq!(whole_file(&completed).unwrap().1, None);
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
}
