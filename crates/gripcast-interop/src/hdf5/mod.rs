//! HDF5 files of others: datasets and attributes with the shape that is expected of them.
//!
//! A file is never read whole: headers as they are asked for, a dataset when it is read, and only
//! if it is no larger than the caller allows.

mod watched;

use std::path::Path;

use hdf5_pure::{
    AttrValue, DType, Dataset, Datatype, Error as Hdf5Error, File, FormatError, Group,
    VlenStringReadOptions,
};

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{FileKind, open_regular};
use watched::{Watch, WatchedFile};

/// Most numbers of one dataset.
const MAX_NUMBERS: u64 = 16 << 20;
/// Longest text, bytes.
const MAX_TEXT: usize = 4096;
/// Filters of chunks that are undone: deflate, shuffle, Fletcher's checksum, scale-offset, LZF.
const KNOWN_FILTERS: [u16; 5] = [1, 2, 3, 6, 32000];
/// Most keys that an error lists.
const MAX_LISTED: usize = 24;

/// A group of an open file; its keys are relative to it.
pub struct Hdf5 {
    group: Group,
    watch: Watch,
    /// Name in the group above.
    name: String,
    /// Whose files these are, for the remedies.
    of: &'static str,
}

/// An array of bytes whose contents are still in the file.
pub struct ByteArray<'a> {
    dataset: Dataset,
    key: &'a str,
    /// Lengths of its axes.
    pub(crate) shape: Vec<u64>,
}

impl Hdf5 {
    /// The root of a file; `of` says whose files are expected.
    ///
    /// # Errors
    /// Those of reading the file; `Input` for what is no HDF5.
    pub fn open(path: &Path, of: &'static str) -> Result<Self> {
        let unread = |e| Error::io("cannot read the file", e);
        let file = open_regular(path, FileKind::Bulk).map_err(unread)?;
        if !hdf5_pure::is_hdf5(path).map_err(unread)? {
            return Err(wrong("this is no HDF5 file".to_owned()).remedy(give(of)));
        }
        let (source, watch) = WatchedFile::new(file).map_err(unread)?;
        let file = File::from_source(source)
            .map_err(|e| failed("the HDF5 file is damaged".to_owned(), e))?;
        Ok(Self {
            group: file.root(),
            watch,
            name: "/".to_owned(),
            of,
        })
    }

    /// Name in the group above; `/` for the root.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// The groups in a group, in no order; none if there is no such group.
    ///
    /// # Errors
    /// `Input` for what is damaged, or no group.
    pub(crate) fn groups(&self, key: &str) -> Result<Option<Vec<Self>>> {
        let group = match self.group.group(key) {
            Ok(group) => group,
            Err(Hdf5Error::Format(FormatError::PathNotFound(_))) => return Ok(None),
            Err(Hdf5Error::NotAGroup(_)) => {
                return Err(wrong(format!("`{key}` must be a group, found a dataset")));
            }
            Err(error) => return Err(failed(format!("cannot read `{key}`"), error)),
        };
        let inner = group
            .iter_groups()
            .map_err(|e| failed(format!("cannot read `{key}`"), e))?;
        let groups = inner.map(|(name, group)| Self {
            group,
            watch: self.watch.clone(),
            name,
            of: self.of,
        });
        Ok(Some(groups.collect()))
    }

    /// Names of all groups, datasets and attributes, sorted; for messages.
    fn keys(&self) -> Vec<String> {
        let group = &self.group;
        let mut keys = [group.groups(), group.datasets()].map(Result::unwrap_or_default);
        let attributes = group.attr_datatypes().unwrap_or_default();
        let mut all: Vec<String> = keys.iter_mut().flat_map(std::mem::take).collect();
        all.extend(attributes.into_keys());
        all.sort();
        all
    }

    /// `Input`: a key that is needed is not there, with those that are.
    pub fn missing(&self, key: &str) -> Error {
        let keys = self.keys();
        let mut listed = keys[..keys.len().min(MAX_LISTED)].join(", ");
        match keys.len() {
            0 => listed.push_str("nothing"),
            count if count > MAX_LISTED => listed.push_str(", …"),
            _ => {}
        }
        wrong(format!("there is no `{key}`; there is {listed}")).remedy(give(self.of))
    }

    /// A dataset; none if the group has no such key.
    fn find(&self, key: &str) -> Result<Option<Dataset>> {
        match self.group.dataset(key) {
            Ok(dataset) => Ok(Some(dataset)),
            Err(Hdf5Error::Format(FormatError::PathNotFound(_))) => Ok(None),
            Err(error) => Err(unreadable(key, error)),
        }
    }

    /// Shape and numbers, row by row; integers and booleans become numbers.
    ///
    /// # Errors
    /// `Input` for what is no array of numbers.
    pub fn numbers(&self, key: &str) -> Result<Option<(Vec<u64>, Vec<f64>)>> {
        let Some(dataset) = self.find(key)? else {
            return Ok(None);
        };
        let shape = dataset.shape().map_err(|e| unreadable(key, e))?;
        check_count(key, &shape, MAX_NUMBERS)?;
        // PyTables' booleans.
        if let Ok(Datatype::BitField { size: 1, .. }) = dataset.datatype() {
            let bytes = dataset.read_raw().map_err(|e| unread(key, &dataset, e))?;
            return Ok(Some((shape, bytes.into_iter().map(f64::from).collect())));
        }
        let values = dataset.read_f64().map_err(|e| unread(key, &dataset, e))?;
        Ok(Some((shape, values)))
    }

    /// One finite number: a scalar, or an array of one.
    ///
    /// # Errors
    /// `Input` for another type or shape.
    pub fn number(&self, key: &str) -> Result<Option<f64>> {
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
    ///
    /// # Errors
    /// `Input` for another type or shape.
    pub fn array<const N: usize>(&self, key: &str) -> Result<Option<[f64; N]>> {
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
                    return Err(misshapen(key, "one text", &shape));
                }
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

    /// An array of bytes of at most `most` elements, also one chunk of it; not read yet.
    ///
    /// # Errors
    /// `Input` for another type, too many, or unknown compression.
    pub fn bytes<'a>(&self, key: &'a str, most: u64) -> Result<Option<ByteArray<'a>>> {
        let Some(dataset) = self.find(key)? else {
            return Ok(None);
        };
        let failed = |e| unreadable(key, e);
        match dataset.dtype().map_err(failed)? {
            DType::U8 => {}
            other => return Err(wrong(format!("`{key}` must be bytes (u8), found {other}"))),
        }
        let shape = dataset.shape().map_err(failed)?;
        check_count(key, &shape, most)?;
        if let Some(chunk) = dataset.chunk_shape().map_err(failed)? {
            check_count(key, &chunk, most)?;
        }
        match unknown_filter(key, &dataset) {
            Some(error) => Err(error),
            None => Ok(Some(ByteArray {
                dataset,
                key,
                shape,
            })),
        }
    }

    /// One finite number of an attribute; a boolean is 0 or 1.
    ///
    /// # Errors
    /// `Input` for what is no number.
    pub(crate) fn attribute_number(&self, key: &str) -> Result<Option<f64>> {
        let Some(attribute) = self.attribute(key)? else {
            return Ok(None);
        };
        let integer = || attribute.as_i64().map(|integer| integer as f64);
        match attribute.as_f64().or_else(integer) {
            Some(value) if value.is_finite() => Ok(Some(value)),
            Some(value) => Err(wrong(format!("`{key}` must be finite, found {value}"))),
            None => Err(wrong(format!(
                "`{key}` must be one number, found {attribute:?}"
            ))),
        }
    }

    /// One text of an attribute.
    ///
    /// # Errors
    /// `Input` for what is no text.
    pub(crate) fn attribute_text(&self, key: &str) -> Result<Option<String>> {
        let Some(attribute) = self.attribute(key)? else {
            return Ok(None);
        };
        match attribute.as_str() {
            Some(text) => Ok(Some(text.trim_end_matches('\0').to_owned())),
            None => Err(wrong(format!(
                "`{key}` must be one text, found {attribute:?}"
            ))),
        }
    }

    fn attribute(&self, key: &str) -> Result<Option<AttrValue>> {
        let failed = |e| unreadable(key, e);
        let mut attributes = self.group.attrs().map_err(failed)?;
        if let Some(value) = attributes.remove(key) {
            return Ok(Some(value));
        }
        // What the library has no value for is still in the list of types.
        let mut types = Ok(None);
        let seen = self.watch.during(|| {
            types = self.group.attr_datatypes().map(|mut all| all.remove(key));
        });
        match types.map_err(failed)? {
            None => Ok(None),
            Some(Datatype::BitField { size: 1, .. }) => match watched::bit_field(&seen, key) {
                Some(value) => Ok(Some(AttrValue::U8(value))),
                None => Err(
                    wrong(format!("`{key}` is a bit field that is not one byte"))
                        .remedy("write the label as an integer"),
                ),
            },
            Some(other) => Err(wrong(format!(
                "`{key}` has a type without a value: {other}"
            ))),
        }
    }
}

impl ByteArray<'_> {
    /// Its contents.
    ///
    /// # Errors
    /// `Input` for damaged or unknown compression.
    pub(crate) fn read(&self) -> Result<Vec<u8>> {
        let read = self.dataset.read_u8();
        read.map_err(|e| unread(self.key, &self.dataset, e))
    }
}

/// An array of another shape than expected.
pub fn misshapen(key: &str, expected: &str, shape: &[u64]) -> Error {
    wrong(format!(
        "`{key}` must be {expected}, found the shape {shape:?}"
    ))
}

/// A file that holds something else than expected.
pub fn wrong(what: String) -> Error {
    Error::input(what)
}

fn give(of: &str) -> String {
    format!("give a .h5 file of {of}")
}

fn check_count(key: &str, shape: &[u64], most: u64) -> Result<()> {
    let count = shape.iter().try_fold(1_u64, |n, d| n.checked_mul(*d));
    match count {
        Some(count) if count <= most => Ok(()),
        _ => Err(wrong(format!(
            "`{key}` has the absurd shape {shape:?}; at most {most} values are read"
        ))),
    }
}

/// What could not be read of a dataset that is there.
fn unread(key: &str, dataset: &Dataset, error: Hdf5Error) -> Error {
    unknown_filter(key, dataset).unwrap_or_else(|| unreadable(key, error))
}

/// `Input`: the compression, where it is not known.
fn unknown_filter(key: &str, dataset: &Dataset) -> Option<Error> {
    let unknown = |id: &u16| !KNOWN_FILTERS.contains(id);
    let filter = dataset.filters().into_iter().find(unknown)?;
    let what = format!("`{key}` is compressed with the filter {filter}, which is not known here");
    Some(wrong(what).remedy(
        "write the file again with zlib: ptrepack --complib=zlib --complevel=1 OLD.h5 NEW.h5",
    ))
}

fn unreadable(key: &str, error: Hdf5Error) -> Error {
    failed(format!("cannot read `{key}`"), error)
        .remedy("load and save the file with the default settings of h5py")
}

/// `Io` where the operating system could not read, else `Input`.
fn failed(what: String, error: Hdf5Error) -> Error {
    let kind = match error {
        Hdf5Error::Io(_) | Hdf5Error::Format(FormatError::Source(_)) => ErrorKind::Io,
        _ => ErrorKind::Input,
    };
    Error::new(kind, what).because(error)
}
