//! Damage of a JPEG.

use std::fmt;

/// Damage of a JPEG.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum JpegDamage {
    /// The start-of-image marker is missing.
    NotJpeg {
        /// The first bytes, at most four.
        found: Vec<u8>,
    },
    /// The image is incomplete.
    Truncated {
        /// Length of the input in bytes.
        length: usize,
        /// What is missing.
        expected: &'static str,
    },
    /// The marker structure is invalid.
    Malformed(String),
    /// The entropy-coded data is invalid.
    CorruptEntropy(String),
    /// An unsupported kind of JPEG.
    Unsupported(String),
}

impl fmt::Display for JpegDamage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotJpeg { found } if found.is_empty() => {
                f.write_str("expected a JPEG (FF D8 …), found no bytes")
            }
            Self::NotJpeg { found } => {
                f.write_str("expected a JPEG (FF D8 …), found")?;
                found.iter().try_for_each(|byte| write!(f, " {byte:02X}"))
            }
            Self::Truncated { length, expected } => write!(
                f,
                "the JPEG is truncated: expected {expected}, found the end after {length} bytes"
            ),
            Self::Malformed(what) => write!(f, "the JPEG is malformed: {what}"),
            Self::CorruptEntropy(what) => {
                write!(f, "the JPEG's compressed data is corrupt: {what}")
            }
            Self::Unsupported(what) => write!(f, "unsupported JPEG: {what}"),
        }
    }
}

impl std::error::Error for JpegDamage {}
