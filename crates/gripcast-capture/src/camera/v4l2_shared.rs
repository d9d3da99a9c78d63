//! Shared memory of driver buffers.

#![allow(unsafe_code)]

use std::marker::PhantomData;
use std::ops::Range;
use std::ptr::NonNull;

/// Bytes of a driver buffer. They may change at any time (a writer of a loopback device has the
/// same memory mapped), so they are only copied, never borrowed as a slice.
#[derive(Clone, Copy, Debug)]
pub struct SharedBytes<'a> {
    start: NonNull<u8>,
    length: usize,
    mapping: PhantomData<&'a ()>,
}

impl<'a> SharedBytes<'a> {
    /// Bytes of a mapping.
    ///
    /// # Safety
    /// `length` bytes from `start` on must be readable throughout `'a`.
    pub unsafe fn new(start: NonNull<u8>, length: usize) -> Self {
        Self {
            start,
            length,
            mapping: PhantomData,
        }
    }

    /// The first `length` bytes.
    #[must_use]
    pub fn first(self, length: usize) -> Option<Self> {
        (length <= self.length).then_some(Self { length, ..self })
    }

    /// Number of bytes.
    pub fn len(self) -> usize {
        self.length
    }

    /// Whether there are no bytes.
    pub fn is_empty(self) -> bool {
        self.length == 0
    }

    /// Appends a copy of `range` to `to`. False without a change if the range is invalid.
    #[must_use]
    pub fn append(self, range: Range<usize>, to: &mut Vec<u8>) -> bool {
        let Some(count) = range
            .end
            .checked_sub(range.start)
            .filter(|_| range.end <= self.length)
        else {
            return false;
        };
        to.reserve(count);
        let filled = to.len();
        // SAFETY: the range is within the bytes that `new` was promised, the vector has room for
        // `count` more, and a fresh reservation of ours overlaps no mapping of a driver. Bytes that
        // change meanwhile are copied in some state, and every state is a valid `u8`.
        unsafe {
            self.start
                .as_ptr()
                .add(range.start)
                .copy_to_nonoverlapping(to.as_mut_ptr().add(filled), count);
            to.set_len(filled + count);
        }
        true
    }
}

impl<'a> From<&'a [u8]> for SharedBytes<'a> {
    fn from(bytes: &'a [u8]) -> Self {
        // SAFETY: the borrow keeps the bytes readable throughout `'a`.
        unsafe { Self::new(NonNull::from(bytes).cast(), bytes.len()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::io::Write as _;
    use std::os::fd::AsRawFd as _;
    use std::os::unix::fs::FileExt as _;
    use std::ptr;

    #[test]
    fn ranges_are_appended_and_checked() {
        let bytes = SharedBytes::from(&[1, 2, 3, 4][..]);
        let mut to = vec![9];
        assert!(bytes.append(1..3, &mut to));
        assert!(bytes.append(4..4, &mut to));
        assert_eq!(to, [9, 2, 3]);
        let backwards = Range { start: 3, end: 2 };
        for wrong in [3..5, 5..5, 0..usize::MAX, backwards] {
            assert!(!bytes.append(wrong.clone(), &mut to), "{wrong:?}");
        }
        assert_eq!(to, [9, 2, 3], "invalid ranges append nothing");
        let first = bytes.first(2).unwrap();
        assert_eq!(first.len(), 2);
        assert!(!first.append(0..3, &mut to));
        assert!(bytes.first(5).is_none());
    }

    #[test]
    fn copies_are_independent_of_later_writes() {
        let mut file: File = tempfile::tempfile().unwrap();
        file.write_all(b"first").unwrap();
        // SAFETY: a fresh shared mapping of five bytes of the file, unmapped below.
        let start = unsafe {
            libc::mmap(
                ptr::null_mut(),
                5,
                libc::PROT_READ,
                libc::MAP_SHARED,
                file.as_raw_fd(),
                0,
            )
        };
        assert_ne!(start, libc::MAP_FAILED);
        // SAFETY: the mapping is readable until it is unmapped at the end of this test.
        let bytes = unsafe { SharedBytes::new(NonNull::new(start.cast()).unwrap(), 5) };
        let (mut before, mut after) = (Vec::new(), Vec::new());
        assert!(bytes.append(0..5, &mut before));
        file.write_all_at(b"other", 0).unwrap();
        assert!(bytes.append(0..5, &mut after));
        assert_eq!((&*before, &*after), (&b"first"[..], &b"other"[..]));
        // SAFETY: start and length are those of the mapping, and `bytes` is not used again.
        unsafe { libc::munmap(start, 5) };
    }
}
