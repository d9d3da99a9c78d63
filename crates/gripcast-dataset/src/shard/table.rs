//! Writes tables with images whose columns are chosen at run time.

use std::sync::Arc;

use parquet::file::metadata::KeyValue;
use parquet::file::writer::SerializedFileWriter;

use super::cell::{Cell, column_error};
use super::group::write_columns;
use super::row::image_extension;
use super::staged::StagedShard;
use super::table_column::{ColumnType, features, schema};
use super::writer::{GROUP_BYTES, MAX_ROW_BYTES, table_properties, write_error};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::BeneathPath;

/// Writer of the file; shards have another one.
const CREATED_BY: &str = "gripcast-table version 1.0.0";
/// Beginning of a little-endian TIFF file.
const TIFF: &[u8] = b"II*\0";

/// Writes one Parquet file, row by row, in bounded memory; pages and row groups are like those of
/// shards.
///
/// The file has a hidden temporary name until [`finish`](Self::finish). Equal rows give equal
/// bytes.
pub struct TableWriter {
    path: BeneathPath,
    columns: Vec<(String, ColumnType)>,
    writer: SerializedFileWriter<StagedShard>,
    pending: Vec<Vec<Cell<'static>>>,
    pending_bytes: usize,
    closed_bytes: usize,
    rows: usize,
}

impl TableWriter {
    /// Creates a file; `metadata` goes into its footer beside the Hugging Face features.
    ///
    /// # Errors
    /// `NotFound`, `Permission`, `DiskFull`, `Io`: the directory.
    pub fn create(
        path: BeneathPath,
        columns: Vec<(String, ColumnType)>,
        metadata: &[(&str, String)],
    ) -> Result<Self> {
        let begin = || {
            let staged =
                StagedShard::create(&path).map_err(|e| Error::io("cannot write the table", e))?;
            let all = || columns.iter().map(|(name, kind)| (name.as_str(), *kind));
            let properties = table_properties(CREATED_BY, features(all()), all());
            let schema = schema(all()).map_err(write_error)?;
            let mut writer = SerializedFileWriter::new(staged, schema, Arc::new(properties))
                .map_err(write_error)?;
            for (key, value) in metadata {
                let pair = KeyValue::new((*key).to_owned(), value.clone());
                writer.append_key_value_metadata(pair);
            }
            Ok(writer)
        };
        let writer = begin().map_err(|e: Error| e.at(path.display()))?;
        Ok(Self {
            path,
            columns,
            writer,
            pending: Vec::new(),
            pending_bytes: 0,
            closed_bytes: 0,
            rows: 0,
        })
    }

    /// Adds a row: one cell per column, of the column's type or null.
    ///
    /// # Errors
    /// `Input`: an image that is neither PNG nor JPEG nor TIFF, a row that is too large. `Internal`: the
    /// number of cells differs from that of the columns. `DiskFull`, `Io`, …: the file; nothing
    /// more can be written.
    pub fn push(&mut self, cells: Vec<Cell<'static>>) -> Result<()> {
        let size = self.check(&cells).map_err(|e| e.at(self.path.display()))?;
        if self.pending_bytes + size > GROUP_BYTES {
            self.close_group()?;
        }
        self.pending.push(cells);
        self.pending_bytes += size;
        self.rows += 1;
        Ok(())
    }

    fn check(&self, cells: &[Cell<'static>]) -> Result<usize> {
        if cells.len() != self.columns.len() {
            let (found, expected) = (cells.len(), self.columns.len());
            let what = format!("expected {expected} cells in a row, found {found}");
            return Err(Error::internal(what));
        }
        for ((name, kind), cell) in self.columns.iter().zip(cells) {
            let mut images = cell.images().into_iter();
            if images.any(|bytes| table_image_extension(bytes).is_none()) {
                return Err(column_error(name, "is neither PNG nor JPEG nor TIFF"));
            }
            if let Cell::Array(array) = cell
                && *kind != ColumnType::Float32Array(array.shape().len())
            {
                return Err(column_error(name, "has arrays of other dimensions"));
            }
        }
        let size = cells.iter().map(Cell::size).sum();
        if size > MAX_ROW_BYTES {
            let what = format!("a row has {size} bytes, at most {MAX_ROW_BYTES} are supported");
            return Err(Error::input(what));
        }
        Ok(size)
    }

    fn close_group(&mut self) -> Result<()> {
        if self.pending.is_empty() {
            return Ok(());
        }
        let rows = std::mem::take(&mut self.pending);
        self.closed_bytes += std::mem::take(&mut self.pending_bytes);
        let columns = self
            .columns
            .iter()
            .map(|(name, kind)| (name.as_str(), *kind));
        write_columns(&mut self.writer, columns, &rows)
            .map_err(|e| write_error(e).at(self.path.display()))
    }

    /// Number of rows so far.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Approximate size of the rows so far, bytes.
    pub fn bytes(&self) -> usize {
        self.closed_bytes + self.pending_bytes
    }

    /// Writes the remaining rows, flushes the file and renames it to its final name.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, ….
    pub fn finish(mut self) -> Result<()> {
        self.close_group()?;
        let staged = self.writer.into_inner().map_err(write_error);
        staged
            .and_then(|staged| {
                let committed = staged.commit();
                committed.map_err(|e| Error::io("cannot write the table", e))
            })
            .map_err(|e| e.at(self.path.display()))
    }
}

/// File extension of an image in a table.
pub(super) fn table_image_extension(bytes: &[u8]) -> Option<&'static str> {
    image_extension(bytes).or_else(|| bytes.starts_with(TIFF).then_some("tiff"))
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;

    use parquet::file::reader::{FileReader as _, SerializedFileReader};
    use parquet::record::{ListAccessor as _, RowAccessor as _};

    use super::super::sample_rows::image;
    use super::*;
    use gripcast_base::files::Root;
    use gripcast_base::files::npy::Array;

    #[test]
    fn all_column_types_and_nulls_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let target = Root::new(folder.path()).top().join("a.parquet");
        let path = target.shown();
        let columns = [
            ("text", ColumnType::Text),
            ("tasks", ColumnType::TextList),
            ("whole", ColumnType::Int64),
            ("next.done", ColumnType::Bool),
            ("number", ColumnType::Float64),
            ("single", ColumnType::Float32),
            ("list", ColumnType::Float64List(2)),
            ("pose", ColumnType::Float32List(2)),
            ("view", ColumnType::Image),
            ("lift", ColumnType::ImageList),
            ("field", ColumnType::Float32Array(3)),
        ];
        let columns = columns.map(|(name, kind)| (name.to_owned(), kind)).to_vec();
        let metadata = [("pandas", "{}".to_owned())];
        let mut writer = TableWriter::create(target, columns, &metadata).unwrap();
        let view = image(true, 3, 100);
        let field: Vec<f32> = (0..12).map(|i| i as f32).collect();
        writer
            .push(vec![
                Cell::Text("é".into()),
                Cell::Text("grasp".into()),
                Cell::Integer(-7),
                Cell::Integer(1),
                Cell::Number(0.1),
                Cell::Number(0.1),
                Cell::Numbers(vec![1.0, f64::NAN]),
                Cell::Numbers(vec![0.5, 2.0]),
                Cell::Image(view.clone().into()),
                Cell::Images(vec![view.clone(), image(false, 4, 90)]),
                Cell::Array(Array::new([2, 3, 2], field.clone()).unwrap()),
            ])
            .unwrap();
        writer.push(vec![Cell::Null; 11]).unwrap();
        let mut empty = vec![Cell::Null; 11];
        empty[10] = Cell::Array(Array::new([2, 0, 2], Vec::new()).unwrap());
        writer.push(empty).unwrap();
        let mut flat = vec![Cell::Null; 11];
        flat[10] = Cell::Array(Array::new([2], vec![0.0; 2]).unwrap());
        let error = writer.push(flat).unwrap_err().to_string();
        assert!(error.contains("other dimensions"), "{error}");
        assert_eq!(writer.rows(), 3);
        assert!(writer.bytes() > 100 && !path.exists());
        let wrong = writer.push(vec![Cell::Null; 8]).unwrap_err();
        assert_eq!(wrong.kind(), ErrorKind::Internal);
        writer.finish().unwrap();
        let file = SerializedFileReader::new(fs::File::open(&path).unwrap()).unwrap();
        let metadata = file
            .metadata()
            .file_metadata()
            .key_value_metadata()
            .unwrap();
        let keys: Vec<&str> = metadata.iter().map(|pair| pair.key.as_str()).collect();
        assert_eq!(keys, ["huggingface", "pandas"]);
        let rows: Vec<_> = file
            .get_row_iter(None)
            .unwrap()
            .map(Result::unwrap)
            .collect();
        assert_eq!(rows[0].get_string(0).unwrap(), "é");
        let tasks = rows[0].get_list(1).unwrap();
        assert_eq!(tasks.elements().len(), 1);
        assert_eq!(rows[0].get_long(2).unwrap(), -7);
        assert!(rows[0].get_bool(3).unwrap());
        assert_eq!(rows[0].get_double(4).unwrap(), 0.1);
        assert_eq!(rows[0].get_float(5).unwrap(), 0.1_f32);
        assert_eq!(rows[0].get_list(6).unwrap().elements().len(), 2);
        assert_eq!(rows[0].get_list(7).unwrap().elements().len(), 2);
        let stored = rows[0].get_group(8).unwrap();
        assert_eq!(stored.get_bytes(0).unwrap().data(), view);
        assert_eq!(stored.get_string(1).unwrap(), "view.png");
        let lift = rows[0].get_list(9).unwrap();
        let second = lift.get_group(1).unwrap();
        assert_eq!(lift.len(), 2);
        assert_eq!(second.get_string(1).unwrap(), "lift.0001.jpg");
        let outer = rows[0].get_list(10).unwrap();
        let mut read = Vec::new();
        for i in 0..outer.len() {
            let middle = outer.get_list(i).unwrap();
            for j in 0..middle.len() {
                let inner = middle.get_list(j).unwrap();
                read.extend((0..inner.len()).map(|k| inner.get_float(k).unwrap()));
                assert_eq!((outer.len(), middle.len(), inner.len()), (2, 3, 2));
            }
        }
        assert_eq!(read, field);
        let outer = rows[2].get_list(10).unwrap();
        assert_eq!((outer.len(), outer.get_list(0).unwrap().len()), (2, 0));
        let nulls = rows[1].get_column_iter().map(|(_, field)| field);
        for field in nulls.take(8) {
            assert_eq!(field, &parquet::record::Field::Null);
        }
    }

    #[test]
    fn column_of_images_refuses_other_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let target = Root::new(folder.path()).top().join("a.parquet");
        let columns = vec![("view".to_owned(), ColumnType::Image)];
        let mut writer = TableWriter::create(target, columns, &[]).unwrap();
        let text = writer
            .push(vec![Cell::Image(b"GIF89a".as_slice().into())])
            .unwrap_err()
            .to_string();
        assert!(
            text.contains("column view is neither PNG nor JPEG nor TIFF"),
            "{text}"
        );
        drop(writer);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
