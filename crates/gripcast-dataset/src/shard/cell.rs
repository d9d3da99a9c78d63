//! Value of one column in one row.

use std::borrow::Cow;
use std::fmt;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::npy::Array;

/// Value of one column in one row.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell<'a> {
    /// Null.
    Null,
    /// UTF-8 string.
    Text(Cow<'a, str>),
    /// A 64-bit integer.
    Integer(i64),
    /// A 64-bit float.
    Number(f64),
    /// A list of 64-bit floats.
    Numbers(Vec<f64>),
    /// An encoded image.
    Image(Cow<'a, [u8]>),
    /// Encoded images.
    Images(Vec<Vec<u8>>),
    /// An array of 32-bit floats.
    Array(Array),
}

impl<'a> Cell<'a> {
    /// A borrowed string.
    pub fn text(text: &'a str) -> Self {
        Self::Text(Cow::Borrowed(text))
    }

    pub(super) fn optional_text(text: Option<&'a str>) -> Self {
        text.map_or(Self::Null, Self::text)
    }

    pub(super) fn optional_number(number: Option<f64>) -> Self {
        number.map_or(Self::Null, Self::Number)
    }

    pub(super) fn image(bytes: &'a [u8]) -> Self {
        Self::Image(Cow::Borrowed(bytes))
    }

    pub(super) fn optional_image(bytes: Option<&'a [u8]>) -> Self {
        bytes.map_or(Self::Null, Self::image)
    }

    pub(super) fn as_bytes(&self) -> Option<&[u8]> {
        match self {
            Self::Text(text) => Some(text.as_bytes()),
            Self::Image(bytes) => Some(bytes),
            _ => None,
        }
    }

    /// The encoded images of a cell of one or several.
    pub(super) fn images(&self) -> Vec<&[u8]> {
        match self {
            Self::Image(bytes) => vec![bytes],
            Self::Images(images) => images.iter().map(Vec::as_slice).collect(),
            _ => Vec::new(),
        }
    }

    pub(super) fn as_integer(&self) -> Option<i64> {
        match self {
            Self::Integer(integer) => Some(*integer),
            _ => None,
        }
    }

    pub(super) fn as_number(&self) -> Option<f64> {
        match self {
            Self::Number(number) => Some(*number),
            _ => None,
        }
    }

    pub(super) fn as_numbers(&self) -> Option<&[f64]> {
        match self {
            Self::Numbers(numbers) => Some(numbers),
            _ => None,
        }
    }

    /// Approximate size in bytes.
    pub(super) fn size(&self) -> usize {
        match self {
            Self::Null => 1,
            Self::Text(text) => text.len() + 4,
            Self::Integer(_) | Self::Number(_) => 8,
            Self::Numbers(numbers) => 8 * numbers.len(),
            Self::Image(bytes) => bytes.len() + 4,
            Self::Images(images) => images.iter().map(|bytes| bytes.len() + 4).sum(),
            Self::Array(array) => 4 * array.values().len(),
        }
    }
}

/// Error of a column.
pub(super) fn column_error(column: &str, what: impl fmt::Display) -> Error {
    Error::input(format!("column {column} {what}"))
}

/// Reads the cells of a row one by one.
pub(super) struct Cells<'a> {
    cells: &'a mut dyn Iterator<Item = (&'static str, Cell<'static>)>,
}

impl<'a> Cells<'a> {
    pub(super) fn new(cells: &'a mut dyn Iterator<Item = (&'static str, Cell<'static>)>) -> Self {
        Self { cells }
    }

    /// Converts the next cell; `None` is an error.
    fn next<T>(
        &mut self,
        take: impl FnOnce(Cell<'static>) -> Option<T>,
    ) -> Result<(&'static str, T)> {
        let Some((name, cell)) = self.cells.next() else {
            return Err(Error::internal("too few columns in a row"));
        };
        match take(cell) {
            Some(value) => Ok((name, value)),
            None => Err(column_error(name, "is null")),
        }
    }

    pub(super) fn text(&mut self) -> Result<String> {
        self.next(text).map(|(_, text)| text)
    }

    pub(super) fn optional_text(&mut self) -> Result<Option<String>> {
        self.next(|cell| Some(text(cell))).map(|(_, text)| text)
    }

    pub(super) fn named<T: Copy>(&mut self, variants: &[(&str, T)]) -> Result<T> {
        let (column, name) = self.next(text)?;
        let found = variants.iter().find(|(variant, _)| *variant == name);
        found.map(|(_, value)| *value).ok_or_else(|| {
            let known: Vec<&str> = variants.iter().map(|(name, _)| *name).collect();
            column_error(
                column,
                format!("is {name:?}, expected {}", known.join(" or ")),
            )
        })
    }

    pub(super) fn integer(&mut self) -> Result<i64> {
        self.next(|cell| cell.as_integer())
            .map(|(_, integer)| integer)
    }

    pub(super) fn natural<T: TryFrom<i64>>(&mut self) -> Result<T> {
        let (column, value) = self.next(|cell| cell.as_integer())?;
        T::try_from(value)
            .map_err(|_| column_error(column, format!("is {value}, which is out of range")))
    }

    pub(super) fn optional_number(&mut self) -> Result<Option<f64>> {
        self.next(|cell| Some(cell.as_number()))
            .map(|(_, number)| number)
    }

    pub(super) fn optional_numbers(&mut self) -> Result<Option<Vec<f64>>> {
        self.next(|cell| Some(cell.as_numbers().map(<[f64]>::to_vec)))
            .map(|(_, numbers)| numbers)
    }

    pub(super) fn image(&mut self) -> Result<Vec<u8>> {
        self.next(image).map(|(_, image)| image)
    }

    pub(super) fn optional_image(&mut self) -> Result<Option<Vec<u8>>> {
        self.next(|cell| Some(image(cell))).map(|(_, image)| image)
    }
}

fn text(cell: Cell<'static>) -> Option<String> {
    match cell {
        Cell::Text(text) => Some(Cow::into_owned(text)),
        _ => None,
    }
}

fn image(cell: Cell<'static>) -> Option<Vec<u8>> {
    match cell {
        Cell::Image(bytes) => Some(Cow::into_owned(bytes)),
        _ => None,
    }
}
