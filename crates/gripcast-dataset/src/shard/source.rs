//! Source of a shard's bytes.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt as _;

use bytes::Bytes;

/// A file or a block of memory with random access for any number of readers.
#[derive(Debug)]
pub(super) enum Source {
    File { file: File, size: u64 },
    Memory(Bytes),
}

impl Source {
    /// # Errors
    /// Those of the operating system.
    pub(super) fn file(file: File) -> io::Result<Self> {
        let size = file.metadata()?.len();
        Ok(Self::File { file, size })
    }

    /// Total size in bytes.
    pub(super) fn size(&self) -> u64 {
        match self {
            Self::File { size, .. } => *size,
            Self::Memory(bytes) => bytes.len() as u64,
        }
    }

    /// Reads `length` bytes at `offset`.
    ///
    /// # Errors
    /// `UnexpectedEof`: the range is outside the file; those of the operating system.
    pub(super) fn read(&self, offset: u64, length: u64) -> io::Result<Bytes> {
        let end = offset.checked_add(length).filter(|&end| end <= self.size());
        let Some(end) = end else {
            return Err(io::ErrorKind::UnexpectedEof.into());
        };
        match self {
            Self::File { file, .. } => {
                let mut bytes = vec![0; (end - offset) as usize];
                file.read_exact_at(&mut bytes, offset)?;
                Ok(bytes.into())
            }
            Self::Memory(bytes) => Ok(bytes.slice(offset as usize..end as usize)),
        }
    }
}
