//! Reads the pages of a column chunk; checks every size before allocating memory.
//!
//! Needed until the page reader of the `parquet` crate checks the sizes in page headers before it
//! allocates memory (arrow-rs issue 10734).

mod codec;
mod header;

use std::sync::Arc;

use bytes::Bytes;
use parquet::basic::Encoding;
use parquet::column::page::{Page, PageMetadata, PageReader};
use parquet::errors::{ParquetError, Result};
use parquet::file::metadata::ColumnChunkMetaData;

use self::codec::Codec;
use self::header::PageHeader;
use super::source::Source;

/// Maximum size of a page header, which may contain the smallest and largest value.
const MAX_HEADER: u64 = 64 << 10;
/// Maximum decompressed size of a page, bytes. Writers start a new page after about 1 MiB, but
/// only every few hundred values.
const MAX_PAGE: i64 = 512 << 20;

/// Reads the pages of one column chunk in order.
pub(super) struct ChunkPages {
    source: Arc<Source>,
    codec: Codec,
    /// Unread range of the chunk in the file.
    offset: u64,
    end: u64,
    /// Maximum number of values in the rest of the chunk.
    values: i64,
    /// Header of the next page, once peeked.
    peeked: Option<PageHeader>,
}

impl ChunkPages {
    /// # Errors
    /// The chunk is outside the file, or its compression is unsupported.
    pub(super) fn new(source: Arc<Source>, chunk: &ColumnChunkMetaData) -> Result<Self> {
        // An unsupported compression is no damage.
        let codec = Codec::new(chunk.compression()).map_err(ParquetError::NYI)?;
        let data = chunk.data_page_offset();
        // Some writers store 0 instead of none.
        let dictionary = chunk.dictionary_page_offset().filter(|&at| at > 0);
        let start = dictionary.map_or(data, |at| at.min(data));
        let end = start.checked_add(chunk.compressed_size());
        let inside = |end: &i64| *end >= start && (*end).cast_unsigned() <= source.size();
        let (true, Some(end)) = (start >= 0, end.filter(inside)) else {
            let size = chunk.compressed_size();
            let what = format!("its range (offset {start}, {size} bytes) is outside the file");
            return Err(damaged(what));
        };
        Ok(Self {
            source,
            codec,
            offset: start.cast_unsigned(),
            end: end.cast_unsigned(),
            values: chunk.num_values(),
            peeked: None,
        })
    }

    fn remaining(&self) -> u64 {
        self.end - self.offset
    }

    /// Peeks at the header of the next page that is not an index.
    fn peek(&mut self) -> Result<Option<&PageHeader>> {
        while self.peeked.is_none() && self.remaining() > 0 {
            let window = self.read(self.remaining().min(MAX_HEADER))?;
            let Some((header, length)) = PageHeader::parse(&window) else {
                return Err(damaged("cannot read a page header"));
            };
            self.offset += length as u64;
            self.check(&header)?;
            if header.kind == 1 {
                self.offset += header.compressed.cast_unsigned();
            } else {
                self.peeked = Some(header);
            }
        }
        Ok(self.peeked.as_ref())
    }

    fn check(&self, header: &PageHeader) -> Result<()> {
        let in_file = 0..=i64::try_from(self.remaining()).unwrap_or(i64::MAX);
        if !in_file.contains(&header.compressed) {
            let what = format!("a page of {} bytes is outside the file", header.compressed);
            return Err(damaged(what));
        }
        if !(0..=MAX_PAGE).contains(&header.uncompressed) {
            let what = format!(
                "a page has {} bytes when decompressed, at most {MAX_PAGE} are supported",
                header.uncompressed
            );
            return Err(damaged(what));
        }
        let plain = self.codec == Codec::None || (header.kind == 3 && !header.is_compressed);
        if plain && header.compressed != header.uncompressed {
            return Err(damaged("an uncompressed page has two sizes"));
        }
        // A dictionary entry takes at least 4 bytes: INT32, or the length of a string.
        let max_values = match header.kind {
            2 => header.uncompressed / 4,
            _ => self.values,
        };
        if !(0..=max_values).contains(&header.num_values) {
            let what = format!(
                "a page has {} values, expected at most {max_values}",
                header.num_values
            );
            return Err(damaged(what));
        }
        let levels = [header.definition_bytes, header.repetition_bytes];
        let fits = levels
            .iter()
            .all(|bytes| (0..=header.uncompressed).contains(bytes))
            && levels.iter().sum::<i64>() <= header.uncompressed;
        let counts = [header.num_nulls, header.num_rows];
        if !fits || !counts.iter().all(|n| (0..=header.num_values).contains(n)) {
            return Err(damaged("the counts in a page header contradict each other"));
        }
        Ok(())
    }

    fn read(&self, length: u64) -> Result<Bytes> {
        let bytes = self.source.read(self.offset, length);
        bytes.map_err(|e| ParquetError::External(Box::new(e)))
    }

    fn contents(&self, header: &PageHeader, packed: &Bytes) -> Result<Bytes> {
        if let Some(expected) = header.crc {
            let mut crc = flate2::Crc::new();
            crc.update(packed);
            if i64::from(crc.sum().cast_signed()) != expected {
                return Err(damaged("the checksum of a page does not match"));
            }
        }
        // In version 2 the levels come first and are never compressed.
        let levels = (header.definition_bytes + header.repetition_bytes) as usize;
        if self.codec == Codec::None || !header.is_compressed {
            return Ok(packed.clone());
        }
        let size = header.uncompressed as usize;
        let (Some(values), Some(size)) = (packed.get(levels..), size.checked_sub(levels)) else {
            return Err(damaged("a page is shorter than its levels"));
        };
        // Without values there may be no compressed bytes.
        if size == 0 {
            return Ok(packed.slice(..levels));
        }
        let values = self.codec.decompress(values, size).map_err(damaged)?;
        if levels == 0 {
            return Ok(values.into());
        }
        Ok([&packed[..levels], &values].concat().into())
    }
}

impl PageReader for ChunkPages {
    fn get_next_page(&mut self) -> Result<Option<Page>> {
        self.peek()?;
        let Some(header) = self.peeked.take() else {
            return Ok(None);
        };
        let packed = self.read(header.compressed.cast_unsigned())?;
        let buf = self.contents(&header, &packed)?;
        self.offset += header.compressed.cast_unsigned();
        if header.kind != 2 {
            self.values -= header.num_values;
        }
        page(&header, buf).map(Some)
    }

    fn peek_next_page(&mut self) -> Result<Option<PageMetadata>> {
        Ok(self.peek()?.map(|header| PageMetadata {
            num_rows: (header.kind == 3).then_some(header.num_rows as usize),
            num_levels: (header.kind != 2).then_some(header.num_values as usize),
            is_dict: header.kind == 2,
        }))
    }

    fn skip_next_page(&mut self) -> Result<()> {
        self.get_next_page().map(|_| ())
    }
}

impl Iterator for ChunkPages {
    type Item = Result<Page>;

    fn next(&mut self) -> Option<Self::Item> {
        self.get_next_page().transpose()
    }
}

/// Converts a page to the type of the Parquet crate; the counts are already checked.
fn page(header: &PageHeader, buf: Bytes) -> Result<Page> {
    let num_values = header.num_values as u32;
    let encoding = encoding(header.encoding)?;
    Ok(match header.kind {
        0 => Page::DataPage {
            buf,
            num_values,
            encoding,
            def_level_encoding: self::encoding(header.definition_encoding)?,
            rep_level_encoding: self::encoding(header.repetition_encoding)?,
            statistics: None,
        },
        2 => Page::DictionaryPage {
            buf,
            num_values,
            encoding,
            is_sorted: false,
        },
        3 => Page::DataPageV2 {
            buf,
            num_values,
            encoding,
            num_nulls: header.num_nulls as u32,
            num_rows: header.num_rows as u32,
            def_levels_byte_len: header.definition_bytes as u32,
            rep_levels_byte_len: header.repetition_bytes as u32,
            is_compressed: header.is_compressed,
            statistics: None,
        },
        kind => return Err(damaged(format!("unknown page type {kind}"))),
    })
}

fn encoding(number: i64) -> Result<Encoding> {
    Ok(match number {
        // Decoders of delta encodings allocate as many values as the data claim.
        5..=7 => {
            let what = "a page has a delta encoding, which is not supported; write the file again \
                        with the default encodings of pandas or datasets";
            return Err(damaged(what));
        }
        0 => Encoding::PLAIN,
        2 => Encoding::PLAIN_DICTIONARY,
        3 => Encoding::RLE,
        8 => Encoding::RLE_DICTIONARY,
        9 => Encoding::BYTE_STREAM_SPLIT,
        _ => return Err(damaged(format!("unknown page encoding {number}"))),
    })
}

fn damaged(what: impl Into<String>) -> ParquetError {
    ParquetError::General(what.into())
}
