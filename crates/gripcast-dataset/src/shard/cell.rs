//! What stands in one column of one row.

use std::borrow::Cow;

use gripcast_base::error::{Error, Result};

/// One value on its way between a row and a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell<'a> {
    /// Nothing.
    Null,
    /// UTF-8.
    Text(Cow<'a, str>),
    /// A 64-bit integer.
    Integer(i64),
    /// A 64-bit float.
    Number(f64),
    /// A list of 64-bit floats.
    Numbers(Vec<f64>),
    /// An encoded image.
    Image(Cow<'a, [u8]>),
}

impl<'a> Cell<'a> {
    /// A borrowed text.
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

    /// Bytes that the value takes, about.
    pub(super) fn size(&self) -> usize {
        match self {
            Self::Null => 1,
            Self::Text(text) => text.len() + 4,
            Self::Integer(_) | Self::Number(_) => 8,
            Self::Numbers(numbers) => 8 * numbers.len(),
            Self::Image(bytes) => bytes.len() + 4,
        }
    }
}

/// `Input`: what is wrong in a column.
pub(super) fn wrong(column: &str, what: String) -> Error {
    Error::input(format!("column {column} {what}"))
}

/// Takes the cells of a row one by one.
pub(super) struct Cells<'a> {
    cells: &'a mut dyn Iterator<Item = (&'static str, Cell<'static>)>,
}

impl<'a> Cells<'a> {
    pub(super) fn new(cells: &'a mut dyn Iterator<Item = (&'static str, Cell<'static>)>) -> Self {
        Self { cells }
    }

    /// What `take` makes of the next cell; none is an error.
    fn next<T>(
        &mut self,
        take: impl FnOnce(Cell<'static>) -> Option<T>,
    ) -> Result<(&'static str, T)> {
        let Some((name, cell)) = self.cells.next() else {
            return Err(Error::internal("a row has too few columns"));
        };
        match take(cell) {
            Some(value) => Ok((name, value)),
            None => Err(wrong(name, "is null".to_owned())),
        }
    }

    pub(super) fn text(&mut self) -> Result<String> {
        self.next(text).map(|(_, text)| text)
    }

    pub(super) fn optional_text(&mut self) -> Result<Option<String>> {
        self.next(|cell| Some(text(cell))).map(|(_, text)| text)
    }

    pub(super) fn named<T: Copy>(&mut self, known: &[(&str, T)]) -> Result<T> {
        let (column, name) = self.next(text)?;
        let found = known.iter().find(|(known, _)| *known == name);
        found.map(|(_, value)| *value).ok_or_else(|| {
            let known: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
            wrong(
                column,
                format!("is {name:?}; it must be {}", known.join(" or ")),
            )
        })
    }

    pub(super) fn integer(&mut self) -> Result<i64> {
        self.next(integer).map(|(_, integer)| integer)
    }

    pub(super) fn natural<T: TryFrom<i64>>(&mut self) -> Result<T> {
        let (column, value) = self.next(integer)?;
        T::try_from(value).map_err(|_| wrong(column, format!("is {value}; it is out of range")))
    }

    pub(super) fn optional_number(&mut self) -> Result<Option<f64>> {
        self.next(|cell| Some(number(cell)))
            .map(|(_, number)| number)
    }

    pub(super) fn optional_numbers(&mut self) -> Result<Option<Vec<f64>>> {
        let numbers = |cell| match cell {
            Cell::Numbers(numbers) => Some(numbers),
            _ => None,
        };
        self.next(|cell| Some(numbers(cell)))
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

fn integer(cell: Cell<'static>) -> Option<i64> {
    match cell {
        Cell::Integer(integer) => Some(integer),
        _ => None,
    }
}

fn number(cell: Cell<'static>) -> Option<f64> {
    match cell {
        Cell::Number(number) => Some(number),
        _ => None,
    }
}

fn image(cell: Cell<'static>) -> Option<Vec<u8>> {
    match cell {
        Cell::Image(bytes) => Some(Cow::into_owned(bytes)),
        _ => None,
    }
}
