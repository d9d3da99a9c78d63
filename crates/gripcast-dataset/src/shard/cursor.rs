//! Reads a row group in batches, column by column.

use std::borrow::Cow;
use std::sync::Arc;

use parquet::basic::Type;
use parquet::column::reader::ColumnReaderImpl;
use parquet::data_type::{
    BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int32Type, Int64Type,
};
use parquet::errors::ParquetError;
use parquet::file::metadata::{ColumnChunkMetaData, RowGroupMetaData};

use super::cell::{Cell, column_error};
use super::columns::{Column, columns};
use super::layout::Layout;
use super::page::ChunkPages;
use super::source::Source;
use super::table_column::ColumnType;
use gripcast_base::error::{Error, Result};

/// Maximum size of the rows in memory, bytes.
const MAX_BYTES: usize = 1 << 30;
/// Definition level of an element where list and element are nullable; level 0 is a null list.
const LIST_LEVELS: i16 = 3;

/// Cursor over the rows of a row group.
pub(super) struct GroupCursor {
    columns: Vec<(&'static Column, ColumnCursor)>,
}

/// Cells of a batch of rows, by column.
pub(super) struct Batch {
    pub(super) columns: Vec<(&'static str, std::vec::IntoIter<Cell<'static>>)>,
    /// Size of the cells, bytes.
    pub(super) size: usize,
}

enum ColumnCursor {
    /// All null: the file lacks the column.
    Absent,
    Text(Leaf<ByteArrayType>),
    Integer(Leaf<Int64Type>),
    ShortInteger(Leaf<Int32Type>),
    Bool(Leaf<BoolType>),
    Number(Leaf<DoubleType>),
    ShortNumber(Leaf<FloatType>),
    Numbers(Leaf<DoubleType>, usize),
    ShortNumbers(Leaf<FloatType>, usize),
    Image(Leaf<ByteArrayType>),
    /// Images as lists of numbers.
    ImageList(Leaf<Int32Type>),
}

struct Leaf<D: DataType> {
    reader: ColumnReaderImpl<D>,
    /// Definition level of a non-null value.
    defined: i16,
    repeated: bool,
}

/// Values of a batch of rows with their levels.
struct Levels<T> {
    values: Vec<T>,
    definition: Vec<i16>,
    repetition: Vec<i16>,
}

impl GroupCursor {
    /// Opens the first `count` columns of a row group.
    ///
    /// # Errors
    /// `Input`: a column is outside the file or has an unsupported compression.
    pub(super) fn open(
        source: &Arc<Source>,
        group: &RowGroupMetaData,
        layout: &Layout,
        count: usize,
    ) -> Result<Self> {
        let open = |(column, leaf): (&'static Column, &Option<usize>)| {
            let chunk = leaf.map(|leaf| group.column(leaf));
            let cursor = ColumnCursor::open(source, chunk, column);
            let cursor = cursor.map_err(|e| read_error(column.name, e))?;
            Ok((column, cursor))
        };
        let columns = columns().zip(&layout.leaves).take(count);
        Ok(Self {
            columns: columns.map(open).collect::<Result<_>>()?,
        })
    }

    /// Reads exactly `rows` rows.
    ///
    /// # Errors
    /// `Input`: they are unreadable, or exceed `MAX_BYTES` together with `in_memory`.
    pub(super) fn read(&mut self, rows: usize, in_memory: usize) -> Result<Batch> {
        let mut size = 0;
        let mut read = Vec::new();
        for (column, cursor) in &mut self.columns {
            let cells = cursor.read(rows, column, MAX_BYTES.saturating_sub(in_memory + size))?;
            size += cells.iter().map(Cell::size).sum::<usize>();
            read.push((column.name, cells.into_iter()));
        }
        Ok(Batch {
            columns: read,
            size,
        })
    }
}

impl ColumnCursor {
    fn open(
        source: &Arc<Source>,
        chunk: Option<&ColumnChunkMetaData>,
        column: &Column,
    ) -> Result<Self, ParquetError> {
        let Some(chunk) = chunk else {
            return Ok(Self::Absent);
        };
        Ok(match (column.kind, chunk.column_type()) {
            (ColumnType::Text, _) => Self::Text(Leaf::open(source, chunk)?),
            (ColumnType::Int64, Type::BOOLEAN) => Self::Bool(Leaf::open(source, chunk)?),
            (ColumnType::Int64, Type::INT32) => Self::ShortInteger(Leaf::open(source, chunk)?),
            (ColumnType::Int64, _) => Self::Integer(Leaf::open(source, chunk)?),
            (ColumnType::Float64, Type::FLOAT) => Self::ShortNumber(Leaf::open(source, chunk)?),
            (ColumnType::Float64, _) => Self::Number(Leaf::open(source, chunk)?),
            (ColumnType::Float64List(length), Type::FLOAT) => {
                Self::ShortNumbers(Leaf::open(source, chunk)?, length)
            }
            (ColumnType::Float64List(length), _) => {
                Self::Numbers(Leaf::open(source, chunk)?, length)
            }
            (ColumnType::Image, Type::INT32) => Self::ImageList(Leaf::open(source, chunk)?),
            (ColumnType::Image, _) => Self::Image(Leaf::open(source, chunk)?),
            (other, _) => return Err(ParquetError::General(format!("type {other:?} in a shard"))),
        })
    }

    fn read(&mut self, rows: usize, column: &Column, budget: usize) -> Result<Vec<Cell<'static>>> {
        let cell_or_null = |cell: Option<Cell<'static>>| cell.unwrap_or(Cell::Null);
        Ok(match self {
            Self::Absent => (0..rows).map(|_| Cell::Null).collect(),
            Self::Text(leaf) => {
                let values = leaf.read(rows, column)?;
                check_budget(&values, column, budget)?;
                let text = |value: Option<ByteArray>| value.map(|v| text(&v, column)).transpose();
                let cells = values.into_iter().map(|v| text(v).map(cell_or_null));
                cells.collect::<Result<_>>()?
            }
            Self::Image(leaf) => {
                let values = leaf.read(rows, column)?;
                check_budget(&values, column, budget)?;
                let image = |v: ByteArray| Cell::Image(Cow::Owned(v.data().to_vec()));
                let cells = values.into_iter().map(|v| cell_or_null(v.map(image)));
                cells.collect()
            }
            Self::Integer(leaf) => {
                let values = leaf.read(rows, column)?.into_iter();
                values.map(|v| cell_or_null(v.map(Cell::Integer))).collect()
            }
            Self::ShortInteger(leaf) => {
                let values = leaf.read(rows, column)?.into_iter();
                let long = |v| Cell::Integer(i64::from(v));
                values.map(|v| cell_or_null(v.map(long))).collect()
            }
            Self::Bool(leaf) => {
                let values = leaf.read(rows, column)?.into_iter();
                let integer = |v| Cell::Integer(i64::from(v));
                values.map(|v| cell_or_null(v.map(integer))).collect()
            }
            Self::Number(leaf) => {
                let values = leaf.read(rows, column)?.into_iter();
                values.map(|v| cell_or_null(v.map(Cell::Number))).collect()
            }
            Self::ShortNumber(leaf) => {
                let values = leaf.read(rows, column)?.into_iter();
                let double = |v| Cell::Number(f64::from(v));
                values.map(|v| cell_or_null(v.map(double))).collect()
            }
            Self::Numbers(leaf, length) => leaf.read_lists(rows, *length, column)?,
            Self::ShortNumbers(leaf, length) => leaf.read_lists(rows, *length, column)?,
            Self::ImageList(leaf) => leaf.read_images(rows, column)?,
        })
    }
}

impl<D: DataType> Leaf<D> {
    fn open(source: &Arc<Source>, chunk: &ColumnChunkMetaData) -> Result<Self, ParquetError> {
        let pages = ChunkPages::new(Arc::clone(source), chunk)?;
        let descriptor = chunk.column_descr_ptr();
        Ok(Self {
            defined: descriptor.max_def_level(),
            repeated: descriptor.max_rep_level() > 0,
            reader: ColumnReaderImpl::new(descriptor, Box::new(pages)),
        })
    }

    /// Reads one value per row, none where it is null.
    fn read(&mut self, rows: usize, column: &Column) -> Result<Vec<Option<D::T>>> {
        let Levels {
            values, definition, ..
        } = self.read_levels(rows, column)?;
        if self.defined == 0 {
            return Ok(values.into_iter().map(Some).collect());
        }
        let mut values = values.into_iter();
        let value = |level: i16| (level == self.defined).then(|| values.next()).flatten();
        Ok(definition.into_iter().map(value).collect())
    }

    /// Reads values, definition and repetition levels of `rows` rows.
    fn read_levels(&mut self, rows: usize, column: &Column) -> Result<Levels<D::T>> {
        let (mut values, mut definition, mut repetition) = (Vec::new(), Vec::new(), Vec::new());
        let mut read = 0;
        while read < rows {
            let levels = (self.defined > 0).then_some(&mut definition);
            let repeats = self.repeated.then_some(&mut repetition);
            let records = self
                .reader
                .read_records(rows - read, levels, repeats, &mut values);
            let (records, _, _) = records.map_err(|e| read_error(column.name, e))?;
            if records == 0 {
                return Err(column_error(column.name, "has too few rows"));
            }
            read += records;
        }
        Ok(Levels {
            values,
            definition,
            repetition,
        })
    }
}

impl<D: DataType> Leaf<D>
where
    D::T: Into<f64> + Copy,
{
    /// Reads one list of at most `max` values per row, or null.
    fn read_lists(
        &mut self,
        rows: usize,
        max: usize,
        column: &Column,
    ) -> Result<Vec<Cell<'static>>> {
        let Levels {
            values,
            definition,
            repetition,
        } = self.read_levels(rows, column)?;
        let malformed = || {
            let what = format!("has a row that is not a list of at most {max} numbers");
            column_error(column.name, what)
        };
        let mut lists = Vec::with_capacity(rows);
        let (mut values, mut start) = (values.as_slice(), 0);
        while start < repetition.len() {
            let next = repetition[start + 1..].iter().position(|&level| level == 0);
            let end = next.map_or(repetition.len(), |next| start + 1 + next);
            let levels = definition.get(start..end).ok_or_else(malformed)?;
            let is_whole = levels.len() <= max && levels.iter().all(|&level| level == self.defined);
            lists.push(if levels == [0] && self.defined == LIST_LEVELS {
                Cell::Null
            } else if is_whole && let Some((list, rest)) = values.split_at_checked(levels.len()) {
                values = rest;
                Cell::Numbers(list.iter().map(|x| (*x).into()).collect())
            } else {
                return Err(malformed());
            });
            start = end;
        }
        if lists.len() != rows {
            return Err(malformed());
        }
        Ok(lists)
    }
}

impl Leaf<Int32Type> {
    /// Reads one list of bytes per row; an empty one is null.
    fn read_images(&mut self, rows: usize, column: &Column) -> Result<Vec<Cell<'static>>> {
        let Levels {
            values,
            definition,
            repetition,
        } = self.read_levels(rows, column)?;
        let malformed = || column_error(column.name, "has a list with something else than bytes");
        let mut cells = Vec::with_capacity(rows);
        let (mut values, mut start) = (values.into_iter(), 0);
        while start < repetition.len() {
            let next = repetition[start + 1..].iter().position(|&level| level == 0);
            let end = next.map_or(repetition.len(), |next| start + 1 + next);
            let levels = definition.get(start..end).ok_or_else(malformed)?;
            if matches!(levels, [level] if *level < self.defined) {
                cells.push(Cell::Null);
            } else {
                let bytes = levels.iter().map(|level| {
                    let value = (*level == self.defined).then(|| values.next()).flatten();
                    value.and_then(|value| u8::try_from(value).ok())
                });
                let bytes: Option<Vec<u8>> = bytes.collect();
                cells.push(Cell::Image(Cow::Owned(bytes.ok_or_else(malformed)?)));
            }
            start = end;
        }
        if cells.len() != rows {
            return Err(malformed());
        }
        Ok(cells)
    }
}

fn text(value: &ByteArray, column: &Column) -> Result<Cell<'static>> {
    let text = std::str::from_utf8(value.data());
    let text = text.map_err(|e| column_error(column.name, format!("is not valid UTF-8: {e}")))?;
    Ok(Cell::Text(Cow::Owned(text.to_owned())))
}

/// Checks the size of values before they are copied out of their pages.
fn check_budget(values: &[Option<ByteArray>], column: &Column, budget: usize) -> Result<()> {
    let mut sum = 0_usize;
    for value in values.iter().flatten() {
        sum = sum.saturating_add(value.len());
    }
    if sum > budget {
        let what = format!("needs more than {MAX_BYTES} bytes of memory");
        let remedy = "write the file again with smaller row groups";
        return Err(column_error(column.name, what).remedy(remedy));
    }
    Ok(())
}

fn read_error(column: &str, error: ParquetError) -> Error {
    match error {
        ParquetError::External(cause) => match cause.downcast::<std::io::Error>() {
            Ok(cause) => Error::io("cannot read the shard", *cause).at(format!("column {column}")),
            Err(cause) => column_error(column, cause.to_string()),
        },
        ParquetError::NYI(what) => column_error(column, what),
        ParquetError::General(what) => column_error(column, format!("is damaged: {what}")),
        other => column_error(column, format!("is damaged: {other}")),
    }
}
