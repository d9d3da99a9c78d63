//! Reads records and chunks of MCAP files in bounded memory.
//!
//! The crate `mcap` parses; it gets the bytes of a file piece by piece. Only records that are needed
//! are parsed: a file may come from elsewhere.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

/// Maximum size of a record or chunk, bytes; the chunks of the black box have 4 MiB and a frame.
const MAX_RECORD_BYTES: usize = 256 << 20;
/// Opcode and length of a record, bytes.
const RECORD_HEAD: u64 = 1 + 8;

/// Position of a chunk record in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ChunkPlace {
    /// Offset of the record, bytes.
    offset: u64,
    /// Length of the record, bytes.
    length: u64,
}

/// Options that all readers share: the end of a file may be missing.
fn options() -> LinearReaderOptions {
    LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(MAX_RECORD_BYTES)
}

/// Calls `each` with every record of a file up to its footer, with opcode and body; with a chunk its
/// place, too. Chunks are not unpacked. Returns whether there is a footer: a file without one was not
/// closed.
///
/// # Errors
/// The first damage, an error of reading, or the first error of `each`.
pub(super) fn scan(
    file: &mut File,
    mut each: impl FnMut(u8, &[u8], ChunkPlace) -> Result<(), McapError>,
) -> Result<bool, McapError> {
    let mut left = file.metadata()?.len();
    let mut reader = LinearReader::new_with_options(options().with_emit_chunks(true));
    let mut offset = mcap::MAGIC.len() as u64;
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(wanted) => {
                // A damaged length must not reserve more memory than the file can fill.
                let size = wanted.min(usize::try_from(left).unwrap_or(usize::MAX));
                let read = file.read(reader.insert(size.max(1)))?;
                left = left.saturating_sub(read as u64);
                reader.notify_read(read);
            }
            LinearReadEvent::Record { opcode, data } => {
                let length = RECORD_HEAD + data.len() as u64;
                each(opcode, data, ChunkPlace { offset, length })?;
                offset += length;
                if opcode == op::FOOTER {
                    return Ok(true);
                }
            }
        }
    }
    Ok(false)
}

/// Reads the body of a chunk record.
///
/// # Errors
/// Those of reading; `UnexpectedEof` where the file has become shorter.
pub(super) fn read_chunk(file: &mut File, place: ChunkPlace) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(place.offset + RECORD_HEAD))?;
    let length = place.length - RECORD_HEAD;
    let mut body = Vec::new();
    file.take(length).read_to_end(&mut body)?;
    if body.len() as u64 != length {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    Ok(body)
}

/// Calls `each` with every schema, channel and message of a chunk. The checksum of the chunk is
/// checked before the first.
///
/// # Errors
/// Damage, an unsupported compression, or the first error of `each`.
pub(super) fn unpack<E: From<McapError>>(
    body: &[u8],
    mut each: impl FnMut(Record<'_>) -> Result<(), E>,
) -> Result<(), E> {
    let mut reader = LinearReader::new_with_options(options().with_skip_start_magic(true));
    let size = RECORD_HEAD as usize + body.len();
    let place = reader.insert(size);
    place[0] = op::CHUNK;
    place[1..RECORD_HEAD as usize].copy_from_slice(&(body.len() as u64).to_le_bytes());
    place[RECORD_HEAD as usize..].copy_from_slice(body);
    reader.notify_read(size);
    while let Some(event) = reader.next_event() {
        match event? {
            // Everything is there: the chunk is finished, or damaged.
            LinearReadEvent::ReadRequest(_) => reader.notify_read(0),
            LinearReadEvent::Record { opcode, data } => {
                if [op::SCHEMA, op::CHANNEL, op::MESSAGE].contains(&opcode) {
                    each(mcap::parse_record(opcode, data)?)?;
                }
            }
        }
    }
    Ok(())
}
