//! Writes the rows of one row group, column by column.

use std::io::Write;

use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::{ParquetError, Result};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};

use super::cell::Cell;
use super::columns::{Column, FACTS, Kind, columns};
use super::digest::ContentHash;
use super::metadata::GroupHash;
use super::row::picture_extension;

/// Values of one leaf with their levels, as Parquet has them.
struct Leaf<T> {
    values: Vec<T>,
    definition: Vec<i16>,
    repetition: Vec<i16>,
}

impl<T> Leaf<T> {
    fn new() -> Self {
        Self {
            values: Vec::new(),
            definition: Vec::new(),
            repetition: Vec::new(),
        }
    }

    /// Adds a value of an optional leaf that is `depth` optional or repeated levels deep.
    fn push(&mut self, value: Option<T>, depth: i16) {
        self.definition
            .push(if value.is_some() { depth } else { 0 });
        self.values.extend(value);
    }

    fn write<D, W>(&self, group: &mut SerializedRowGroupWriter<'_, W>) -> Result<()>
    where
        D: DataType<T = T>,
        W: Write + Send,
    {
        let missing = || ParquetError::General("the schema has too few columns".to_owned());
        let mut column = group.next_column()?.ok_or_else(missing)?;
        let repetition = (!self.repetition.is_empty()).then_some(&*self.repetition);
        let writer = column.typed::<D>();
        writer.write_batch(&self.values, Some(&self.definition), repetition)?;
        column.close()
    }
}

/// Writes one row group and tells its hashes. `cells`: of each row those of all columns.
pub(super) fn write_group<W: Write + Send>(
    writer: &mut SerializedFileWriter<W>,
    cells: &[Vec<Cell<'_>>],
) -> Result<GroupHash> {
    let mut group = writer.next_row_group()?;
    for (number, column) in columns().enumerate() {
        write_column(&mut group, column, cells.iter().map(|row| &row[number]))?;
    }
    group.close()?;
    Ok(hash(cells))
}

fn write_column<'a, W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    column: &Column,
    cells: impl Iterator<Item = &'a Cell<'a>> + Clone,
) -> Result<()> {
    match column.kind {
        Kind::Text => {
            let mut leaf = Leaf::new();
            cells.for_each(|cell| leaf.push(text(cell), 1));
            leaf.write::<ByteArrayType, W>(group)
        }
        Kind::Integer => {
            let mut leaf = Leaf::new();
            cells.for_each(|cell| leaf.push(integer(cell), 1));
            leaf.write::<Int64Type, W>(group)
        }
        Kind::Number => {
            let mut leaf = Leaf::new();
            cells.for_each(|cell| leaf.push(number(cell), 1));
            leaf.write::<DoubleType, W>(group)
        }
        Kind::Numbers(_) => {
            let mut leaf = Leaf::new();
            for cell in cells {
                let Cell::Numbers(numbers) = cell else {
                    leaf.push(None, 3);
                    leaf.repetition.push(0);
                    continue;
                };
                for (at, number) in numbers.iter().enumerate() {
                    leaf.push(Some(*number), 3);
                    leaf.repetition.push(i16::from(at > 0));
                }
            }
            leaf.write::<DoubleType, W>(group)
        }
        Kind::Picture => {
            let mut bytes = Leaf::new();
            let mut paths = Leaf::new();
            for cell in cells {
                bytes.push(picture(cell), 2);
                paths.push(picture_name(column, cell), 2);
            }
            bytes.write::<ByteArrayType, W>(group)?;
            paths.write::<ByteArrayType, W>(group)
        }
    }
}

fn text(cell: &Cell<'_>) -> Option<ByteArray> {
    match cell {
        Cell::Text(text) => Some(ByteArray::from(text.as_bytes().to_vec())),
        _ => None,
    }
}

fn integer(cell: &Cell<'_>) -> Option<i64> {
    match cell {
        Cell::Integer(integer) => Some(*integer),
        _ => None,
    }
}

fn number(cell: &Cell<'_>) -> Option<f64> {
    match cell {
        Cell::Number(number) => Some(*number),
        _ => None,
    }
}

fn picture(cell: &Cell<'_>) -> Option<ByteArray> {
    match cell {
        Cell::Picture(bytes) => Some(ByteArray::from(bytes.to_vec())),
        _ => None,
    }
}

/// The name of the picture's file in a dataset of single files: `<stage>.<role>.<ending>`.
fn picture_name(column: &Column, cell: &Cell<'_>) -> Option<ByteArray> {
    let Cell::Picture(bytes) = cell else {
        return None;
    };
    let ending = picture_extension(bytes).unwrap_or("bin");
    let name = format!("{}.{ending}", column.name.replace('_', "."));
    Some(ByteArray::from(name.into_bytes()))
}

fn hash(rows: &[Vec<Cell<'_>>]) -> GroupHash {
    let mut facts = ContentHash::default();
    let mut images = ContentHash::default();
    for row in rows {
        let (known, pictures) = row.split_at(FACTS.len());
        known.iter().for_each(|cell| facts.add(cell));
        pictures.iter().for_each(|cell| images.add(cell));
    }
    GroupHash {
        rows: rows.len(),
        facts_sha256: facts.finish(),
        images_sha256: images.finish(),
    }
}
