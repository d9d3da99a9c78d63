//! Writes a row group, column by column.

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
use super::table::table_image_extension;
use super::table_column::ColumnType;

/// Values of one leaf column with their definition and repetition levels.
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

    /// Adds a value of an optional leaf at `depth` optional or repeated levels.
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
        let missing = || ParquetError::General("too few columns in the schema".to_owned());
        let mut column = group.next_column()?.ok_or_else(missing)?;
        let repetition = (!self.repetition.is_empty()).then_some(&*self.repetition);
        let writer = column.typed::<D>();
        writer.write_batch(&self.values, Some(&self.definition), repetition)?;
        column.close()
    }
}

/// Writes one row group of a shard and returns its hashes. `cells`: all columns of each row.
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
    columns: impl Iterator<Item = (&'a str, ColumnType)>,
    cells: &[Vec<Cell<'_>>],
) -> Result<()> {
    let mut group = writer.next_row_group()?;
    for (index, (name, kind)) in columns.enumerate() {
        write_column(&mut group, name, kind, cells.iter().map(|row| &row[index]))?;
    }
    group.close()?;
    Ok(())
}

fn write_column<'a, W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    name: &str,
    kind: ColumnType,
    cells: impl Iterator<Item = &'a Cell<'a>>,
) -> Result<()> {
    let bytes = |cell: &Cell<'_>| Some(ByteArray::from(cell.as_bytes()?.to_vec()));
    match kind {
        ColumnType::Text => write_values::<ByteArrayType, W>(group, cells.map(bytes)),
        ColumnType::Int64 => write_values::<Int64Type, W>(group, cells.map(Cell::as_integer)),
        ColumnType::Bool => {
            let flag = |cell: &Cell<'_>| cell.as_integer().map(|value| value != 0);
            write_values::<BoolType, W>(group, cells.map(flag))
        }
        ColumnType::Float64 => write_values::<DoubleType, W>(group, cells.map(Cell::as_number)),
        ColumnType::Float32 => {
            let single = |cell: &Cell<'_>| cell.as_number().map(|value| value as f32);
            write_values::<FloatType, W>(group, cells.map(single))
        }
        ColumnType::TextList => {
            let list = |cell| bytes(cell).map(|text| vec![text]);
            write_lists::<ByteArrayType, W>(group, cells.map(list))
        }
        ColumnType::Float64List(_) => {
            let list = |cell: &Cell<'_>| cell.as_numbers().map(<[f64]>::to_vec);
            write_lists::<DoubleType, W>(group, cells.map(list))
        }
        ColumnType::Float32List(_) => {
            let list = |cell: &Cell<'_>| {
                let numbers = cell.as_numbers()?.iter();
                Some(numbers.map(|value| *value as f32).collect())
            };
            write_lists::<FloatType, W>(group, cells.map(list))
        }
        ColumnType::Image => {
            let mut images = Leaf::new();
            let mut paths = Leaf::new();
            for cell in cells {
                images.push(bytes(cell), 2);
                let image = cell.images().first().copied();
                paths.push(image.map(|image| image_name(name, None, image)), 2);
            }
            images.write::<ByteArrayType, W>(group)?;
            paths.write::<ByteArrayType, W>(group)
        }
        ColumnType::ImageList => write_image_lists(group, name, cells),
        ColumnType::Float32Array(dimensions) => write_arrays(group, dimensions, cells),
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
            // The list exists, but has no element.
            leaf.definition.push(1);
            leaf.repetition.push(0);
        }
        for (index, value) in list.into_iter().enumerate() {
            leaf.push(Some(value), 3);
            leaf.repetition.push(i16::from(index > 0));
        }
    }
    leaf.write::<D, W>(group)
}

fn write_image_lists<'a, W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    name: &str,
    cells: impl Iterator<Item = &'a Cell<'a>>,
) -> Result<()> {
    let mut images = Leaf::new();
    let mut paths = Leaf::new();
    for cell in cells {
        let list = cell.images();
        if list.is_empty() {
            images.push(None, 4);
            images.repetition.push(0);
            paths.push(None, 4);
            paths.repetition.push(0);
        }
        for (index, image) in list.into_iter().enumerate() {
            images.push(Some(ByteArray::from(image.to_vec())), 4);
            images.repetition.push(i16::from(index > 0));
            paths.push(Some(image_name(name, Some(index), image)), 4);
            paths.repetition.push(i16::from(index > 0));
        }
    }
    images.write::<ByteArrayType, W>(group)?;
    paths.write::<ByteArrayType, W>(group)
}

/// Writes arrays as nested lists. Each list is one optional and one repeated level.
fn write_arrays<'a, W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    dimensions: usize,
    cells: impl Iterator<Item = &'a Cell<'a>>,
) -> Result<()> {
    let mut leaf = Leaf::new();
    for cell in cells {
        let Cell::Array(array) = cell else {
            leaf.push(None, 0);
            leaf.repetition.push(0);
            continue;
        };
        // Lists below an empty one do not exist.
        let shape = array.shape();
        let depth = shape
            .iter()
            .position(|size| *size == 0)
            .unwrap_or(dimensions);
        let entries: usize = shape[..depth].iter().product();
        for entry in 0..entries {
            match array.values().get(entry) {
                Some(value) => leaf.push(Some(*value), 2 * dimensions as i16 + 1),
                None => leaf.definition.push(2 * depth as i16 + 1),
            }
            leaf.repetition.push(level(&shape[..depth], entry));
        }
    }
    leaf.write::<FloatType, W>(group)
}

/// Repetition level of an entry: the outermost list of which it is a further element, 0 for the first
/// entry.
fn level(shape: &[usize], entry: usize) -> i16 {
    if entry == 0 {
        return 0;
    }
    let mut level = shape.len();
    let mut stride = 1;
    for size in shape.iter().skip(1).rev() {
        stride *= size;
        if entry.is_multiple_of(stride) {
            level -= 1;
        }
    }
    level as i16
}

/// File name of the image in a dataset of single files: `<stage>.<role>.<extension>`.
fn image_name(column: &str, number: Option<usize>, image: &[u8]) -> ByteArray {
    let extension = table_image_extension(image).unwrap_or("bin");
    let number = number.map_or(String::new(), |number| format!("{number:04}."));
    let name = format!("{}.{number}{extension}", column.replace('_', "."));
    ByteArray::from(name.into_bytes())
}

fn hash(rows: &[Vec<Cell<'_>>]) -> GroupHash {
    let mut facts = ContentHash::default();
    let mut images = ContentHash::default();
    for row in rows {
        let (scalars, rest) = row.split_at(FACTS.len());
        facts.add_facts(scalars);
        rest.iter().for_each(|cell| images.add(cell));
    }
    GroupHash {
        rows: rows.len(),
        facts_sha256: facts.finish(),
        images_sha256: images.finish(),
    }
}
