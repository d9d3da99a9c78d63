//! What can be wrong with a JPEG.

use std::fmt;

/// Why a JPEG gives no image. The message says what was expected and what was found.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum JpegDamage {
    /// The bytes do not start with the start-of-image marker.
    NotJpeg {
        /// The first bytes, at most four.
        found: Vec<u8>,
    },
    /// The bytes end before the image does.
    Truncated {
        /// Length of the whole input in bytes.
        length: usize,
        /// What should have followed.
        expected: &'static str,
    },
    /// The marker structure contradicts itself.
    Malformed(String),
    /// The marker structure is sound, but the compressed data does not decode to exactly one
    /// image of the stated size.
    CorruptEntropy(String),
    /// A sound JPEG of a kind that gripcast does not read.
    Unsupported(String),
}

impl fmt::Display for JpegDamage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotJpeg { found } if found.is_empty() => {
                f.write_str("expected a JPEG (FF D8 …), found no bytes at all")
            }
            Self::NotJpeg { found } => {
                f.write_str("expected a JPEG (FF D8 …), found")?;
                found.iter().try_for_each(|byte| write!(f, " {byte:02X}"))
            }
            Self::Truncated { length, expected } => write!(
                f,
                "the JPEG is cut off: expected {expected}, found the end after {length} bytes"
            ),
            Self::Malformed(what) => write!(f, "the JPEG is malformed: {what}"),
            Self::CorruptEntropy(what) => {
                write!(f, "the JPEG's compressed data is corrupt: {what}")
            }
            Self::Unsupported(what) => write!(f, "this kind of JPEG is not supported: {what}"),
        }
    }
}

impl std::error::Error for JpegDamage {}
