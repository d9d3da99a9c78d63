//! Reads third-party HDF5 files: datasets and attributes with checked type and shape.
//!
//! Headers and datasets are read on demand, with a size limit for each dataset.

mod read_log;

use std::io::Read as _;
use std::path::Path;

use hdf5_pure::{
    AttrValue, DType, Dataset, Datatype, Error as Hdf5Error, File, FormatError, Group,
    VlenStringReadOptions,
};

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{FileKind, file_type, open_regular};
use read_log::{LoggedFile, ReadLog};

/// Maximum number of values of a dataset.
const MAX_NUMBERS: u64 = 16 << 20;
/// Maximum length of a string, bytes.
const MAX_TEXT: usize = 4096;
/// Supported filters: deflate, shuffle, Fletcher-32, scale-offset, LZF.
const SUPPORTED_FILTERS: [u16; 5] = [1, 2, 3, 6, 32000];
/// Maximum number of keys in an error text.
const MAX_LISTED: usize = 24;
/// Bytes that tell another type of file.
const START: u64 = 4096;

/// A group of an open file; its keys are relative to it.
pub struct Hdf5 {
    group: Group,
    log: ReadLog,
    /// Name in the parent group.
    name: String,
    /// Description of the expected files, for remedies.
    expected: &'static str,
}

/// An array of bytes that is read on demand.
pub struct ByteArray<'a> {
    dataset: Dataset,
    key: &'a str,
    /// Lengths of the axes.
    pub(crate) shape: Vec<u64>,
}

impl Hdf5 {
    /// Opens a file; `expected` describes the expected files.
    ///
    /// # Errors
    /// Those of reading the file; `Input` if it is not an HDF5 file.
    pub fn open(path: &Path, expected: &'static str) -> Result<Self> {
        let unread = |e| Error::io("cannot read the file", e);
        let file = open_regular(path, FileKind::Bulk).map_err(unread)?;
        if !hdf5_pure::is_hdf5(path).map_err(unread)? {
            let mut start = Vec::new();
            (&file)
                .take(START)
                .read_to_end(&mut start)
                .map_err(unread)?;
            let found = file_type(&start).unwrap_or("another type of file");
            let what = format!("not an HDF5 file, but {found}");
            return Err(Error::input(what).remedy(give(expected)));
        }
        let (source, log) = LoggedFile::new(file).map_err(unread)?;
        let file = File::from_source(source)
            .map_err(|e| failed("the HDF5 file is damaged".to_owned(), e))?;
        Ok(Self {
            group: file.root(),
            log,
            name: "/".to_owned(),
            expected,
        })
    }

    /// Name in the parent group; `/` for the root.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// Lists the groups in a group, unordered; none if there is no such group.
    ///
    /// # Errors
    /// `Input` if it is damaged or not a group.
    pub(crate) fn groups(&self, key: &str) -> Result<Option<Vec<Self>>> {
        let group = match self.group.group(key) {
            Ok(group) => group,
            Err(Hdf5Error::Format(FormatError::PathNotFound(_))) => return Ok(None),
            Err(Hdf5Error::NotAGroup(_)) => {
                return Err(Error::input(format!(
                    "expected a group `{key}`, found a dataset"
                )));
            }
            Err(error) => return Err(failed(format!("cannot read `{key}`"), error)),
        };
        let inner = group
            .iter_groups()
            .map_err(|e| failed(format!("cannot read `{key}`"), e))?;
        let groups = inner.map(|(name, group)| Self {
            group,
            log: self.log.clone(),
            name,
            expected: self.expected,
        });
        Ok(Some(groups.collect()))
    }

    /// Sorted names of all groups, datasets and attributes, for messages.
    fn keys(&self) -> Vec<String> {
        let group = &self.group;
        let mut keys = [group.groups(), group.datasets()].map(Result::unwrap_or_default);
        let attributes = group.attr_datatypes().unwrap_or_default();
        let mut all: Vec<String> = keys.iter_mut().flat_map(std::mem::take).collect();
        all.extend(attributes.into_keys());
        all.sort();
        all
    }

    /// `Input` error for a missing key; lists the existing ones.
    pub fn missing(&self, key: &str) -> Error {
        let keys = self.keys();
        let mut listed = keys[..keys.len().min(MAX_LISTED)].join(", ");
        match keys.len() {
            0 => listed.push_str("nothing"),
            count if count > MAX_LISTED => listed.push_str(", …"),
            _ => {}
        }
        Error::input(format!("`{key}` not found; the file has {listed}"))
            .remedy(give(self.expected))
    }

    /// Opens a dataset; none if there is no such key.
    fn find(&self, key: &str) -> Result<Option<Dataset>> {
        match self.group.dataset(key) {
            Ok(dataset) => Ok(Some(dataset)),
            Err(Hdf5Error::Format(FormatError::PathNotFound(_))) => Ok(None),
            Err(error) => Err(unreadable(key, error)),
        }
    }

    /// Reads shape and values, row-major; integers and booleans are converted.
    ///
    /// # Errors
    /// `Input` if it is not an array of numbers.
    pub fn numbers(&self, key: &str) -> Result<Option<(Vec<u64>, Vec<f64>)>> {
        let Some(dataset) = self.find(key)? else {
            return Ok(None);
        };
        let shape = dataset.shape().map_err(|e| unreadable(key, e))?;
        check_count(key, &shape, MAX_NUMBERS)?;
        // Booleans of PyTables.
        if let Ok(Datatype::BitField { size: 1, .. }) = dataset.datatype() {
            let bytes = dataset.read_raw().map_err(|e| unread(key, &dataset, e))?;
            return Ok(Some((shape, bytes.into_iter().map(f64::from).collect())));
        }
        let values = dataset.read_f64().map_err(|e| unread(key, &dataset, e))?;
        Ok(Some((shape, values)))
    }

    /// Reads one finite number: a scalar, or an array of length 1.
    ///
    /// # Errors
    /// `Input` for another type or shape.
    pub fn number(&self, key: &str) -> Result<Option<f64>> {
        let Some((shape, values)) = self.numbers(key)? else {
            return Ok(None);
        };
        match values.as_slice() {
            [value] if value.is_finite() => Ok(Some(*value)),
            [value] => Err(Error::input(format!(
                "expected a finite number in `{key}`, found {value}"
            ))),
            _ => Err(wrong_shape(key, "one number", &shape)),
        }
    }

    /// Reads `N` finite numbers of any shape.
    ///
    /// # Errors
    /// `Input` for another type or shape.
    pub fn array<const N: usize>(&self, key: &str) -> Result<Option<[f64; N]>> {
        let Some((shape, values)) = self.numbers(key)? else {
            return Ok(None);
        };
        let array: [f64; N] = match values.try_into() {
            Ok(array) => array,
            Err(_) => return Err(wrong_shape(key, &format!("{N} numbers"), &shape)),
        };
        match array.iter().find(|v| !v.is_finite()) {
            None => Ok(Some(array)),
            Some(value) => Err(Error::input(format!(
                "expected a finite number in `{key}`, found {value}"
            ))),
        }
    }

    /// Reads one string of fixed or variable length.
    ///
    /// # Errors
    /// `Input` for another type or shape.
    pub fn text(&self, key: &str) -> Result<Option<String>> {
        let Some(dataset) = self.find(key)? else {
            return Ok(None);
        };
        let failed = |e| unread(key, &dataset, e);
        let texts = match dataset.dtype().map_err(failed)? {
            DType::VariableLengthString => {
                let limits = VlenStringReadOptions::new()
                    .with_max_elements(1)
                    .with_max_payload_bytes(MAX_TEXT);
                dataset.read_vlen_strings(limits).map_err(failed)?
            }
            DType::String if dataset.element_size().map_err(failed)? <= MAX_TEXT as u64 => {
                let shape = dataset.shape().map_err(failed)?;
                if shape.iter().any(|length| *length != 1) {
                    return Err(wrong_shape(key, "one string", &shape));
                }
                dataset.read_string().map_err(failed)?
            }
            other => {
                return Err(Error::input(format!(
                    "expected a string in `{key}`, found {other}"
                )));
            }
        };
        match texts.as_slice() {
            [text] => Ok(Some(text.trim_end_matches('\0').to_owned())),
            _ => Err(Error::input(format!(
                "expected one string in `{key}`, found {}",
                texts.len()
            ))),
        }
    }

    /// Opens an array of bytes; it and each of its chunks may have up to `max` elements.
    ///
    /// # Errors
    /// `Input` for another type, too many elements, or an unsupported compression.
    pub fn bytes<'a>(&self, key: &'a str, max: u64) -> Result<Option<ByteArray<'a>>> {
        let Some(dataset) = self.find(key)? else {
            return Ok(None);
        };
        let failed = |e| unreadable(key, e);
        match dataset.dtype().map_err(failed)? {
            DType::U8 => {}
            other => {
                return Err(Error::input(format!(
                    "expected bytes (u8) in `{key}`, found {other}"
                )));
            }
        }
        let shape = dataset.shape().map_err(failed)?;
        check_count(key, &shape, max)?;
        if let Some(chunk) = dataset.chunk_shape().map_err(failed)? {
            check_count(key, &chunk, max)?;
        }
        match unsupported_filter(key, &dataset) {
            Some(error) => Err(error),
            None => Ok(Some(ByteArray {
                dataset,
                key,
                shape,
            })),
        }
    }

    /// Reads an attribute as one finite number; a boolean is 0 or 1.
    ///
    /// # Errors
    /// `Input` if it is not a number.
    pub(crate) fn attribute_number(&self, key: &str) -> Result<Option<f64>> {
        let Some(attribute) = self.attribute(key)? else {
            return Ok(None);
        };
        let integer = || attribute.as_i64().map(|integer| integer as f64);
        match attribute.as_f64().or_else(integer) {
            Some(value) if value.is_finite() => Ok(Some(value)),
            Some(value) => Err(Error::input(format!(
                "expected a finite number in `{key}`, found {value}"
            ))),
            None => Err(Error::input(format!(
                "expected one number in `{key}`, found {attribute:?}"
            ))),
        }
    }

    /// Reads an attribute as one string.
    ///
    /// # Errors
    /// `Input` if it is not a string.
    pub(crate) fn attribute_text(&self, key: &str) -> Result<Option<String>> {
        let Some(attribute) = self.attribute(key)? else {
            return Ok(None);
        };
        match attribute.as_str() {
            Some(text) => Ok(Some(text.trim_end_matches('\0').to_owned())),
            None => Err(Error::input(format!(
                "expected one string in `{key}`, found {attribute:?}"
            ))),
        }
    }

    fn attribute(&self, key: &str) -> Result<Option<AttrValue>> {
        let failed = |e| unreadable(key, e);
        let mut attributes = self.group.attrs().map_err(failed)?;
        if let Some(value) = attributes.remove(key) {
            return Ok(Some(value));
        }
        // Attributes that the library cannot decode are still in the list of types.
        let mut types = Ok(None);
        let reads = self.log.during(|| {
            types = self.group.attr_datatypes().map(|mut all| all.remove(key));
        });
        match types.map_err(failed)? {
            None => Ok(None),
            Some(Datatype::BitField { size: 1, .. }) => match read_log::bit_field(&reads, key) {
                Some(value) => Ok(Some(AttrValue::U8(value))),
                None => Err(Error::input(format!("unsupported bit field in `{key}`"))
                    .remedy("write the label as an integer")),
            },
            Some(other) => Err(Error::input(format!(
                "unsupported type of `{key}`: {other}"
            ))),
        }
    }
}

impl ByteArray<'_> {
    /// Reads the contents.
    ///
    /// # Errors
    /// `Input` if it is damaged or its compression is unsupported.
    pub(crate) fn read(&self) -> Result<Vec<u8>> {
        let read = self.dataset.read_u8();
        read.map_err(|e| unread(self.key, &self.dataset, e))
    }
}

/// `Input` error for an array of the wrong shape.
pub fn wrong_shape(key: &str, expected: &str, shape: &[u64]) -> Error {
    Error::input(format!(
        "expected {expected} in `{key}`, found shape {shape:?}"
    ))
}

fn give(expected: &str) -> String {
    format!("give a .h5 file of {expected}")
}

fn check_count(key: &str, shape: &[u64], max: u64) -> Result<()> {
    let count = shape.iter().try_fold(1_u64, |n, d| n.checked_mul(*d));
    match count {
        Some(count) if count <= max => Ok(()),
        _ => Err(Error::input(format!(
            "`{key}` has shape {shape:?}, at most {max} values are supported"
        ))),
    }
}

/// Error of reading an existing dataset.
fn unread(key: &str, dataset: &Dataset, error: Hdf5Error) -> Error {
    unsupported_filter(key, dataset).unwrap_or_else(|| unreadable(key, error))
}

/// `Input` error for an unsupported compression.
fn unsupported_filter(key: &str, dataset: &Dataset) -> Option<Error> {
    let unknown = |id: &u16| !SUPPORTED_FILTERS.contains(id);
    let filter = dataset.filters().into_iter().find(unknown)?;
    let what = format!("unsupported compression filter {filter} of `{key}`");
    Some(Error::input(what).remedy(
        "write the file again with zlib: ptrepack --complib=zlib --complevel=1 OLD.h5 NEW.h5",
    ))
}

fn unreadable(key: &str, error: Hdf5Error) -> Error {
    failed(format!("cannot read `{key}`"), error)
        .remedy("load and save the file with the default settings of h5py")
}

/// `Io` for errors of the operating system, else `Input`.
fn failed(what: String, error: Hdf5Error) -> Error {
    let kind = match error {
        Hdf5Error::Io(_) | Hdf5Error::Format(FormatError::Source(_)) => ErrorKind::Io,
        _ => ErrorKind::Input,
    };
    Error::new(kind, what).because(error)
}
