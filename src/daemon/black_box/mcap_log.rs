//! An MCAP file during writing.

use std::collections::BTreeMap;
use std::io::{self, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions};

use super::Provenance;
use super::clock::WallClock;
use super::log_dir::LogFile;
use super::queue::{Content, Entry};
use gripcast_imaging::{PixelFormat, Role};
use gripcast_interop::black_box::{
    CLOCK_OFFSET, METADATA_RECORD, Topic, camera_channel, encode_frame, json_channel,
};

/// Size at which a chunk is written, bytes. Smaller chunks make a longer index, larger ones cost
/// more reading per image.
const CHUNK_BYTES: u64 = 4 << 20;

/// Age at which a chunk is written, ns: a killed program loses the current chunk.
pub(super) const CHUNK_NS: u64 = 100_000_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum ChannelKey {
    Camera(Role, PixelFormat),
    Json(Topic),
}

/// An open MCAP file. Chunks are assembled in memory and written in one piece, so that a file that
/// was not closed is damaged in its last chunk only.
pub(super) struct McapLog {
    writer: mcap::Writer<CountingWriter>,
    written: Arc<AtomicU64>,
    clock: WallClock,
    channels: BTreeMap<ChannelKey, u16>,
    /// Sequence number of the next JSON message, by topic.
    sequences: BTreeMap<Topic, u32>,
    chunk: Option<Chunk>,
    message: Vec<u8>,
}

#[derive(Clone, Copy, Debug)]
struct Chunk {
    bytes: u64,
    since_ns: u64,
}

impl McapLog {
    /// Starts a file with a metadata record.
    pub(super) fn start(
        file: Box<dyn LogFile>,
        clock: WallClock,
        mut metadata: Provenance,
    ) -> io::Result<Self> {
        let written = Arc::new(AtomicU64::new(0));
        let counting = CountingWriter {
            file,
            written: Arc::clone(&written),
        };
        // Camera frames do not compress well and the rest is small.
        let mut writer = WriteOptions::new()
            .compression(None)
            .chunk_size(None)
            .disable_seeking(true)
            .library(concat!("gripcast ", env!("CARGO_PKG_VERSION")))
            .create(counting)
            .map_err(as_io)?;
        let offset = clock.offset_ns.to_string();
        metadata.insert(CLOCK_OFFSET.into(), offset);
        let record = Metadata {
            name: METADATA_RECORD.into(),
            metadata,
        };
        writer.write_metadata(&record).map_err(as_io)?;
        Ok(Self {
            writer,
            written,
            clock,
            channels: BTreeMap::new(),
            sequences: BTreeMap::new(),
            chunk: None,
            message: Vec::new(),
        })
    }

    /// Returns the size of the file including the current chunk, bytes.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes_on_disk() + self.chunk.map_or(0, |chunk| chunk.bytes)
    }

    /// Returns the number of bytes passed to the operating system.
    pub(super) fn bytes_on_disk(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// Adds an entry to the current chunk; returns whether the chunk was then written.
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
            Content::Json { topic, text } => {
                self.message = text;
                let next = self.sequences.entry(topic).or_default();
                let sequence = *next;
                *next = next.wrapping_add(1);
                (ChannelKey::Json(topic), sequence, log_ns)
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

    /// Passes the current chunk to the operating system.
    pub(super) fn write_chunk(&mut self) -> io::Result<()> {
        if self.chunk.take().is_some() {
            self.writer.flush().map_err(as_io)?;
        }
        Ok(())
    }

    /// Writes the index and returns the final size of the file, bytes.
    pub(super) fn close(mut self) -> io::Result<u64> {
        self.writer.finish().map_err(as_io)?;
        Ok(self.bytes_on_disk())
    }

    fn channel(&mut self, key: ChannelKey) -> io::Result<u16> {
        if let Some(id) = self.channels.get(&key) {
            return Ok(*id);
        }
        let (channel, metadata) = match key {
            ChannelKey::Camera(role, format) => (
                camera_channel(role, format),
                BTreeMap::from([("format".to_owned(), format.to_string())]),
            ),
            ChannelKey::Json(topic) => (json_channel(topic), BTreeMap::new()),
        };
        let writer = &mut self.writer;
        let id = writer
            .add_schema(
                channel.schema,
                channel.schema_encoding,
                &channel.schema_data,
            )
            .and_then(|schema| {
                writer.add_channel(schema, &channel.topic, channel.message_encoding, &metadata)
            })
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

/// Writer that counts the written bytes.
struct CountingWriter {
    file: Box<dyn LogFile>,
    written: Arc<AtomicU64>,
}

impl Write for CountingWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.written.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for CountingWriter {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}
