//! Why a frame gives no image.

use std::fmt;

use super::frame::{MAX_SIDE, PixelFormat};
use super::jpeg::JpegDamage;
use gripcast_base::error::{Error, ErrorKind};

/// Why a frame gives no image. The message says what was expected and what was found.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FrameDamage {
    /// The JPEG of an MJPG frame is damaged.
    Jpeg(JpegDamage),
    /// A raw frame has the wrong number of bytes.
    ByteCount {
        /// Layout of the frame.
        format: PixelFormat,
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// Bytes that such a frame has.
        expected: usize,
        /// Bytes that it had.
        found: usize,
    },
    /// The JPEG is sound, but of another size than the camera was set to.
    ImageSize {
        /// Width and height that the frame announces.
        expected: (u32, u32),
        /// Width and height inside the JPEG.
        found: (u32, u32),
    },
    /// The frame's own size is impossible for its format.
    FrameSize {
        /// Layout of the frame.
        format: PixelFormat,
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// What such a frame must satisfy.
        expected: &'static str,
    },
    /// Nothing is left of the image after the crop.
    NothingLeft {
        /// Crop profile.
        crop: &'static str,
        /// Width in pixels before the crop.
        width: u32,
        /// Height in pixels before the crop.
        height: u32,
    },
    /// The size that was asked for cannot be produced.
    TargetSize {
        /// Width that was asked for.
        width: u32,
        /// Height that was asked for.
        height: u32,
    },
    /// Depth was asked of a frame that has none.
    NoDepth {
        /// Layout of the frame.
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
                "expected a {}×{} image as the camera was set, found {}×{} in the JPEG",
                expected.0, expected.1, found.0, found.1
            ),
            Self::FrameSize {
                format,
                width,
                height,
                expected,
            } => write!(
                f,
                "a {format} frame of {width}×{height} pixels is impossible: expected {expected}"
            ),
            Self::NothingLeft {
                crop,
                width,
                height,
            } => write!(
                f,
                "crop profile `{crop}` leaves nothing of a {width}×{height} image"
            ),
            Self::TargetSize { width, height } => write!(
                f,
                "cannot make an image of {width}×{height} pixels: expected 1 to {MAX_SIDE} a side"
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
        Self::new(ErrorKind::Input, damage.to_string())
    }
}

impl From<JpegDamage> for Error {
    fn from(damage: JpegDamage) -> Self {
        Self::new(ErrorKind::Input, damage.to_string())
    }
}
