//! Datasets of an HDF5 file with the shape that is expected of them.

use std::fs;
use std::path::Path;

use hdf5_pure::{DType, Dataset, Error as Hdf5Error, File, FormatError, VlenStringReadOptions};

use crate::error::{Error, ErrorKind, Result};

/// Largest file that is read, bytes; those of ACRONYM have half a megabyte.
const LARGEST_FILE: u64 = 256 << 20;
/// Most numbers of one dataset.
const MOST_NUMBERS: u64 = 16 << 20;
/// Longest text, bytes.
const LONGEST_TEXT: usize = 4096;

/// An open file.
pub(super) struct Hdf5(File);

impl Hdf5 {
    /// # Errors
    /// Those of reading the file; `Input` for what is no HDF5.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let size = fs::metadata(path)
            .map_err(|e| Error::io("cannot read the grasps", e))?
            .len();
        if size > LARGEST_FILE {
            return Err(wrong(format!(
                "the file has {size} bytes; those of ACRONYM have less than {LARGEST_FILE}"
            )));
        }
        let bytes = fs::read(path).map_err(|e| Error::io("cannot read the grasps", e))?;
        if !hdf5_pure::is_hdf5_bytes(&bytes) {
            return Err(wrong("this is no HDF5 file".to_owned())
                .remedy("give a .h5 file of ACRONYM; a .json of older releases is not read"));
        }
        let file = File::from_bytes(bytes)
            .map_err(|e| wrong("the HDF5 file is damaged".to_owned()).because(e))?;
        Ok(Self(file))
    }

    /// A dataset; none if the file has no such key.
    fn find(&self, key: &str) -> Result<Option<Dataset>> {
        match self.0.dataset(key) {
            Ok(dataset) => Ok(Some(dataset)),
            Err(Hdf5Error::Format(FormatError::PathNotFound(_))) => Ok(None),
            Err(error) => Err(unreadable(key, error)),
        }
    }

    /// Shape and numbers, row by row; integers and booleans become numbers.
    ///
    /// # Errors
    /// `Input` for what is no array of numbers.
    pub(super) fn numbers(&self, key: &str) -> Result<Option<(Vec<u64>, Vec<f64>)>> {
        let Some(dataset) = self.find(key)? else {
            return Ok(None);
        };
        let shape = dataset.shape().map_err(|e| unreadable(key, e))?;
        let count = shape.iter().try_fold(1_u64, |n, d| n.checked_mul(*d));
        if count.is_none_or(|n| n > MOST_NUMBERS) {
            return Err(wrong(format!("`{key}` has the absurd shape {shape:?}")));
        }
        let values = dataset.read_f64().map_err(|e| unreadable(key, e))?;
        Ok(Some((shape, values)))
    }

    /// One finite number: a scalar, or an array of one.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>> {
        let Some((shape, values)) = self.numbers(key)? else {
            return Ok(None);
        };
        match values.as_slice() {
            [value] if value.is_finite() => Ok(Some(*value)),
            [value] => Err(wrong(format!("`{key}` must be finite, found {value}"))),
            _ => Err(misshapen(key, "one number", &shape)),
        }
    }

    /// As many finite numbers as the array has, whatever their shape.
    pub(super) fn array<const N: usize>(&self, key: &str) -> Result<Option<[f64; N]>> {
        let Some((shape, values)) = self.numbers(key)? else {
            return Ok(None);
        };
        let array: [f64; N] = match values.try_into() {
            Ok(array) => array,
            Err(_) => return Err(misshapen(key, &format!("{N} numbers"), &shape)),
        };
        match array.iter().find(|v| !v.is_finite()) {
            None => Ok(Some(array)),
            Some(value) => Err(wrong(format!("`{key}` must be finite, found {value}"))),
        }
    }

    /// One text, of fixed or variable length.
    pub(super) fn text(&self, key: &str) -> Result<Option<String>> {
        let Some(dataset) = self.find(key)? else {
            return Ok(None);
        };
        let failed = |e| unreadable(key, e);
        let texts = match dataset.dtype().map_err(failed)? {
            DType::VariableLengthString => {
                let limits = VlenStringReadOptions::new()
                    .with_max_elements(1)
                    .with_max_payload_bytes(LONGEST_TEXT);
                dataset.read_vlen_strings(limits).map_err(failed)?
            }
            DType::String if dataset.element_size().map_err(failed)? <= LONGEST_TEXT as u64 => {
                dataset.read_string().map_err(failed)?
            }
            other => return Err(wrong(format!("`{key}` must be a text, found {other}"))),
        };
        match texts.as_slice() {
            [text] => Ok(Some(text.trim_end_matches('\0').to_owned())),
            _ => Err(wrong(format!(
                "`{key}` must be one text, found {}",
                texts.len()
            ))),
        }
    }
}

/// `Input`: a key that is needed is not there.
pub(super) fn missing(key: &str) -> Error {
    wrong(format!("there is no `{key}`")).remedy("give a .h5 file of ACRONYM")
}

pub(super) fn misshapen(key: &str, expected: &str, shape: &[u64]) -> Error {
    wrong(format!(
        "`{key}` must be {expected}, found the shape {shape:?}"
    ))
}

pub(super) fn wrong(what: String) -> Error {
    Error::new(ErrorKind::Input, what)
}

fn unreadable(key: &str, error: Hdf5Error) -> Error {
    wrong(format!("cannot read `{key}`"))
        .because(error)
        .remedy("load and save the file with the default settings of h5py")
}
