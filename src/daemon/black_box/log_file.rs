//! One MCAP file while it is being written.

use std::collections::BTreeMap;
use std::io::{self, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions};

use super::Origin;
use super::clock::WallClock;
use super::messages::{ChannelForm, camera_channel, encode_frame, note_channel};
use super::queue::{Content, Entry, Topic};
use super::shelf::Output;
use gripcast_imaging::{PixelFormat, Role};

/// Size from which a chunk is written, bytes. Smaller ones make a longer index, larger ones more
/// to read for one image.
const CHUNK_BYTES: u64 = 4 << 20;

/// Age from which a chunk is written, ns: what is in it is lost when the program is killed.
pub(super) const CHUNK_NS: u64 = 100_000_000;

/// Name of the record that says where a file comes from.
const ORIGIN_RECORD: &str = "gripcast.black_box";

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum ChannelKey {
    Camera(Role, PixelFormat),
    Note(Topic),
}

/// A file that takes entries. A chunk is put together in memory and written whole, so that a file
/// that was never closed ends behind a chunk, or inside the last one.
pub(super) struct LogFile {
    writer: mcap::Writer<Counting>,
    written: Arc<AtomicU64>,
    clock: WallClock,
    channels: BTreeMap<ChannelKey, u16>,
    /// Notes written, by topic: their sequence.
    notes: BTreeMap<Topic, u32>,
    chunk: Option<Chunk>,
    message: Vec<u8>,
}

#[derive(Clone, Copy, Debug)]
struct Chunk {
    bytes: u64,
    since_ns: u64,
}

impl LogFile {
    /// Begins a file with where it comes from.
    pub(super) fn begin(
        output: Box<dyn Output>,
        clock: WallClock,
        origin: &Origin,
    ) -> io::Result<Self> {
        let written = Arc::new(AtomicU64::new(0));
        let counting = Counting {
            output,
            written: Arc::clone(&written),
        };
        // Camera frames are compressed or noise; the rest is small.
        let mut writer = WriteOptions::new()
            .compression(None)
            .chunk_size(None)
            .disable_seeking(true)
            .library(concat!("gripcast ", env!("CARGO_PKG_VERSION")))
            .create(counting)
            .map_err(as_io)?;
        let mut metadata = origin.clone();
        let offset = clock.offset_ns.to_string();
        metadata.insert("wall_minus_monotonic_ns".into(), offset);
        let record = Metadata {
            name: ORIGIN_RECORD.into(),
            metadata,
        };
        writer.write_metadata(&record).map_err(as_io)?;
        Ok(Self {
            writer,
            written,
            clock,
            channels: BTreeMap::new(),
            notes: BTreeMap::new(),
            chunk: None,
            message: Vec::new(),
        })
    }

    /// Bytes of the file so far, with the chunk that is not written yet.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes_on_disk() + self.chunk.map_or(0, |chunk| chunk.bytes)
    }

    /// Bytes that the operating system has.
    pub(super) fn bytes_on_disk(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// Adds an entry to the present chunk; true where that chunk was written then.
    pub(super) fn add(&mut self, entry: Entry) -> io::Result<bool> {
        let log_ns = self.clock.wall_ns(entry.at_ns);
        let (key, sequence, publish_ns) = match entry.content {
            Content::Frame { role, frame } => {
                let key = ChannelKey::Camera(role, frame.format);
                let (sequence, driver_ns) = (frame.sequence, frame.driver_time_ns);
                let capture_ns = self.clock.wall_ns(driver_ns);
                encode_frame(role, frame, capture_ns, &mut self.message);
                (key, sequence, capture_ns)
            }
            Content::Note { topic, text } => {
                self.message = text;
                let count = self.notes.entry(topic).or_default();
                let sequence = *count;
                *count = count.wrapping_add(1);
                (ChannelKey::Note(topic), sequence, log_ns)
            }
        };
        let header = MessageHeader {
            channel_id: self.channel(key)?,
            sequence,
            log_time: log_ns,
            publish_time: publish_ns,
        };
        self.writer
            .write_to_known_channel(&header, &self.message)
            .map_err(as_io)?;
        let chunk = self.chunk.get_or_insert(Chunk {
            bytes: 0,
            since_ns: entry.at_ns,
        });
        chunk.bytes += self.message.len() as u64;
        let is_due =
            chunk.bytes >= CHUNK_BYTES || entry.at_ns.saturating_sub(chunk.since_ns) >= CHUNK_NS;
        if is_due {
            self.write_chunk()?;
        }
        Ok(is_due)
    }

    /// Hands the present chunk to the operating system: a killed program does not lose it.
    pub(super) fn write_chunk(&mut self) -> io::Result<()> {
        if self.chunk.take().is_some() {
            self.writer.flush().map_err(as_io)?;
        }
        Ok(())
    }

    /// Writes the index; the file is whole then. Returns its bytes.
    pub(super) fn close(mut self) -> io::Result<u64> {
        self.writer.finish().map_err(as_io)?;
        Ok(self.bytes_on_disk())
    }

    fn channel(&mut self, key: ChannelKey) -> io::Result<u16> {
        if let Some(id) = self.channels.get(&key) {
            return Ok(*id);
        }
        let (form, about) = match key {
            ChannelKey::Camera(role, format) => (
                camera_channel(role, format),
                BTreeMap::from([("format".to_owned(), format.to_string())]),
            ),
            ChannelKey::Note(topic) => (note_channel(topic), BTreeMap::new()),
        };
        let ChannelForm {
            topic,
            schema,
            schema_encoding,
            schema_data,
            message_encoding,
        } = form;
        let schema = self
            .writer
            .add_schema(schema, schema_encoding, &schema_data)
            .map_err(as_io)?;
        let id = self
            .writer
            .add_channel(schema, &topic, message_encoding, &about)
            .map_err(as_io)?;
        self.channels.insert(key, id);
        Ok(id)
    }
}

fn as_io(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

/// Counts what is written.
struct Counting {
    output: Box<dyn Output>,
    written: Arc<AtomicU64>,
}

impl Write for Counting {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.output.write(bytes)?;
        self.written.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.output.flush()
    }
}

impl Seek for Counting {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.output.seek(to)
    }
}
