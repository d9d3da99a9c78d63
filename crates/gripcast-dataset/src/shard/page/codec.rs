//! Decompresses pages with a bound on the output size.

use std::io::Read;

use parquet::basic::Compression;

/// Maximum ratio of Snappy: a copy of 64 bytes takes 3.
const SNAPPY_RATIO: usize = 32;
/// Maximum ratio of LZ4: a byte of a match's length stands for 255 bytes.
const LZ4_RATIO: usize = 256;
/// Buffer of the Brotli decoder, bytes.
const BROTLI_BUFFER: usize = 4096;

/// Supported codecs, all implemented in Rust.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Codec {
    None,
    Snappy,
    Gzip,
    Zstd,
    Brotli,
    Lz4,
    /// LZ4 blocks with the sizes that Hadoop writes before them, or without.
    Lz4Hadoop,
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
            Compression::BROTLI(_) => Ok(Self::Brotli),
            Compression::LZ4_RAW => Ok(Self::Lz4),
            Compression::LZ4 => Ok(Self::Lz4Hadoop),
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
            Self::Brotli => {
                let decoder = brotli_decompressor::Decompressor::new(packed, BROTLI_BUFFER);
                read_bounded(decoder, size)?
            }
            Self::Lz4 => lz4_block(packed, size)?,
            Self::Lz4Hadoop => match lz4_hadoop(packed, size) {
                Some(bytes) => bytes,
                None => lz4_block(packed, size)?,
            },
        };
        if bytes.len() != size {
            return Err(sizes(bytes.len(), size));
        }
        Ok(bytes)
    }
}

fn lz4_block(packed: &[u8], size: usize) -> Result<Vec<u8>, String> {
    if size > packed.len().saturating_mul(LZ4_RATIO) {
        return Err(format!(
            "a page of {size} bytes cannot come from {} bytes of LZ4",
            packed.len()
        ));
    }
    lz4_flex::block::decompress(packed, size).map_err(|e| e.to_string())
}

/// Decompresses blocks after their sizes, big-endian; none if the bytes are no such blocks.
fn lz4_hadoop(mut packed: &[u8], size: usize) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    while let Some((sizes, rest)) = packed.split_first_chunk::<8>() {
        let [block, length] = sizes.as_chunks::<4>().0 else {
            return None;
        };
        let [block, length] = [block, length].map(|size| u32::from_be_bytes(*size) as usize);
        if block > size - bytes.len() || length > rest.len() {
            return None;
        }
        let (packed_block, next) = rest.split_at(length);
        bytes.extend(lz4_block(packed_block, block).ok()?);
        packed = next;
    }
    packed.is_empty().then_some(bytes)
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

    /// The test's page, compressed by PyPI's `brotli`.
    const BROTLI: &[u8] =
        b"\x1b\x3f\x06\x00\x04\x1c\x72\xa4\x07\x4a\xa1\x2d\xa0\x92\xaa\x10\xdf\x6a\x00\
                            \x65\xb1\x7a\xf8\x4b\x91\x00";

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn pages_round_trip_and_bombs_are_refused() {
        let page = b"sixteen bytes ..".repeat(100);
        let snappy = snap::raw::Encoder::new().compress_vec(&page).unwrap();
        let lz4 = lz4_flex::block::compress(&page);
        let sizes = [page.len() as u32, lz4.len() as u32].map(u32::to_be_bytes);
        let hadoop = [&sizes.concat(), &*lz4].concat();
        let level = ruzstd::encoding::CompressionLevel::Fastest;
        let zstd = ruzstd::encoding::compress_to_vec(&page[..], level);
        for (codec, packed) in [
            (Codec::None, page.clone()),
            (Codec::Snappy, snappy),
            (Codec::Gzip, gzip(&page)),
            (Codec::Zstd, zstd),
            (Codec::Brotli, BROTLI.to_vec()),
            (Codec::Lz4, lz4.clone()),
            (Codec::Lz4Hadoop, lz4),
            (Codec::Lz4Hadoop, hadoop),
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
