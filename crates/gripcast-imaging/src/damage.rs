//! Errors of decoding a frame.

use std::fmt;

use super::frame::{MAX_SIDE, PixelFormat};
use super::jpeg::JpegDamage;
use gripcast_base::error::Error;

/// Error of decoding a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FrameDamage {
    /// The JPEG of an MJPG frame is damaged.
    Jpeg(JpegDamage),
    /// A raw frame has the wrong number of bytes.
    ByteCount {
        /// Pixel format of the frame.
        format: PixelFormat,
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// Expected number of bytes.
        expected: usize,
        /// Actual number of bytes.
        found: usize,
    },
    /// The JPEG has a different size than the frame.
    ImageSize {
        /// Width and height of the frame.
        expected: (u32, u32),
        /// Width and height of the JPEG.
        found: (u32, u32),
    },
    /// The size is invalid for the format.
    FrameSize {
        /// Pixel format of the frame.
        format: PixelFormat,
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// Requirement on the size.
        expected: &'static str,
    },
    /// The crop window is empty.
    NothingLeft {
        /// Crop profile.
        crop: &'static str,
        /// Width of the image in pixels.
        width: u32,
        /// Height of the image in pixels.
        height: u32,
    },
    /// The requested size is invalid.
    TargetSize {
        /// Requested width.
        width: u32,
        /// Requested height.
        height: u32,
    },
    /// The frame has no depth.
    NoDepth {
        /// Pixel format of the frame.
        format: PixelFormat,
    },
}

impl fmt::Display for FrameDamage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Jpeg(damage) => damage.fmt(f),
            Self::ByteCount {
                format,
                width,
                height,
                expected,
                found,
            } => write!(
                f,
                "a {width}×{height} {format} frame has {expected} bytes, found {found}"
            ),
            Self::ImageSize { expected, found } => write!(
                f,
                "expected a JPEG of {}×{} as configured, found {}×{}",
                expected.0, expected.1, found.0, found.1
            ),
            Self::FrameSize {
                format,
                width,
                height,
                expected,
            } => write!(
                f,
                "invalid size {width}×{height} of a {format} frame: expected {expected}"
            ),
            Self::NothingLeft {
                crop,
                width,
                height,
            } => write!(
                f,
                "crop profile `{crop}` has no window in a {width}×{height} image"
            ),
            Self::TargetSize { width, height } => write!(
                f,
                "invalid image size {width}×{height}: expected 1 to {MAX_SIDE} pixels a side"
            ),
            Self::NoDepth { format } => {
                write!(f, "expected a Z16 depth frame, found a {format} frame")
            }
        }
    }
}

impl std::error::Error for FrameDamage {}

impl From<JpegDamage> for FrameDamage {
    fn from(damage: JpegDamage) -> Self {
        Self::Jpeg(damage)
    }
}

impl From<FrameDamage> for Error {
    fn from(damage: FrameDamage) -> Self {
        Self::input(damage.to_string())
    }
}

impl From<JpegDamage> for Error {
    fn from(damage: JpegDamage) -> Self {
        Self::input(damage.to_string())
    }
}
