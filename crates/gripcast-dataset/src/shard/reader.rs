//! Reads shards written by gripcast or by other writers with the same columns.

use std::fmt;
use std::fs::File;
use std::io;
use std::panic::AssertUnwindSafe;
use std::path::Path;
use std::sync::Arc;

use bytes::Bytes;
use parquet::file::FOOTER_SIZE;
use parquet::file::metadata::{FooterTail, ParquetMetaData, ParquetMetaDataReader};

use super::cell::Cells;
use super::columns::{FACTS, columns};
use super::cursor::GroupCursor;
use super::digest::ContentHash;
use super::layout::Layout;
use super::metadata::{CREATED_BY, GroupHash, KEY, ShardMetadata};
use super::row::{ShardFacts, ShardImages, ShardRow};
use super::source::Source;
use gripcast_base::catch_panic::catch_panic;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, file_type, open_regular};

/// Rows per read; for files of other writers also the rows in memory.
const BATCH: usize = 32;
/// Maximum size of a file's metadata, bytes: some hundred thousand row groups.
const MAX_FOOTER: u64 = 256 << 20;
/// Bytes that tell another type of file.
const START: u64 = 4096;

/// An open shard. Clones share the file and may be used from any thread.
#[derive(Clone, Debug)]
pub struct ShardReader(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    name: String,
    source: Arc<Source>,
    metadata: ParquetMetaData,
    layout: Layout,
    rows: usize,
    own: Option<ShardMetadata>,
    /// Whether the hashes apply to this file.
    hashed: bool,
}

impl ShardReader {
    /// Opens a shard and checks format, columns and counts without reading rows.
    ///
    /// Files of other writers (pandas, `datasets`) need the same columns; nullable ones may be
    /// missing, others are ignored. Numbers may have single precision, labels may be bool, images
    /// lists of uint8. Pages may be compressed with Snappy, gzip, Zstandard, Brotli or LZ4.
    ///
    /// # Errors
    /// `Input`: not a regular Parquet file, damaged, unsupported version, a column is missing or
    /// of another type. `NotFound`, `Permission`, `Io`: the file.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::from_file(open_regular(path, FileKind::Bulk), path.display())
    }

    /// Opens a shard inside a dataset.
    ///
    /// # Errors
    /// As [`open`](Self::open); `Input` for a link that leads out of the dataset.
    pub fn open_beneath(path: &BeneathPath) -> Result<Self> {
        Self::from_file(path.open_file(FileKind::Bulk), path.display())
    }

    fn from_file(file: io::Result<File>, name: impl fmt::Display) -> Result<Self> {
        let name = name.to_string();
        let source = file.and_then(Source::file);
        let source = source.map_err(|e| Error::io("cannot read the shard", e).at(&name))?;
        Self::new(name, source)
    }

    /// Opens a shard in memory; `name` is used in errors.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_bytes(name: impl Into<String>, bytes: Vec<u8>) -> Result<Self> {
        Self::new(name.into(), Source::Memory(Bytes::from(bytes)))
    }

    fn new(name: String, source: Source) -> Result<Self> {
        let source = Arc::new(source);
        let opened = guarded(|| Inner::open(&name, &source));
        let inner = opened.map_err(|e| e.at(&name))?;
        Ok(Self(Arc::new(inner)))
    }

    /// Number of rows of the file.
    #[must_use]
    pub fn num_rows(&self) -> usize {
        self.0.rows
    }

    /// Number of row groups of the file.
    #[must_use]
    pub fn num_row_groups(&self) -> usize {
        self.0.metadata.num_row_groups()
    }

    /// Number of rows of a row group; 0 if it does not exist.
    #[must_use]
    pub fn group_rows(&self, group: usize) -> usize {
        let groups = self.0.metadata.row_groups();
        let rows = groups.get(group).map(|group| group.num_rows());
        rows.and_then(|rows| usize::try_from(rows).ok())
            .unwrap_or(0)
    }

    /// JSON given to the writer; none in files of writers that dropped it.
    #[must_use]
    pub fn info(&self) -> Option<&str> {
        self.0.own.as_ref().map(|own| &*own.info)
    }

    /// Reads all rows of a row group and checks its hash, if any.
    ///
    /// # Errors
    /// `Usage`: no such row group. `Input`: damaged, or an invalid value. `Io`: the file.
    pub fn row_group(&self, group: usize) -> Result<Vec<ShardRow>> {
        let groups = self.num_row_groups();
        if group >= groups {
            let what = format!("no row group {group}: the shard has {groups}");
            return Err(Error::usage(what).at(&self.0.name));
        }
        let mut groups = GroupsReader::new(Arc::clone(&self.0), group..group + 1);
        let mut rows = Vec::new();
        while let Some(batch) = groups.next_batch(true)? {
            rows.extend(batch);
        }
        Ok(rows)
    }

    /// Reads all rows in order; ends at the first error. At most one row group is in memory, for
    /// files of other writers at most 32 rows.
    ///
    /// # Errors
    /// As [`row_group`](Self::row_group).
    pub fn rows(&self) -> impl Iterator<Item = Result<ShardRow>> + Send + use<> {
        GroupsReader::new(Arc::clone(&self.0), 0..self.num_row_groups()).samples()
    }

    /// Reads all rows without their images.
    ///
    /// # Errors
    /// As [`row_group`](Self::row_group).
    pub fn facts(&self) -> impl Iterator<Item = Result<ShardFacts>> + Send + use<> {
        GroupsReader::new(Arc::clone(&self.0), 0..self.num_row_groups()).samples()
    }
}

impl Inner {
    fn open(name: &str, source: &Arc<Source>) -> Result<Self> {
        let metadata = read_footer(source)?;
        let own = own_metadata(&metadata)?;
        let schema = metadata.file_metadata().schema_descr();
        let layout = Layout::find(schema)?;
        let rows = layout.count_rows(&metadata)?;
        let hashed = metadata.file_metadata().created_by() == Some(CREATED_BY);
        let inner = Self {
            name: name.to_owned(),
            source: Arc::clone(source),
            metadata,
            layout,
            rows,
            own,
            hashed,
        };
        inner.check_hashes()?;
        Ok(inner)
    }

    /// A file of our writer must have a hash for each row group.
    fn check_hashes(&self) -> Result<()> {
        if !self.hashed {
            return Ok(());
        }
        let hashes = self.own.as_ref().map(|own| &*own.row_groups);
        let groups = self.metadata.row_groups();
        let counts = groups
            .iter()
            .map(|group| usize::try_from(group.num_rows()).ok());
        let agrees =
            |hashes: &[GroupHash]| hashes.iter().map(|hash| Some(hash.rows)).eq(counts.clone());
        if hashes.is_some_and(agrees) {
            return Ok(());
        }
        Err(damaged(
            "the hashes of the row groups are missing or do not match them",
        ))
    }

    fn hash(&self, group: usize) -> Option<&GroupHash> {
        let own = self.own.as_ref().filter(|_| self.hashed)?;
        own.row_groups.get(group)
    }
}

fn read_footer(source: &Source) -> Result<ParquetMetaData> {
    let size = source.size();
    let read = |offset, length| {
        let bytes = source.read(offset, length);
        bytes.map_err(|e| Error::io("cannot read the shard", e))
    };
    let start = read(0, size.min(START))?;
    if !start.starts_with(b"PAR1") {
        let found = file_type(&start).unwrap_or("a file of another type");
        let what = format!("expected a Parquet file, found {found} ({size} bytes)");
        return Err(Error::input(what).remedy("create or download the file again"));
    }
    let truncated = || damaged(format!("the Parquet file is truncated ({size} bytes)"));
    let tail_size = FOOTER_SIZE as u64;
    let tail_at = size.checked_sub(tail_size).ok_or_else(truncated)?;
    let tail = read(tail_at, tail_size)?;
    let tail = <&[u8; FOOTER_SIZE]>::try_from(&*tail).map_err(|_| truncated())?;
    let tail = FooterTail::try_new(tail).map_err(|_| truncated())?;
    if tail.is_encrypted_footer() {
        return Err(damaged("the file is encrypted"));
    }
    let length = tail.metadata_length() as u64;
    let start = tail_at.checked_sub(length).filter(|_| length <= MAX_FOOTER);
    let start = start.ok_or_else(|| damaged("the metadata is longer than the file"))?;
    ParquetMetaDataReader::decode_metadata(&read(start, length)?)
        .map_err(|e| damaged("cannot read the metadata").because(e))
}

fn own_metadata(metadata: &ParquetMetaData) -> Result<Option<ShardMetadata>> {
    let pairs = metadata.file_metadata().key_value_metadata();
    let pair = pairs.and_then(|pairs| pairs.iter().find(|pair| pair.key == KEY));
    let value = pair.and_then(|pair| pair.value.as_deref());
    value.map(ShardMetadata::parse).transpose()
}

/// A type that is read from the first columns of a row.
trait Sample: Sized + Send {
    /// Number of columns.
    const COLUMNS: usize;
    fn from_cells(cells: &mut Cells<'_>) -> Result<Self>;
    fn facts(&self) -> &ShardFacts;
    fn images(&self) -> Option<&ShardImages>;
}

impl Sample for ShardFacts {
    const COLUMNS: usize = FACTS.len();

    fn from_cells(cells: &mut Cells<'_>) -> Result<Self> {
        let facts = Self::from_cells(cells)?;
        facts.check()?;
        Ok(facts)
    }

    fn facts(&self) -> &ShardFacts {
        self
    }

    fn images(&self) -> Option<&ShardImages> {
        None
    }
}

impl Sample for ShardRow {
    const COLUMNS: usize = usize::MAX;

    fn from_cells(cells: &mut Cells<'_>) -> Result<Self> {
        let facts = <ShardFacts as Sample>::from_cells(cells)?;
        let images = ShardImages::from_cells(cells)?;
        Ok(Self { facts, images })
    }

    fn facts(&self) -> &ShardFacts {
        &self.facts
    }

    fn images(&self) -> Option<&ShardImages> {
        Some(&self.images)
    }
}

/// Reads a range of row groups.
struct GroupsReader {
    shard: Arc<Inner>,
    groups: std::ops::Range<usize>,
    open: Option<OpenGroup>,
}

struct OpenGroup {
    number: usize,
    cursor: GroupCursor,
    /// Number of rows read, and of all rows.
    read: usize,
    rows: usize,
    /// Size of the rows in memory, bytes.
    bytes: usize,
}

impl GroupsReader {
    fn new(shard: Arc<Inner>, groups: std::ops::Range<usize>) -> Self {
        Self {
            shard,
            groups,
            open: None,
        }
    }

    fn samples<T: Sample>(mut self) -> impl Iterator<Item = Result<T>> + Send {
        let mut pending = Vec::new().into_iter();
        let mut failed = false;
        std::iter::from_fn(move || {
            loop {
                if let Some(sample) = pending.next() {
                    return Some(Ok(sample));
                }
                if failed {
                    return None;
                }
                match self.next_batch(false) {
                    Ok(batch) => pending = batch?.into_iter(),
                    Err(error) => {
                        failed = true;
                        return Some(Err(error));
                    }
                }
            }
        })
    }

    /// Reads the next rows, checked; none after the last. `accumulates`: whether the caller keeps
    /// earlier rows in memory.
    fn next_batch<T: Sample>(&mut self, accumulates: bool) -> Result<Option<Vec<T>>> {
        loop {
            let Some(mut group) = self.open.take() else {
                let Some(number) = self.groups.next() else {
                    return Ok(None);
                };
                let opened = guarded(|| OpenGroup::open::<T>(&self.shard, number));
                self.open = Some(self.in_group(number, opened)?);
                continue;
            };
            if group.read == group.rows {
                continue;
            }
            // With a hash, all rows of the group are read before it is checked.
            let hash = self.shard.hash(group.number);
            let rows = if hash.is_some() { group.rows } else { BATCH };
            if !accumulates {
                group.bytes = 0;
            }
            let read = guarded(|| group.read::<T>(rows, hash));
            let samples = self.in_group(group.number, read)?;
            self.open = Some(group);
            return Ok(Some(samples));
        }
    }

    fn in_group<T>(&self, number: usize, result: Result<T>) -> Result<T> {
        result.map_err(|e| e.at(format!("row group {number}")).at(&self.shard.name))
    }
}

impl OpenGroup {
    fn open<T: Sample>(shard: &Inner, number: usize) -> Result<Self> {
        let group = shard.metadata.row_group(number);
        let count = T::COLUMNS.min(columns().count());
        Ok(Self {
            number,
            cursor: GroupCursor::open(&shard.source, group, &shard.layout, count)?,
            read: 0,
            rows: usize::try_from(group.num_rows()).unwrap_or(0),
            bytes: 0,
        })
    }

    /// Reads up to `max_rows` rows; with a hash they must be all rows of the group.
    fn read<T: Sample>(&mut self, max_rows: usize, hash: Option<&GroupHash>) -> Result<Vec<T>> {
        let end = self.rows.min(self.read.saturating_add(max_rows));
        let mut samples = Vec::new();
        while self.read < end {
            let rows = BATCH.min(end - self.read);
            let mut batch = self.cursor.read(rows, self.bytes)?;
            self.bytes += batch.size;
            for row in self.read..self.read + rows {
                let mut cells = batch.columns.iter_mut().filter_map(|(name, cells)| {
                    let cell = cells.next()?;
                    Some((*name, cell))
                });
                let sample = T::from_cells(&mut Cells::new(&mut cells));
                samples.push(sample.map_err(|e| e.at(format!("row {row}")))?);
            }
            self.read += rows;
        }
        if let Some(hash) = hash {
            check_hash(&samples, hash)?;
        }
        Ok(samples)
    }
}

/// Checks the samples of a complete row group against its hash.
fn check_hash<T: Sample>(samples: &[T], expected: &GroupHash) -> Result<()> {
    let (mut facts, mut images) = (ContentHash::default(), ContentHash::default());
    let mut has_images = true;
    for sample in samples {
        facts.add_facts(&sample.facts().cells());
        match sample.images() {
            Some(found) => found.cells().iter().for_each(|c| images.add(c)),
            None => has_images = false,
        }
    }
    if facts.finish() != expected.facts_sha256 {
        return Err(altered("the columns other than the images"));
    }
    if has_images && images.finish() != expected.images_sha256 {
        return Err(altered("the images"));
    }
    Ok(())
}

/// Runs code of the Parquet crate; a panic becomes an error.
fn guarded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_panic(AssertUnwindSafe(work))
        .unwrap_or_else(|panic| Err(damaged(format!("cannot decode the contents ({panic})"))))
}

fn altered(what: &str) -> Error {
    damaged(format!("the hash of {what} does not match"))
}

fn damaged(what: impl Into<String>) -> Error {
    Error::input(what).remedy("create or download the file again")
}
