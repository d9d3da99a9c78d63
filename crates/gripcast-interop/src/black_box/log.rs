//! Where the frames of a collection are in the files of its black box.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io;

use mcap::McapError;
use mcap::records::{Channel, MessageHeader, Metadata, Record, op};
use serde::Deserialize;

use super::chunk::{ChunkPlace, read_chunk, scan, unpack};
use super::messages::{CAMERA_TOPIC, ImageSchema, SHEAR_TOPIC, decode_frame};
use super::{CLOCK_OFFSET, METADATA_RECORD};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind};
use gripcast_imaging::{Frame, Role};
use gripcast_shear::FingerForce;

/// Ending of the files.
const SUFFIX: &str = ".mcap";

/// The files of a black box, and where each frame is in them.
///
/// Opening reads all files once; their contents stay on disk. Memory use: one chunk, and about
/// 100 bytes per frame.
#[derive(Debug)]
pub struct BlackBoxLog {
    parts: Vec<Part>,
    chunks: Vec<Chunk>,
    collections: Vec<Collection>,
    notes: Vec<String>,
}

/// A file.
#[derive(Debug)]
struct Part {
    path: BeneathPath,
    channels: BTreeMap<u16, Kind>,
}

/// What the messages of a channel are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Camera(Role, ImageSchema),
    Shear,
}

/// A chunk of a file.
#[derive(Clone, Copy, Debug)]
struct Chunk {
    /// Index of the file.
    part: usize,
    place: ChunkPlace,
    clock_offset_ns: i128,
}

/// The frames of one collection, which may fill several files.
#[derive(Debug, Default)]
pub struct Collection {
    /// Wall clock minus `CLOCK_MONOTONIC`, ns.
    pub clock_offset_ns: i128,
    /// Chunk of each frame, for [`BlackBoxLog::read`], by role and driver time, ns.
    pub frames: BTreeMap<Role, BTreeMap<u64, usize>>,
    /// Chunk of the shear of a gel, by role and driver time of the frame, ns.
    pub shear: BTreeMap<(Role, u64), usize>,
}

/// A message of the log.
#[derive(Debug)]
pub enum LoggedMessage<'a> {
    /// A frame of a camera.
    Frame(FrameMessage<'a>),
    /// The shear of a gel in one frame.
    Shear(ShearMessage),
}

/// A frame of a camera, encoded.
#[derive(Clone, Copy, Debug)]
pub struct FrameMessage<'a> {
    /// Role of the camera.
    pub role: Role,
    /// Driver's capture time, ns.
    pub driver_time_ns: u64,
    sequence: u32,
    schema: ImageSchema,
    data: &'a [u8],
}

impl FrameMessage<'_> {
    /// Returns the frame as the camera sent it; its image is not decoded.
    ///
    /// # Errors
    /// `Input`: the message is damaged.
    pub fn frame(&self) -> Result<Frame> {
        Ok(Frame {
            sequence: self.sequence,
            driver_time_ns: self.driver_time_ns,
            received_ns: self.driver_time_ns,
            ..decode_frame(self.schema, self.data)?
        })
    }
}

/// The shear of a gel in one frame, as on the topic `/shear`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct ShearMessage {
    /// The gel.
    pub role: Role,
    /// Driver time of the frame, ns.
    pub frame_time_ns: u64,
    /// Force on the gel.
    #[serde(default)]
    pub force: Option<FingerForce>,
    /// Gel markers.
    #[serde(default)]
    pub markers: Option<MarkerValues>,
}

/// Gel markers of a frame.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct MarkerValues {
    /// Rows, columns, values.
    pub shape: Vec<usize>,
    /// Row-major; `None`: no value.
    pub values: Vec<Option<f32>>,
}

/// What a file has, while it is scanned.
#[derive(Default)]
struct Scan {
    clock_offset_ns: Option<i128>,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Kind>,
    chunks: Vec<ChunkPlace>,
    /// Role, capture time on the wall clock, index in `chunks`.
    frames: Vec<(Role, u64, usize)>,
    shear: Vec<(Role, u64, usize)>,
    /// Shear messages that are not as gripcast writes them.
    foreign_shear: usize,
}

impl BlackBoxLog {
    /// Scans all `.mcap` files of a directory. Files that were not closed, or are damaged, are read
    /// up to the damage, with a note.
    ///
    /// # Errors
    /// `NotFound`: no directory, or no such files. `Input`: a file that is no black box of gripcast,
    /// or is compressed. `Permission`, `Io`, …: a file cannot be read.
    pub fn open(directory: &BeneathPath) -> Result<Self> {
        let shown = directory.display().to_string();
        let remedy = "collect with `--black-box`, or name the directory of the log";
        let missing = |what: &str| Error::not_found(what).at(&shown).remedy(remedy);
        let entries = directory.entries().map_err(|e| match e.kind() {
            io::ErrorKind::NotFound => missing("the black box does not exist"),
            _ => Error::io("cannot read the directory of the black box", e).at(&shown),
        })?;
        let is_log = |path: &BeneathPath| path.name().ends_with(SUFFIX);
        let files: Vec<_> = entries.into_iter().filter(is_log).collect();
        if files.is_empty() {
            return Err(missing("the black box has no .mcap files"));
        }
        let mut log = Self {
            parts: Vec::new(),
            chunks: Vec::new(),
            collections: Vec::new(),
            notes: Vec::new(),
        };
        for path in files {
            let shown = path.display().to_string();
            log.add(path).map_err(|e| e.at(shown))?;
        }
        Ok(log)
    }

    /// Collections, in the order of their first files.
    pub fn collections(&self) -> &[Collection] {
        &self.collections
    }

    /// Notes on files that were read only in part.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Calls `each` with the messages of some chunks, in the order of the log.
    ///
    /// # Errors
    /// The first error of `each`; `Input`, `Io`, …: a file was changed or cannot be read.
    pub fn read(
        &self,
        chunks: &BTreeSet<usize>,
        mut each: impl FnMut(LoggedMessage<'_>) -> Result<()>,
    ) -> Result<()> {
        let mut open: Option<(usize, File)> = None;
        for index in chunks {
            let Some(chunk) = self.chunks.get(*index) else {
                continue;
            };
            let part = &self.parts[chunk.part];
            let at = |e: Error| e.at(part.path.display());
            let file = match &mut open {
                Some((of, file)) if *of == chunk.part => file,
                _ => &mut open.insert((chunk.part, open_part(&part.path)?)).1,
            };
            let body = read_chunk(file, chunk.place)
                .map_err(|e| at(Error::io("cannot read the black box", e)))?;
            let result: Result<(), Failure> = unpack(&body, |record| {
                if let Record::Message { header, data } = record
                    && let Some(kind) = part.channels.get(&header.channel_id)
                    && let Some(message) = message(*kind, &header, &data, chunk.clock_offset_ns)
                {
                    each(message).map_err(Failure::Other)?;
                }
                Ok(())
            });
            result.map_err(|failure| match failure {
                Failure::Other(error) => error,
                Failure::Mcap(error) => {
                    at(Error::input("the black box was changed").because(error))
                }
            })?;
        }
        Ok(())
    }

    fn add(&mut self, path: BeneathPath) -> Result<()> {
        let mut file = open_part(&path)?;
        let mut found = Scan::default();
        let result = scan(&mut file, |opcode, body, place| {
            found.add(opcode, body, place)
        });
        let name = path.name();
        let is_cut = !matches!(result, Ok(true));
        let frames = found.frames.len();
        match result {
            Ok(true) => {}
            Ok(false) => self
                .notes
                .push(format!("{name} was not closed, it has {frames} frames")),
            Err(McapError::BadMagic) => {
                let what = "expected an MCAP file, found another type of file";
                return Err(Error::input(what).remedy("move it out of the directory"));
            }
            Err(McapError::Io(error)) => return Err(Error::io("cannot read the black box", error)),
            Err(McapError::UnsupportedCompression(compression)) => {
                let what = format!("the chunks are compressed with {compression}");
                return Err(Error::input(what).remedy("decompress it: `mcap decompress IN -o OUT`"));
            }
            Err(error) => self
                .notes
                .push(format!("{name} is damaged after {frames} frames: {error}")),
        }
        if found.foreign_shear > 0 {
            self.notes.push(format!(
                "{name}: {} messages on {SHEAR_TOPIC} are not as gripcast writes them",
                found.foreign_shear
            ));
        }
        let Some(clock_offset_ns) = found.clock_offset_ns else {
            // A program that was killed at once leaves a file without metadata.
            if is_cut && frames == 0 {
                return Ok(());
            }
            let what = format!("not a black box of gripcast: no metadata `{METADATA_RECORD}`");
            return Err(Error::input(what).remedy("move the file out of the directory"));
        };
        self.insert(path, clock_offset_ns, found);
        Ok(())
    }

    fn insert(&mut self, path: BeneathPath, clock_offset_ns: i128, found: Scan) {
        let known = |c: &Collection| c.clock_offset_ns == clock_offset_ns;
        let index = self.collections.iter().position(known).unwrap_or_else(|| {
            self.collections.push(Collection {
                clock_offset_ns,
                ..Collection::default()
            });
            self.collections.len() - 1
        });
        let collection = &mut self.collections[index];
        let (part, first) = (self.parts.len(), self.chunks.len());
        for (role, publish_ns, chunk) in found.frames {
            if let Some(driver_time_ns) = driver_time_ns(publish_ns, clock_offset_ns) {
                let chunk = first + chunk;
                let frames = collection.frames.entry(role).or_default();
                // A copy of a file has the same frames.
                frames.entry(driver_time_ns).or_insert(chunk);
            }
        }
        for (role, frame_time_ns, chunk) in found.shear {
            let chunk = first + chunk;
            collection
                .shear
                .entry((role, frame_time_ns))
                .or_insert(chunk);
        }
        self.chunks
            .extend(found.chunks.into_iter().map(|place| Chunk {
                part,
                place,
                clock_offset_ns,
            }));
        self.parts.push(Part {
            path,
            channels: found.channels,
        });
    }
}

impl Scan {
    fn add(&mut self, opcode: u8, body: &[u8], place: ChunkPlace) -> Result<(), McapError> {
        match opcode {
            op::METADATA => {
                if let Record::Metadata(Metadata { name, metadata }) =
                    mcap::parse_record(opcode, body)?
                    && name == METADATA_RECORD
                {
                    let offset = metadata.get(CLOCK_OFFSET);
                    // Nanoseconds since 1970 fit; a damaged number must not overflow.
                    let offset = offset.and_then(|offset| offset.parse::<i64>().ok());
                    self.clock_offset_ns = offset.map(i128::from);
                }
                Ok(())
            }
            op::CHUNK => {
                let (index, frames, shear) =
                    (self.chunks.len(), self.frames.len(), self.shear.len());
                self.chunks.push(place);
                let result = unpack(body, |record| self.add_record(record, index));
                if result.is_err() {
                    self.chunks.truncate(index);
                    self.frames.truncate(frames);
                    self.shear.truncate(shear);
                }
                result
            }
            _ => Ok(()),
        }
    }

    fn add_record(&mut self, record: Record<'_>, chunk: usize) -> Result<(), McapError> {
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                if let Some(kind) = self.kind(&channel) {
                    let before = self.channels.insert(channel.id, kind);
                    if before.is_some_and(|before| before != kind) {
                        return Err(McapError::ConflictingChannels(channel.topic));
                    }
                }
            }
            Record::Message { header, data } => match self.channels.get(&header.channel_id) {
                Some(Kind::Camera(role, _)) => {
                    self.frames.push((*role, header.publish_time, chunk));
                }
                Some(Kind::Shear) => match serde_json::from_slice::<ShearMessage>(&data) {
                    Ok(shear) => self.shear.push((shear.role, shear.frame_time_ns, chunk)),
                    Err(_) => self.foreign_shear += 1,
                },
                None => {}
            },
            _ => {}
        }
        Ok(())
    }

    fn kind(&self, channel: &Channel) -> Option<Kind> {
        if channel.topic == SHEAR_TOPIC {
            return Some(Kind::Shear);
        }
        let role = channel.topic.strip_prefix(CAMERA_TOPIC)?.parse().ok()?;
        let schema = ImageSchema::by_name(self.schemas.get(&channel.schema_id)?)?;
        Some(Kind::Camera(role, schema))
    }
}

/// Why reading has ended.
enum Failure {
    Mcap(McapError),
    Other(Error),
}

impl From<McapError> for Failure {
    fn from(error: McapError) -> Self {
        Self::Mcap(error)
    }
}

fn open_part(path: &BeneathPath) -> Result<File> {
    let opened = path.open_file(FileKind::Bulk);
    opened.map_err(|e| Error::io("cannot open the black box", e).at(path.display()))
}

fn driver_time_ns(publish_ns: u64, clock_offset_ns: i128) -> Option<u64> {
    u64::try_from(i128::from(publish_ns) - clock_offset_ns).ok()
}

/// `None`: a message that the scan has not counted either.
fn message<'a>(
    kind: Kind,
    header: &MessageHeader,
    data: &'a [u8],
    clock_offset_ns: i128,
) -> Option<LoggedMessage<'a>> {
    match kind {
        Kind::Camera(role, schema) => Some(LoggedMessage::Frame(FrameMessage {
            role,
            driver_time_ns: driver_time_ns(header.publish_time, clock_offset_ns)?,
            sequence: header.sequence,
            schema,
            data,
        })),
        Kind::Shear => serde_json::from_slice(data).ok().map(LoggedMessage::Shear),
    }
}
