//! A file that logs its reads, for attributes that the library cannot decode: PyTables writes a
//! boolean as a bit field of one byte.
//!
//! Needed until `hdf5-pure` reads bit fields.

use std::fs;
use std::io;
use std::os::unix::fs::FileExt as _;
use std::sync::{Arc, Mutex, PoisonError};

use hdf5_pure::{FormatError, Source};

/// Maximum size of a logged read, bytes: a header message has less than 64 KiB.
const MAX: usize = 1 << 20;
/// Class of a bit field in the low half of a datatype's first byte.
const BIT_FIELD: u8 = 4;

/// A file with a log of its reads.
pub(super) struct LoggedFile {
    file: fs::File,
    size: u64,
    log: ReadLog,
}

/// Log of reads; `None` while logging is off.
#[derive(Clone, Default)]
pub(super) struct ReadLog(Arc<Mutex<Option<Vec<Vec<u8>>>>>);

impl LoggedFile {
    /// # Errors
    /// Those of the operating system.
    pub(super) fn new(file: fs::File) -> io::Result<(Self, ReadLog)> {
        let size = file.metadata()?.len();
        let log = ReadLog::default();
        let logged = Self {
            file,
            size,
            log: log.clone(),
        };
        Ok((logged, log))
    }
}

impl Source for LoggedFile {
    fn len(&self) -> u64 {
        self.size
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<(), FormatError> {
        match self.file.read_exact_at(buf, offset) {
            Ok(()) => {}
            // A damaged file refers to offsets beyond its end.
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
                return Err(FormatError::UnexpectedEof {
                    expected: buf.len(),
                    available: self.size.saturating_sub(offset) as usize,
                });
            }
            Err(error) => return Err(FormatError::Source(error.to_string())),
        }
        let mut reads = self.log.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(reads) = reads.as_mut()
            && buf.len() <= MAX
        {
            reads.push(buf.to_vec());
        }
        Ok(())
    }
}

impl ReadLog {
    /// Returns all reads of the file during `work`.
    pub(super) fn during(&self, work: impl FnOnce()) -> Vec<Vec<u8>> {
        let swap = |new| {
            let mut reads = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            std::mem::replace(&mut *reads, new)
        };
        swap(Some(Vec::new()));
        work();
        swap(None).unwrap_or_default()
    }
}

/// Value of an attribute that is a bit field of one byte, from the logged attribute message; none
/// without such a message, or if several disagree.
pub(super) fn bit_field(reads: &[Vec<u8>], name: &str) -> Option<u8> {
    let mut found = None;
    for bytes in reads {
        for offset in 0..bytes.len() {
            let Some(value) = attribute_value(&bytes[offset..], name) else {
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

/// Value of an attribute message of that name at the start of `bytes` (HDF5 file format
/// specification, IV.A.2.m).
fn attribute_value(bytes: &[u8], name: &str) -> Option<u8> {
    let version = *bytes.first()?;
    let begin = match version {
        1 | 2 => 8,
        3 => 9,
        _ => return None,
    };
    let size = |offset: usize| {
        Some(usize::from(u16::from_le_bytes([
            *bytes.get(offset)?,
            *bytes.get(offset + 1)?,
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
    let type_offset = begin + padded(name_size);
    let datatype = bytes.get(type_offset..type_offset + type_size)?;
    let is_byte = datatype.first()? & 0x0f == BIT_FIELD && datatype.get(4..8)? == [1, 0, 0, 0];
    let space_offset = type_offset + padded(type_size);
    let space = bytes.get(space_offset..space_offset + space_size)?;
    // A scalar, or one axis of length 1.
    let lengths = match space.first()? {
        1 => 8,
        _ => 4,
    };
    let is_one = match space.get(1)? {
        0 => true,
        1 => space.get(lengths..lengths + 8)? == [1, 0, 0, 0, 0, 0, 0, 0],
        _ => false,
    };
    let value = bytes.get(space_offset + padded(space_size))?;
    (is_byte && is_one).then_some(*value)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAME: &str = "is_gripping";

    /// Messages of versions 1 and 3 as written by libhdf5.
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
    fn value_is_found_in_both_message_versions() {
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
