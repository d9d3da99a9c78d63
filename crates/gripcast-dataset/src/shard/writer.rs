//! Writes shards.

use std::collections::HashSet;
use std::io::{self, Write};
use std::sync::Arc;

use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::ColumnPath;

use super::cell::{Cell, column_error};
use super::columns::{columns, features, schema, table_columns};
use super::group::write_group;
use super::metadata::{CREATED_BY, GroupHash, HUGGINGFACE_KEY, KEY, ShardMetadata};
use super::row::{ShardRow, image_extension};
use super::staged::StagedShard;
use super::table_column::ColumnType;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::BeneathPath;

/// Maximum size of a row group, bytes; only a single row may be larger.
pub(super) const GROUP_BYTES: usize = 12 << 20;
/// Maximum size of a row, bytes, below the limit of Parquet's page size.
pub(super) const MAX_ROW_BYTES: usize = 256 << 20;
/// Values written between checks of the page size, so that pages of images stay small.
const BATCH: usize = 16;

/// Writes one shard, row by row, in bounded memory.
///
/// The file has a hidden temporary name until [`finish`](Self::finish); a writer that is dropped
/// before leaves an existing file unchanged. Equal rows give equal bytes.
#[derive(Debug)]
pub struct ShardWriter {
    path: BeneathPath,
    groups: Groups<StagedShard>,
}

impl ShardWriter {
    /// Creates a shard; `info` is JSON of the caller, stored unchanged in the metadata.
    ///
    /// # Errors
    /// `Input`: `info` is not valid JSON. `NotFound`, `Permission`, `DiskFull`, `Io`: the
    /// directory.
    pub fn create(path: &BeneathPath, info: &str) -> Result<Self> {
        let begin = || {
            let staged =
                StagedShard::create(path).map_err(|e| Error::io("cannot write the shard", e))?;
            Groups::new(staged, info)
        };
        let groups = begin().map_err(|e| e.at(path.display()))?;
        Ok(Self {
            path: path.clone(),
            groups,
        })
    }

    /// Appends a row.
    ///
    /// # Errors
    /// `Input`: an invalid value, an image that is neither PNG nor JPEG, a duplicate id; the row
    /// is then skipped. `DiskFull`, `Io`, …: the file; nothing more can be written.
    pub fn push(&mut self, row: ShardRow) -> Result<()> {
        let pushed = self.groups.push(row);
        pushed.map_err(|e| e.at(self.path.display()))
    }

    /// Number of rows so far.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.groups.ids.len()
    }

    /// Writes the remaining rows, flushes the file and renames it to its final name.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, …; an existing file is then unchanged.
    pub fn finish(self) -> Result<()> {
        let Self { path, groups } = self;
        let finish = || {
            let staged = groups.finish()?;
            staged
                .commit()
                .map_err(|e| Error::io("cannot write the shard", e))
        };
        finish().map_err(|e| e.at(path.display()))
    }
}

/// Encodes a small shard in memory.
///
/// # Errors
/// `Input`: as [`ShardWriter::create`] and [`ShardWriter::push`].
pub fn to_bytes(rows: impl IntoIterator<Item = ShardRow>, info: &str) -> Result<Vec<u8>> {
    let mut groups = Groups::new(Vec::new(), info)?;
    for row in rows {
        groups.push(row)?;
    }
    groups.finish()
}

/// Collects rows into row groups.
#[derive(Debug)]
struct Groups<W: Write + Send> {
    writer: SerializedFileWriter<W>,
    info: String,
    ids: HashSet<String>,
    pending: Vec<ShardRow>,
    pending_bytes: usize,
    hashes: Vec<GroupHash>,
    /// Whether a group was written incompletely.
    failed: bool,
}

impl<W: Write + Send> Groups<W> {
    fn new(sink: W, info: &str) -> Result<Self> {
        serde_json::from_str::<serde::de::IgnoredAny>(info)
            .map_err(|e| Error::input("the metadata is not valid JSON").because(e))?;
        let schema = schema().map_err(write_error)?;
        let writer = SerializedFileWriter::new(sink, schema, Arc::new(properties(CREATED_BY)))
            .map_err(write_error)?;
        Ok(Self {
            writer,
            info: info.to_owned(),
            ids: HashSet::new(),
            pending: Vec::new(),
            pending_bytes: 0,
            hashes: Vec::new(),
            failed: false,
        })
    }

    fn push(&mut self, row: ShardRow) -> Result<()> {
        let size = check(&row).map_err(|e| e.at(format!("sample {:?}", row.facts.id)))?;
        if self.ids.contains(&row.facts.id) {
            let what = format!("duplicate sample id {:?}", row.facts.id);
            return Err(Error::input(what));
        }
        if self.pending_bytes + size > GROUP_BYTES {
            self.close_group()?;
        }
        self.ids.insert(row.facts.id.clone());
        self.pending.push(row);
        self.pending_bytes += size;
        Ok(())
    }

    fn close_group(&mut self) -> Result<()> {
        if self.failed {
            let what = "cannot continue the shard: an earlier row group was not written";
            return Err(Error::new(ErrorKind::Io, what));
        }
        if self.pending.is_empty() {
            return Ok(());
        }
        let rows = std::mem::take(&mut self.pending);
        self.pending_bytes = 0;
        self.failed = true;
        let cells: Vec<Vec<Cell<'_>>> = rows.iter().map(ShardRow::cells).collect();
        let hash = write_group(&mut self.writer, &cells).map_err(write_error)?;
        self.failed = false;
        self.hashes.push(hash);
        Ok(())
    }

    fn finish(mut self) -> Result<W> {
        self.close_group()?;
        let metadata = ShardMetadata::new(self.info, self.hashes).to_json()?;
        self.writer
            .append_key_value_metadata(KeyValue::new(KEY.to_owned(), metadata));
        self.writer.into_inner().map_err(write_error)
    }
}

/// Checks a row; returns its size in bytes.
fn check(row: &ShardRow) -> Result<usize> {
    row.facts.check()?;
    let mut size = 0;
    for (column, cell) in columns().zip(row.cells()) {
        size += cell.size();
        if let Cell::Image(bytes) = &cell
            && image_extension(bytes).is_none()
        {
            let what = format!("is neither PNG nor JPEG ({} bytes)", bytes.len());
            return Err(column_error(column.name, what));
        }
    }
    if size > MAX_ROW_BYTES {
        let what = format!("a sample has {size} bytes, at most {MAX_ROW_BYTES} are supported");
        return Err(Error::input(what));
    }
    Ok(size)
}

pub(super) fn properties(created_by: &str) -> WriterProperties {
    table_properties(created_by, features(), table_columns())
}

/// Properties of any table. `images`: the columns with images.
pub(super) fn table_properties<'a>(
    created_by: &str,
    features: String,
    columns: impl Iterator<Item = (&'a str, ColumnType)>,
) -> WriterProperties {
    let features = KeyValue::new(HUGGINGFACE_KEY.to_owned(), features);
    let mut properties = WriterProperties::builder()
        .set_created_by(created_by.to_owned())
        .set_compression(Compression::UNCOMPRESSED)
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_offset_index_disabled(true)
        .set_write_batch_size(BATCH)
        .set_max_row_group_row_count(None)
        .set_key_value_metadata(Some(vec![features]));
    // Dictionaries and statistics of images would be as large as the images.
    let images = columns.filter_map(|(name, kind)| match kind {
        ColumnType::Image => Some(vec![name, "bytes"]),
        ColumnType::ImageList => Some(vec![name, "list", "element", "bytes"]),
        _ => None,
    });
    for path in images {
        let bytes = ColumnPath::new(path.into_iter().map(str::to_owned).collect());
        properties = properties
            .set_column_dictionary_enabled(bytes.clone(), false)
            .set_column_statistics_enabled(bytes, EnabledStatistics::None);
    }
    properties.build()
}

/// Converts an error; keeps that of the operating system, such as a full disk.
pub(super) fn write_error(error: ParquetError) -> Error {
    match error {
        ParquetError::External(cause) => match cause.downcast::<io::Error>() {
            Ok(cause) => Error::io("cannot write the shard", *cause),
            Err(cause) => Error::internal(format!("cannot write the shard: {cause}")),
        },
        other => Error::internal("cannot write the shard").because(other),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::super::reader::ShardReader;
    use super::super::row::{ShardEngine, ShardFacts};
    use super::super::sample_rows::{image, sample_row, sample_rows};
    use super::*;
    use gripcast_base::files::Root;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    fn read(bytes: Vec<u8>) -> Vec<ShardRow> {
        let shard = ShardReader::from_bytes("memory", bytes).unwrap();
        let rows: Vec<ShardRow> = shard.rows().map(Result::unwrap).collect();
        assert_eq!(shard.num_rows(), rows.len());
        let facts: Vec<ShardFacts> = shard.facts().map(Result::unwrap).collect();
        assert!(facts.iter().eq(rows.iter().map(|row| &row.facts)));
        let groups = 0..shard.num_row_groups();
        let grouped = groups.flat_map(|group| shard.row_group(group).unwrap());
        assert!(grouped.eq(rows.iter().cloned()));
        rows
    }

    #[test]
    fn rows_round_trip_bit_for_bit() {
        for count in [0, 1, 2, 61] {
            let rows = sample_rows(0, count);
            assert_eq!(read(to_bytes(rows.clone(), "{}").unwrap()), rows);
        }
    }

    #[test]
    fn real_grasp_round_trips_with_nulls() {
        let mut rows = sample_rows(0, 5);
        for index in [0, 2, 3] {
            let facts = &mut rows[index].facts;
            facts.engine = ShardEngine::Real;
            (facts.stop_force_n, facts.friction, facts.mass_kg) = (None, None, None);
            (facts.lifted_m, facts.opening_m) = (None, None);
            facts.t_object_gripper = None;
        }
        assert_eq!(read(to_bytes(rows.clone(), "{}").unwrap()), rows);
    }

    #[test]
    fn equal_rows_give_equal_bytes_on_any_machine() {
        use sha2::{Digest as _, Sha256};
        let bytes = to_bytes(sample_rows(0, 40), r#"{"plan":"ab12"}"#).unwrap();
        assert_eq!(
            bytes,
            to_bytes(sample_rows(0, 40), r#"{"plan":"ab12"}"#).unwrap()
        );
        let hash: String = Sha256::digest(&bytes)
            .iter()
            .map(|b| format!("{b:02x}"))
            .collect();
        // Changes with the format (then bump its version) or with the Parquet crate.
        assert_eq!(
            hash,
            "47bd1616a5a54da1a0292596b8ccb916f17be37c3a92f61e11668854ca79cf00"
        );
    }

    #[test]
    fn row_groups_are_bounded_and_keep_all_images() {
        let large = |number| {
            let mut row = sample_row(number);
            row.images.grasp_rgb = image(true, number, 3 << 20);
            row
        };
        let mut rows: Vec<ShardRow> = (0..9).map(large).collect();
        rows[4].images.grasp_left = image(false, 4, GROUP_BYTES + 1);
        let bytes = to_bytes(rows.clone(), "{}").unwrap();
        let shard = ShardReader::from_bytes("memory", bytes).unwrap();
        let sizes: Vec<usize> = (0..shard.num_row_groups())
            .map(|group| shard.row_group(group).unwrap().len())
            .collect();
        assert_eq!(sizes, [3, 1, 1, 3, 1]);
        assert!(shard.rows().map(Result::unwrap).eq(rows));
        let error = shard.row_group(5).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Usage);
    }

    #[test]
    fn file_gets_its_name_when_complete() {
        let folder = tempfile::tempdir().unwrap();
        let target = Root::new(folder.path())
            .top()
            .join("train-00000-of-00001.parquet");
        let path = target.shown();
        let mut writer = ShardWriter::create(&target, "{}").unwrap();
        for row in sample_rows(0, 3) {
            writer.push(row).unwrap();
        }
        assert_eq!(writer.rows(), 3);
        assert!(!path.exists());
        writer.finish().unwrap();
        assert_eq!(names(folder.path()), ["train-00000-of-00001.parquet"]);
        let bytes = fs::read(&path).unwrap();
        assert_eq!(bytes, to_bytes(sample_rows(0, 3), "{}").unwrap());
        let mut dropped = ShardWriter::create(&target, "[1]").unwrap();
        dropped.push(sample_row(9)).unwrap();
        assert_eq!(names(folder.path()).len(), 2);
        drop(dropped);
        assert_eq!(fs::read(&path).unwrap(), bytes);
        assert_eq!(names(folder.path()).len(), 1);
        let shard = ShardReader::open(&path).unwrap();
        assert_eq!(shard.info(), Some("{}"));
    }

    #[test]
    fn unwritable_paths_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let top = Root::new(folder.path()).top();
        let create = |path: &BeneathPath| ShardWriter::create(path, "{}").unwrap_err();
        let error = create(&top.join("no").join("such.parquet"));
        assert_eq!(error.kind(), ErrorKind::NotFound);
        assert!(error.to_string().contains("no/such.parquet"), "{error}");
        create(&top);
        let error = ShardWriter::create(&top.join("a.parquet"), "{plan").unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn invalid_rows_are_skipped() {
        let with = |change: fn(&mut ShardRow)| {
            let mut row = sample_row(7);
            change(&mut row);
            row
        };
        let invalid = [
            (with(|r| r.facts.id.clear()), "column id is empty"),
            (with(|r| r.facts.mass_kg = Some(0.0)), "column mass_kg is 0"),
            (
                with(|r| r.facts.friction = Some(f64::NAN)),
                "column friction is NaN",
            ),
            (
                with(|r| r.facts.force_left_n = Some(-1.0)),
                "column force_left_n is -1",
            ),
            (with(|r| r.facts.seed = u64::MAX), "below 2^63"),
            (
                with(|r| {
                    if let Some(pose) = &mut r.facts.t_object_gripper {
                        pose.rotation *= 2.0;
                    }
                }),
                "column pose_q_wxyz",
            ),
            (
                with(|r| r.images.grasp_rgb = b"GIF89a".to_vec()),
                "column grasp_rgb is neither PNG nor JPEG",
            ),
            (
                with(|r| r.facts.id = sample_row(1).facts.id),
                "duplicate sample id",
            ),
        ];
        let folder = tempfile::tempdir().unwrap();
        let target = Root::new(folder.path()).top().join("a.parquet");
        let mut writer = ShardWriter::create(&target, "{}").unwrap();
        writer.push(sample_row(1)).unwrap();
        for (row, expected) in invalid {
            let error = writer.push(row).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Input);
            assert!(error.to_string().contains(expected), "{error}");
        }
        writer.push(sample_row(2)).unwrap();
        writer.finish().unwrap();
        assert_eq!(read(fs::read(target.shown()).unwrap()), sample_rows(1, 2));
    }
}
