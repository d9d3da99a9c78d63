//! A file that remembers what was read of it, for the one kind of attribute that the library has no
//! value for: PyTables writes a boolean as a bit field of one byte.
//!
//! Needed until `hdf5-pure` reads bit fields; it then has these attributes like all others.

use std::fs;
use std::io;
use std::os::unix::fs::FileExt as _;
use std::sync::{Arc, Mutex, PoisonError};

use hdf5_pure::{FormatError, Source};

/// Longest read that is remembered, bytes: a message of a header has less than 64 KiB.
const MAX: usize = 1 << 20;
/// Class of a bit field in the low half of a datatype's first byte.
const BIT_FIELD: u8 = 4;

/// The file.
pub(super) struct WatchedFile {
    file: fs::File,
    size: u64,
    watch: Watch,
}

/// What was read while somebody watched.
#[derive(Clone, Default)]
pub(super) struct Watch(Arc<Mutex<Option<Vec<Vec<u8>>>>>);

impl WatchedFile {
    /// # Errors
    /// Those of the operating system.
    pub(super) fn new(file: fs::File) -> io::Result<(Self, Watch)> {
        let size = file.metadata()?.len();
        let watch = Watch::default();
        let watched = Self {
            file,
            size,
            watch: watch.clone(),
        };
        Ok((watched, watch))
    }
}

impl Source for WatchedFile {
    fn len(&self) -> u64 {
        self.size
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<(), FormatError> {
        match self.file.read_exact_at(buf, offset) {
            Ok(()) => {}
            // A damaged file names places behind its end.
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
                return Err(FormatError::UnexpectedEof {
                    expected: buf.len(),
                    available: self.size.saturating_sub(offset) as usize,
                });
            }
            Err(error) => return Err(FormatError::Source(error.to_string())),
        }
        let mut seen = self.watch.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(seen) = seen.as_mut()
            && buf.len() <= MAX
        {
            seen.push(buf.to_vec());
        }
        Ok(())
    }
}

impl Watch {
    /// All that is read of the file during `work`.
    pub(super) fn during(&self, work: impl FnOnce()) -> Vec<Vec<u8>> {
        let swap = |new| {
            let mut seen = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            std::mem::replace(&mut *seen, new)
        };
        swap(Some(Vec::new()));
        work();
        swap(None).unwrap_or_default()
    }
}

/// The value of an attribute that is a bit field of one byte, from the message that holds it; none
/// where there is no such message, or several that disagree.
pub(super) fn bit_field(reads: &[Vec<u8>], name: &str) -> Option<u8> {
    let mut found = None;
    for bytes in reads {
        for at in 0..bytes.len() {
            let Some(value) = value_at(&bytes[at..], name) else {
                continue;
            };
            if found.is_some_and(|found| found != value) {
                return None;
            }
            found = Some(value);
        }
    }
    found
}

/// The value, if an attribute message of that name begins here (HDF5 file format specification,
/// IV.A.2.m).
fn value_at(bytes: &[u8], name: &str) -> Option<u8> {
    let version = *bytes.first()?;
    let begin = match version {
        1 | 2 => 8,
        3 => 9,
        _ => return None,
    };
    let size = |at: usize| {
        Some(usize::from(u16::from_le_bytes([
            *bytes.get(at)?,
            *bytes.get(at + 1)?,
        ])))
    };
    let [name_size, type_size, space_size] = [size(2)?, size(4)?, size(6)?];
    let is_named = name_size == name.len() + 1
        && bytes.get(begin..begin + name.len())? == name.as_bytes()
        && *bytes.get(begin + name.len())? == 0;
    if !is_named || bytes[1] != 0 {
        return None;
    }
    let padded = |size: usize| match version {
        1 => size.next_multiple_of(8),
        _ => size,
    };
    let type_at = begin + padded(name_size);
    let datatype = bytes.get(type_at..type_at + type_size)?;
    let is_byte = datatype.first()? & 0x0f == BIT_FIELD && datatype.get(4..8)? == [1, 0, 0, 0];
    let space_at = type_at + padded(type_size);
    let space = bytes.get(space_at..space_at + space_size)?;
    // A scalar, or one axis of length one.
    let lengths = match space.first()? {
        1 => 8,
        _ => 4,
    };
    let is_one = match space.get(1)? {
        0 => true,
        1 => space.get(lengths..lengths + 8)? == [1, 0, 0, 0, 0, 0, 0, 0],
        _ => false,
    };
    let value = bytes.get(space_at + padded(space_size))?;
    (is_byte && is_one).then_some(*value)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAME: &str = "is_gripping";

    /// Messages of version 1 and 3 as libhdf5 writes them.
    fn message(version: u8, value: u8) -> Vec<u8> {
        let datatype = [0x14, 0, 0, 0, 1, 0, 0, 0, 0, 0, 8, 0];
        let mut bytes = vec![version, 0, 12, 0, 12, 0];
        match version {
            1 => {
                bytes.extend([8, 0]);
                bytes.extend(b"is_gripping\0\0\0\0\0");
                bytes.extend(datatype);
                bytes.extend([0; 4]);
                bytes.extend([1, 0, 0, 0, 0, 0, 0, 0]);
            }
            _ => {
                bytes.extend([4, 0, 0]);
                bytes.extend(b"is_gripping\0");
                bytes.extend(datatype);
                bytes.extend([2, 0, 0, 0]);
            }
        }
        bytes.push(value);
        bytes
    }

    #[test]
    fn the_value_is_found_in_both_forms_of_the_message() {
        for version in [1, 3] {
            for value in [0, 1] {
                let mut read = vec![7; 5];
                read.extend(message(version, value));
                let whole = [read.clone()];
                assert_eq!(bit_field(&whole, NAME), Some(value));
                assert_eq!(bit_field(&whole, "is_grippin"), None);
                read.pop();
                assert_eq!(bit_field(&[read], NAME), None);
            }
        }
        let both = |a, b| bit_field(&[message(1, a), message(3, b)], NAME);
        assert_eq!(both(1, 1), Some(1));
        assert_eq!(both(1, 0), None);
        let mut wide = message(3, 1);
        wide[9 + 12 + 4] = 2;
        assert_eq!(bit_field(&[wide], NAME), None);
    }
}
