//! Writes tables with images whose columns are chosen while the program runs.

use std::sync::Arc;

use parquet::file::metadata::KeyValue;
use parquet::file::writer::SerializedFileWriter;

use super::cell::{Cell, wrong};
use super::group::write_columns;
use super::row::image_extension;
use super::staged::StagedShard;
use super::table_column::{TableKind, features, schema};
use super::writer::{GROUP_BYTES, MAX_ROW_BYTES, table_properties, write_error};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::BeneathPath;

/// Who wrote the file; a shard has another name, and hashes.
const CREATED_BY: &str = "gripcast-table version 1.0.0";

/// Writes one Parquet file, row by row, in bounded memory; pages and row groups are those of
/// shards.
///
/// The file has a hidden name in its folder until [`finish`](Self::finish). The same rows make the
/// same bytes.
pub struct TableWriter {
    place: BeneathPath,
    columns: Vec<(String, TableKind)>,
    writer: SerializedFileWriter<StagedShard>,
    waiting: Vec<Vec<Cell<'static>>>,
    waiting_bytes: usize,
    closed_bytes: usize,
    rows: usize,
}

impl TableWriter {
    /// Begins a file; `metadata` goes into its footer beside the features of Hugging Face.
    ///
    /// # Errors
    /// `NotFound`, `Permission`, `DiskFull`, `Io`: the folder.
    pub fn create(
        place: BeneathPath,
        columns: Vec<(String, TableKind)>,
        metadata: &[(&str, String)],
    ) -> Result<Self> {
        let begin = || {
            let staged =
                StagedShard::create(&place).map_err(|e| Error::io("cannot write the table", e))?;
            let all = || columns.iter().map(|(name, kind)| (name.as_str(), *kind));
            let images = all().filter(|(_, kind)| *kind == TableKind::Image);
            let properties =
                table_properties(CREATED_BY, features(all()), images.map(|(name, _)| name));
            let schema = schema(all()).map_err(write_error)?;
            let mut writer = SerializedFileWriter::new(staged, schema, Arc::new(properties))
                .map_err(write_error)?;
            for (key, value) in metadata {
                let pair = KeyValue::new((*key).to_owned(), value.clone());
                writer.append_key_value_metadata(pair);
            }
            Ok(writer)
        };
        let writer = begin().map_err(|e: Error| e.at(place.display()))?;
        Ok(Self {
            place,
            columns,
            writer,
            waiting: Vec::new(),
            waiting_bytes: 0,
            closed_bytes: 0,
            rows: 0,
        })
    }

    /// Adds a row: a cell a column, of the column's kind or null.
    ///
    /// # Errors
    /// `Input`: an image that is neither PNG nor JPEG, a row that is too large. `Internal`: not as
    /// many cells as columns. `DiskFull`, `Io`, …: the file; nothing more can be written.
    pub fn push(&mut self, cells: Vec<Cell<'static>>) -> Result<()> {
        let size = self.check(&cells).map_err(|e| e.at(self.place.display()))?;
        if self.waiting_bytes + size > GROUP_BYTES {
            self.close_group()?;
        }
        self.waiting.push(cells);
        self.waiting_bytes += size;
        self.rows += 1;
        Ok(())
    }

    fn check(&self, cells: &[Cell<'static>]) -> Result<usize> {
        if cells.len() != self.columns.len() {
            let (found, expected) = (cells.len(), self.columns.len());
            let what = format!("a row has {found} cells, the table {expected} columns");
            return Err(Error::internal(what));
        }
        for ((name, _), cell) in self.columns.iter().zip(cells) {
            if let Cell::Image(bytes) = cell
                && image_extension(bytes).is_none()
            {
                return Err(wrong(name, "is neither PNG nor JPEG".to_owned()));
            }
        }
        let size = cells.iter().map(Cell::size).sum();
        if size > MAX_ROW_BYTES {
            let what = format!("a row of {size} bytes is too large; at most {MAX_ROW_BYTES} bytes");
            return Err(Error::input(what));
        }
        Ok(size)
    }

    fn close_group(&mut self) -> Result<()> {
        if self.waiting.is_empty() {
            return Ok(());
        }
        let rows = std::mem::take(&mut self.waiting);
        self.closed_bytes += std::mem::take(&mut self.waiting_bytes);
        let columns = self
            .columns
            .iter()
            .map(|(name, kind)| (name.as_str(), *kind));
        write_columns(&mut self.writer, columns, &rows)
            .map_err(|e| write_error(e).at(self.place.display()))
    }

    /// Rows so far.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Bytes of the rows so far, about.
    pub fn bytes(&self) -> usize {
        self.closed_bytes + self.waiting_bytes
    }

    /// Writes the rest, brings the file to the disk and gives it its name.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, ….
    pub fn finish(mut self) -> Result<()> {
        self.close_group()?;
        let staged = self.writer.into_inner();
        staged
            .map_err(write_error)
            .and_then(|staged| {
                let committed = staged.commit();
                committed.map_err(|e| Error::io("cannot write the table", e))
            })
            .map_err(|e| e.at(self.place.display()))
    }
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;

    use parquet::file::reader::{FileReader as _, SerializedFileReader};
    use parquet::record::RowAccessor as _;

    use super::super::sample_rows::image;
    use super::*;
    use gripcast_base::files::Root;

    #[test]
    fn every_kind_comes_back_and_nulls_stay_null() {
        let folder = tempfile::tempdir().unwrap();
        let place = Root::new(folder.path()).top().join("a.parquet");
        let path = place.shown();
        let columns = [
            ("text", TableKind::Text),
            ("tasks", TableKind::OneText),
            ("whole", TableKind::Integer),
            ("next.done", TableKind::Flag),
            ("number", TableKind::Number),
            ("single", TableKind::Single),
            ("list", TableKind::Numbers),
            ("pose", TableKind::Singles(2)),
            ("seen", TableKind::Image),
        ];
        let columns = columns.map(|(name, kind)| (name.to_owned(), kind)).to_vec();
        let metadata = [("pandas", "{}".to_owned())];
        let mut writer = TableWriter::create(place, columns, &metadata).unwrap();
        let seen = image(true, 3, 100);
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
                Cell::Image(seen.clone().into()),
            ])
            .unwrap();
        writer.push(vec![Cell::Null; 9]).unwrap();
        assert_eq!(writer.rows(), 2);
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
        assert_eq!(stored.get_bytes(0).unwrap().data(), seen);
        assert_eq!(stored.get_string(1).unwrap(), "seen.png");
        let nulls = rows[1].get_column_iter().map(|(_, field)| field);
        for field in nulls.take(8) {
            assert_eq!(field, &parquet::record::Field::Null);
        }
    }

    #[test]
    fn an_image_must_be_one() {
        let folder = tempfile::tempdir().unwrap();
        let place = Root::new(folder.path()).top().join("a.parquet");
        let columns = vec![("seen".to_owned(), TableKind::Image)];
        let mut writer = TableWriter::create(place, columns, &[]).unwrap();
        let text = writer
            .push(vec![Cell::Image(b"GIF89a".as_slice().into())])
            .unwrap_err()
            .to_string();
        assert!(
            text.contains("column seen is neither PNG nor JPEG"),
            "{text}"
        );
        drop(writer);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
