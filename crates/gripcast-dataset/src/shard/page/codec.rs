//! Decompresses pages with a bound on the output size.

use std::io::Read;

use parquet::basic::Compression;

/// Maximum ratio of Snappy: a copy of 64 bytes takes 3.
const SNAPPY_RATIO: usize = 32;

/// Supported codecs, all implemented in Rust.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Codec {
    None,
    Snappy,
    Gzip,
    Zstd,
}

impl Codec {
    /// # Errors
    /// An unsupported compression and its remedy.
    pub(super) fn new(compression: Compression) -> Result<Self, String> {
        match compression {
            Compression::UNCOMPRESSED => Ok(Self::None),
            Compression::SNAPPY => Ok(Self::Snappy),
            Compression::GZIP(_) => Ok(Self::Gzip),
            Compression::ZSTD(_) => Ok(Self::Zstd),
            other => Err(format!(
                "is compressed with {other}, which is not supported; write the file again with \
                 compression=\"snappy\""
            )),
        }
    }

    /// Decompresses `packed` to exactly `size` bytes.
    ///
    /// # Errors
    /// A description of the damage.
    pub(super) fn decompress(self, packed: &[u8], size: usize) -> Result<Vec<u8>, String> {
        let bytes = match self {
            Self::None => packed.to_vec(),
            Self::Snappy => {
                let claimed = snap::raw::decompress_len(packed).map_err(|e| e.to_string())?;
                if claimed != size || claimed > packed.len().saturating_mul(SNAPPY_RATIO) {
                    return Err(sizes(claimed, size));
                }
                let mut decoder = snap::raw::Decoder::new();
                decoder.decompress_vec(packed).map_err(|e| e.to_string())?
            }
            Self::Gzip => read_bounded(flate2::read::MultiGzDecoder::new(packed), size)?,
            Self::Zstd => {
                let decoder = ruzstd::decoding::StreamingDecoder::new(packed);
                read_bounded(decoder.map_err(|e| e.to_string())?, size)?
            }
        };
        if bytes.len() != size {
            return Err(sizes(bytes.len(), size));
        }
        Ok(bytes)
    }
}

/// Reads at most one byte more than expected; memory grows with the actual size.
fn read_bounded(reader: impl Read, size: usize) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let mut reader = reader.take(size as u64 + 1);
    reader.read_to_end(&mut bytes).map_err(|e| e.to_string())?;
    Ok(bytes)
}

fn sizes(found: usize, expected: usize) -> String {
    format!("expected a page of {expected} bytes, found {found}")
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn pages_round_trip_and_bombs_are_refused() {
        let page = b"sixteen bytes ..".repeat(100);
        let snappy = snap::raw::Encoder::new().compress_vec(&page).unwrap();
        let level = ruzstd::encoding::CompressionLevel::Fastest;
        let zstd = ruzstd::encoding::compress_to_vec(&page[..], level);
        for (codec, packed) in [
            (Codec::None, page.clone()),
            (Codec::Snappy, snappy),
            (Codec::Gzip, gzip(&page)),
            (Codec::Zstd, zstd),
        ] {
            assert_eq!(codec.decompress(&packed, page.len()).unwrap(), page);
            for size in [0, page.len() - 1, page.len() + 1, usize::MAX >> 1] {
                assert!(codec.decompress(&packed, size).is_err(), "{codec:?} {size}");
            }
            assert!(
                codec
                    .decompress(&packed[..packed.len() / 2], page.len())
                    .is_err()
            );
        }
        let bomb = gzip(&vec![0; 10 << 20]);
        let error = Codec::Gzip.decompress(&bomb, 100).unwrap_err();
        assert!(error.contains("found 101"), "{error}");
    }
}
