//! Writes the rows of one row group, column by column.

use std::io::Write;

use parquet::data_type::{
    BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type,
};
use parquet::errors::{ParquetError, Result};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};

use super::cell::Cell;
use super::columns::{FACTS, table_columns};
use super::digest::ContentHash;
use super::metadata::GroupHash;
use super::row::image_extension;
use super::table_column::TableKind;

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

/// Writes one row group of a shard and tells its hashes. `cells`: of each row those of all columns.
pub(super) fn write_group<W: Write + Send>(
    writer: &mut SerializedFileWriter<W>,
    cells: &[Vec<Cell<'_>>],
) -> Result<GroupHash> {
    write_columns(writer, table_columns(), cells)?;
    Ok(hash(cells))
}

/// Writes one row group of any table.
pub(super) fn write_columns<'a, W: Write + Send>(
    writer: &mut SerializedFileWriter<W>,
    columns: impl Iterator<Item = (&'a str, TableKind)>,
    cells: &[Vec<Cell<'_>>],
) -> Result<()> {
    let mut group = writer.next_row_group()?;
    for (number, (name, kind)) in columns.enumerate() {
        write_column(&mut group, name, kind, cells.iter().map(|row| &row[number]))?;
    }
    group.close()?;
    Ok(())
}

fn write_column<'a, W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    name: &str,
    kind: TableKind,
    cells: impl Iterator<Item = &'a Cell<'a>>,
) -> Result<()> {
    match kind {
        TableKind::Text => write_values::<ByteArrayType, W>(group, cells.map(text)),
        TableKind::Integer => write_values::<Int64Type, W>(group, cells.map(integer)),
        TableKind::Flag => {
            let flag = |cell| integer(cell).map(|value| value != 0);
            write_values::<BoolType, W>(group, cells.map(flag))
        }
        TableKind::Number => write_values::<DoubleType, W>(group, cells.map(number)),
        TableKind::Single => {
            let single = |cell| number(cell).map(|value| value as f32);
            write_values::<FloatType, W>(group, cells.map(single))
        }
        TableKind::OneText => {
            let list = |cell| text(cell).map(|text| vec![text]);
            write_lists::<ByteArrayType, W>(group, cells.map(list))
        }
        TableKind::Numbers => write_lists::<DoubleType, W>(group, cells.map(numbers)),
        TableKind::Singles(_) => {
            let singles = |cell| {
                let numbers = numbers(cell)?;
                Some(numbers.into_iter().map(|value| value as f32).collect())
            };
            write_lists::<FloatType, W>(group, cells.map(singles))
        }
        TableKind::Image => {
            let mut bytes = Leaf::new();
            let mut paths = Leaf::new();
            for cell in cells {
                bytes.push(image(cell), 2);
                paths.push(image_name(name, cell), 2);
            }
            bytes.write::<ByteArrayType, W>(group)?;
            paths.write::<ByteArrayType, W>(group)
        }
    }
}

fn write_values<D: DataType, W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    values: impl Iterator<Item = Option<D::T>>,
) -> Result<()> {
    let mut leaf = Leaf::new();
    values.for_each(|value| leaf.push(value, 1));
    leaf.write::<D, W>(group)
}

fn write_lists<D: DataType, W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    lists: impl Iterator<Item = Option<Vec<D::T>>>,
) -> Result<()> {
    let mut leaf = Leaf::new();
    for list in lists {
        let Some(list) = list else {
            leaf.push(None, 3);
            leaf.repetition.push(0);
            continue;
        };
        if list.is_empty() {
            // The list is there, an element is not.
            leaf.definition.push(1);
            leaf.repetition.push(0);
        }
        for (at, value) in list.into_iter().enumerate() {
            leaf.push(Some(value), 3);
            leaf.repetition.push(i16::from(at > 0));
        }
    }
    leaf.write::<D, W>(group)
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

fn numbers(cell: &Cell<'_>) -> Option<Vec<f64>> {
    match cell {
        Cell::Numbers(numbers) => Some(numbers.clone()),
        _ => None,
    }
}

fn image(cell: &Cell<'_>) -> Option<ByteArray> {
    match cell {
        Cell::Image(bytes) => Some(ByteArray::from(bytes.to_vec())),
        _ => None,
    }
}

/// The name of the image's file in a dataset of single files: `<stage>.<role>.<ending>`.
fn image_name(column: &str, cell: &Cell<'_>) -> Option<ByteArray> {
    let Cell::Image(bytes) = cell else {
        return None;
    };
    let ending = image_extension(bytes).unwrap_or("bin");
    let name = format!("{}.{ending}", column.replace('_', "."));
    Some(ByteArray::from(name.into_bytes()))
}

fn hash(rows: &[Vec<Cell<'_>>]) -> GroupHash {
    let mut facts = ContentHash::default();
    let mut images = ContentHash::default();
    for row in rows {
        let (known, rest) = row.split_at(FACTS.len());
        known.iter().for_each(|cell| facts.add(cell));
        rest.iter().for_each(|cell| images.add(cell));
    }
    GroupHash {
        rows: rows.len(),
        facts_sha256: facts.finish(),
        images_sha256: images.finish(),
    }
}
