//! Raw frames of cameras.

use std::fmt;
use std::ops::Deref;
use std::str::FromStr;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use gripcast_base::error::Error;

/// Maximum side of an image, pixels.
pub const MAX_SIDE: u32 = 16_384;

/// Role of a camera; the key of all data per camera.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Tactile sensor on the left finger (−x of the gripper frame).
    Left,
    /// Tactile sensor on the right finger (+x of the gripper frame).
    Right,
    /// Colour camera between the fingers.
    Rgb,
    /// Depth camera between the fingers.
    Depth,
    /// Colour camera with a view of the whole scene.
    External,
}

impl Role {
    /// All roles, in display order.
    pub const ALL: [Self; 5] = [
        Self::Left,
        Self::Right,
        Self::Rgb,
        Self::Depth,
        Self::External,
    ];

    /// Name of the role.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Rgb => "rgb",
            Self::Depth => "depth",
            Self::External => "external",
        }
    }

    /// Whether it is a tactile sensor.
    #[must_use]
    pub fn is_tactile(self) -> bool {
        matches!(self, Self::Left | Self::Right)
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Role {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        Self::ALL
            .into_iter()
            .find(|role| role.name() == text)
            .ok_or_else(|| {
                Error::usage(format!("unknown camera role `{text}`"))
                    .remedy("use one of left, right, rgb, depth, external")
            })
    }
}

/// Supported pixel formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum PixelFormat {
    /// Motion JPEG: one JPEG per frame, possibly without Huffman tables (UVC).
    Mjpg,
    /// 4:2:2 packed, Y0 U Y1 V, BT.601 limited range.
    Yuyv,
    /// 16-bit little-endian depth.
    Z16,
    /// 8-bit luminance.
    Grey,
    /// 8-bit RGB, packed; the format of stored YUYV frames.
    Rgb,
}

impl PixelFormat {
    /// V4L2 four-character code.
    #[must_use]
    pub fn fourcc(self) -> [u8; 4] {
        match self {
            Self::Mjpg => *b"MJPG",
            Self::Yuyv => *b"YUYV",
            Self::Z16 => *b"Z16 ",
            Self::Grey => *b"GREY",
            Self::Rgb => *b"RGB3",
        }
    }

    /// The supported format of a V4L2 four-character code.
    #[must_use]
    pub fn from_fourcc(code: [u8; 4]) -> Option<Self> {
        [Self::Mjpg, Self::Yuyv, Self::Z16, Self::Grey, Self::Rgb]
            .into_iter()
            .find(|format| format.fourcc() == code)
    }

    /// Size of a frame, bytes; `None` for compressed formats.
    #[must_use]
    pub fn frame_bytes(self, width: u32, height: u32) -> Option<usize> {
        let pixels = width as usize * height as usize;
        match self {
            Self::Mjpg => None,
            Self::Yuyv | Self::Z16 => Some(pixels * 2),
            Self::Grey => Some(pixels),
            Self::Rgb => Some(pixels * 3),
        }
    }
}

impl fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Mjpg => "MJPG",
            Self::Yuyv => "YUYV",
            Self::Z16 => "Z16",
            Self::Grey => "GREY",
            Self::Rgb => "RGB",
        })
    }
}

/// Immutable, shared bytes of a frame.
#[derive(Clone, PartialEq, Eq)]
pub struct FrameBytes(Arc<Vec<u8>>);

impl From<Vec<u8>> for FrameBytes {
    fn from(bytes: Vec<u8>) -> Self {
        Self(Arc::new(bytes))
    }
}

impl Deref for FrameBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0
    }
}

/// Pool of frame buffers, reused once their frames are dropped.
#[derive(Debug, Default)]
pub struct FramePool(Vec<FrameBytes>);

impl FramePool {
    /// Maximum number of pooled buffers.
    const CAPACITY: usize = 12;

    /// Copies `bytes` into a free buffer.
    pub fn copy(&mut self, bytes: &[u8]) -> FrameBytes {
        self.fill(|buffer| buffer.extend_from_slice(bytes))
    }

    /// Fills a free buffer by `write`.
    pub fn fill(&mut self, write: impl FnOnce(&mut Vec<u8>)) -> FrameBytes {
        for held in &mut self.0 {
            if let Some(buffer) = Arc::get_mut(&mut held.0) {
                buffer.clear();
                write(buffer);
                return held.clone();
            }
        }
        let mut buffer = Vec::new();
        write(&mut buffer);
        let bytes = FrameBytes::from(buffer);
        if self.0.len() < Self::CAPACITY {
            self.0.push(bytes.clone());
        }
        bytes
    }
}

impl fmt::Debug for FrameBytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FrameBytes({} bytes)", self.0.len())
    }
}

/// A raw frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Pixel format of `data`.
    pub format: PixelFormat,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Payload; rows of raw formats are packed.
    pub data: FrameBytes,
    /// Driver's frame counter; gaps are lost frames.
    pub sequence: u32,
    /// Driver's capture time, `CLOCK_MONOTONIC`, ns.
    pub driver_time_ns: u64,
    /// Time of reception, `CLOCK_MONOTONIC`, ns.
    pub received_ns: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fourcc_round_trips() {
        for format in [
            PixelFormat::Mjpg,
            PixelFormat::Yuyv,
            PixelFormat::Z16,
            PixelFormat::Grey,
            PixelFormat::Rgb,
        ] {
            assert_eq!(PixelFormat::from_fourcc(format.fourcc()), Some(format));
        }
        assert_eq!(PixelFormat::from_fourcc(*b"H264"), None);
    }

    #[test]
    fn pool_reuses_free_buffers_only() {
        let mut pool = FramePool::default();
        let first = pool.copy(&[1, 2, 3]);
        let address = first.as_ptr();
        let second = pool.copy(&[4]);
        assert_ne!(second.as_ptr(), address);
        assert_eq!(&*first, [1, 2, 3]);
        drop(first);
        let third = pool.fill(|buffer| buffer.extend([5, 6]));
        assert_eq!((third.as_ptr(), &*third), (address, &[5, 6][..]));
        let held: Vec<_> = (0..20).map(|i| pool.copy(&[i])).collect();
        assert_eq!(pool.0.len(), FramePool::CAPACITY);
        assert!(held.iter().zip(0..).all(|(bytes, i)| **bytes == [i]));
    }

    #[test]
    fn role_names_round_trip_and_reject_others() {
        for role in Role::ALL {
            assert_eq!(role.name().parse::<Role>().unwrap(), role);
        }
        assert!("gel".parse::<Role>().is_err());
    }
}
