//! Reads shards, ours and those that others wrote with the same columns.

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
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, open_regular};
use gripcast_base::quiet_panic;

/// Rows that are read together; of other writers' files, also those that are in memory.
const BATCH: usize = 32;
/// Largest metadata of a file, bytes: some hundred thousand row groups.
const MAX_FOOTER: u64 = 256 << 20;

/// An open shard. Clones read the same file; any number of threads may.
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
    /// Whether the hashes are those of this file.
    hashed: bool,
}

impl ShardReader {
    /// Opens a shard and checks its kind, its columns and its counts; the rows are not read.
    ///
    /// Files of other writers (pandas, `datasets`) need the same columns; further ones are
    /// ignored, those that may be null may be missing. Pages may be compressed with Snappy, gzip
    /// or Zstandard.
    ///
    /// # Errors
    /// `Input`: no Parquet file, damaged, another version, a column is missing or of another
    /// kind; no regular file. `NotFound`, `Permission`, `Io`: the file.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::of_file(open_regular(path, FileKind::Bulk), path.display())
    }

    /// The same of a file of a dataset.
    ///
    /// # Errors
    /// As [`open`](Self::open); `Input` for a link that leads out of the dataset.
    pub fn open_beneath(place: &BeneathPath) -> Result<Self> {
        Self::of_file(place.open_file(FileKind::Bulk), place.display())
    }

    fn of_file(file: io::Result<File>, name: impl fmt::Display) -> Result<Self> {
        let name = name.to_string();
        let source = file.and_then(Source::file);
        let source = source.map_err(|e| Error::io("cannot read the shard", e).at(&name))?;
        Self::of(name, source)
    }

    /// A shard in memory; `name` is for errors.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_bytes(name: impl Into<String>, bytes: Vec<u8>) -> Result<Self> {
        Self::of(name.into(), Source::Memory(Bytes::from(bytes)))
    }

    fn of(name: String, source: Source) -> Result<Self> {
        let source = Arc::new(source);
        let opened = guarded(|| Inner::open(&name, &source));
        let inner = opened.map_err(|e| e.at(&name))?;
        Ok(Self(Arc::new(inner)))
    }

    /// Rows of the file.
    #[must_use]
    pub fn num_rows(&self) -> usize {
        self.0.rows
    }

    /// Row groups of the file.
    #[must_use]
    pub fn num_row_groups(&self) -> usize {
        self.0.metadata.num_row_groups()
    }

    /// Rows of a row group; 0 where there is no such group.
    #[must_use]
    pub fn group_rows(&self, group: usize) -> usize {
        let groups = self.0.metadata.row_groups();
        let rows = groups.get(group).map(|group| group.num_rows());
        rows.and_then(|rows| usize::try_from(rows).ok())
            .unwrap_or(0)
    }

    /// The JSON that the writer's caller gave; none where another writer did not keep it.
    #[must_use]
    pub fn info(&self) -> Option<&str> {
        self.0.own.as_ref().map(|own| &*own.info)
    }

    /// All rows of a row group. What our writer made has a hash that is checked.
    ///
    /// # Errors
    /// `Usage`: there is no such row group. `Input`: it is damaged, or a value is one that no
    /// sample has. `Io`: the file.
    pub fn row_group(&self, group: usize) -> Result<Vec<ShardRow>> {
        let groups = self.num_row_groups();
        if group >= groups {
            let what = format!("there is no row group {group}; the shard has {groups}");
            return Err(Error::usage(what).at(&self.0.name));
        }
        let mut walk = Walk::new(Arc::clone(&self.0), group..group + 1);
        let mut rows = Vec::new();
        while let Some(batch) = walk.next_batch(true)? {
            rows.extend(batch);
        }
        Ok(rows)
    }

    /// All rows in their order. At most one row group is in memory, of files of other writers at
    /// most 32 rows; nothing follows an error.
    ///
    /// # Errors
    /// As [`row_group`](Self::row_group).
    pub fn rows(&self) -> impl Iterator<Item = Result<ShardRow>> + Send + use<> {
        Walk::new(Arc::clone(&self.0), 0..self.num_row_groups()).samples()
    }

    /// All rows without their images, of which no byte is read.
    ///
    /// # Errors
    /// As [`row_group`](Self::row_group).
    pub fn facts(&self) -> impl Iterator<Item = Result<ShardFacts>> + Send + use<> {
        Walk::new(Arc::clone(&self.0), 0..self.num_row_groups()).samples()
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

    /// Our own file has a hash for each row group.
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
            "the metadata of the row groups is missing or contradicts them",
        ))
    }

    fn hash(&self, group: usize) -> Option<&GroupHash> {
        let own = self.own.as_ref().filter(|_| self.hashed)?;
        own.row_groups.get(group)
    }
}

fn read_footer(source: &Source) -> Result<ParquetMetaData> {
    let size = source.size();
    let no_parquet = || {
        let what = format!("this is no Parquet file, or it was cut ({size} bytes)");
        Error::input(what).remedy("make or fetch the file again")
    };
    let read = |offset, length| {
        let bytes = source.read(offset, length);
        bytes.map_err(|e| Error::io("cannot read the shard", e))
    };
    let tail_size = FOOTER_SIZE as u64;
    let tail_at = size.checked_sub(tail_size).ok_or_else(no_parquet)?;
    if &*read(0, 4)? != b"PAR1" {
        return Err(no_parquet());
    }
    let tail = read(tail_at, tail_size)?;
    let tail = <&[u8; FOOTER_SIZE]>::try_from(&*tail).map_err(|_| no_parquet())?;
    let tail = FooterTail::try_new(tail).map_err(|_| no_parquet())?;
    if tail.is_encrypted_footer() {
        return Err(damaged("the file is encrypted"));
    }
    let length = tail.metadata_length() as u64;
    let start = tail_at.checked_sub(length).filter(|_| length <= MAX_FOOTER);
    let start = start.ok_or_else(|| damaged("the metadata is longer than the file"))?;
    ParquetMetaDataReader::decode_metadata(&read(start, length)?)
        .map_err(|e| damaged("the metadata cannot be read").because(e))
}

fn own_metadata(metadata: &ParquetMetaData) -> Result<Option<ShardMetadata>> {
    let pairs = metadata.file_metadata().key_value_metadata();
    let pair = pairs.and_then(|pairs| pairs.iter().find(|pair| pair.key == KEY));
    let value = pair.and_then(|pair| pair.value.as_deref());
    value.map(ShardMetadata::parse).transpose()
}

/// What is made of the first columns of a row.
trait Sample: Sized + Send {
    /// How many columns.
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

/// Goes through row groups.
struct Walk {
    shard: Arc<Inner>,
    groups: std::ops::Range<usize>,
    open: Option<OpenGroup>,
}

struct OpenGroup {
    number: usize,
    cursor: GroupCursor,
    /// Rows that were read, and all.
    read: usize,
    rows: usize,
    /// Bytes of the rows in memory.
    bytes: usize,
}

impl Walk {
    fn new(shard: Arc<Inner>, groups: std::ops::Range<usize>) -> Self {
        Self {
            shard,
            groups,
            open: None,
        }
    }

    fn samples<T: Sample>(mut self) -> impl Iterator<Item = Result<T>> + Send {
        let mut waiting = Vec::new().into_iter();
        let mut failed = false;
        std::iter::from_fn(move || {
            loop {
                if let Some(sample) = waiting.next() {
                    return Some(Ok(sample));
                }
                if failed {
                    return None;
                }
                match self.next_batch(false) {
                    Ok(batch) => waiting = batch?.into_iter(),
                    Err(error) => {
                        failed = true;
                        return Some(Err(error));
                    }
                }
            }
        })
    }

    /// Some rows that are sound as far as can be known; none after the last. `kept`: the caller
    /// keeps those of before in memory.
    fn next_batch<T: Sample>(&mut self, kept: bool) -> Result<Option<Vec<T>>> {
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
            // With a hash all rows of the group are held back until it is checked.
            let hash = self.shard.hash(group.number);
            let rows = if hash.is_some() { group.rows } else { BATCH };
            if !kept {
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

    /// The next rows, up to `most`; with a hash they must be all of the group.
    fn read<T: Sample>(&mut self, most: usize, hash: Option<&GroupHash>) -> Result<Vec<T>> {
        let end = self.rows.min(self.read.saturating_add(most));
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

/// Whether the samples of a whole row group say what was written.
fn check_hash<T: Sample>(samples: &[T], expected: &GroupHash) -> Result<()> {
    let (mut facts, mut images) = (ContentHash::default(), ContentHash::default());
    let mut imaged = true;
    for sample in samples {
        sample.facts().cells().iter().for_each(|c| facts.add(c));
        match sample.images() {
            Some(found) => found.cells().iter().for_each(|c| images.add(c)),
            None => imaged = false,
        }
    }
    if facts.finish() != expected.facts_sha256 {
        return Err(altered("the columns besides the images"));
    }
    if imaged && images.finish() != expected.images_sha256 {
        return Err(altered("the images"));
    }
    Ok(())
}

/// Runs what calls the Parquet crate; nothing of it is used again after a panic.
fn guarded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    quiet_panic::catch(AssertUnwindSafe(work))
        .unwrap_or_else(|panic| Err(damaged(format!("the contents cannot be decoded ({panic})"))))
}

fn altered(what: &str) -> Error {
    damaged(format!(
        "{what} are not those that were written: the hash differs"
    ))
}

fn damaged(what: impl Into<String>) -> Error {
    Error::input(what).remedy("make or fetch the file again")
}
