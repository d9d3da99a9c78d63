//! Traits of frame sources: V4L2, replay and virtual cameras.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use gripcast_base::error::{Error, Result};
use gripcast_imaging::{Frame, PixelFormat, Role};

/// Control values by V4L2 name in snake case (`exposure_time_absolute`), in the driver's units.
pub type ControlValues = BTreeMap<String, i64>;

/// Identity of a physical camera.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CameraIdentity {
    /// USB product string, for instance `GelSight Mini R0B 2BNN-4ZE7`.
    pub product: String,
    /// USB serial (`2BNN4ZE7`); may be empty.
    pub serial: String,
    /// USB video-control interface number; on a D435, 0 is depth and 3 colour.
    pub interface: u8,
    /// USB port path (`3-2.1`), `virtual` or a directory.
    pub port: String,
    /// Current device node, for messages.
    pub node: Option<String>,
}

impl fmt::Display for CameraIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.product)?;
        if !self.serial.is_empty() {
            write!(f, ", serial {}", self.serial)?;
        }
        write!(f, ", port {}", self.port)
    }
}

/// Configuration of a stream, as read back from the driver.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamInfo {
    /// The camera behind the stream.
    pub identity: CameraIdentity,
    /// Pixel format of the frames.
    pub format: PixelFormat,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Nominal frame rate, 1/s.
    pub nominal_fps: f64,
    /// Depth unit of a depth stream, m.
    pub depth_unit_m: Option<f64>,
}

/// Error of reading a frame.
#[derive(Debug)]
pub enum CaptureError {
    /// No frame within the timeout; the stream continues.
    Timeout,
    /// A damaged frame; the stream continues.
    Damaged {
        /// Driver's frame counter.
        sequence: u32,
        /// Description of the damage.
        reason: String,
    },
    /// The device was unplugged; the source must be reopened.
    Gone,
    /// A recorded stream has ended.
    Ended,
    /// Other error; the source must be reopened.
    Failed(Error),
}

impl fmt::Display for CaptureError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Timeout => f.write_str("no frame arrived in time"),
            Self::Damaged { sequence, reason } => {
                write!(f, "frame {sequence} is damaged: {reason}")
            }
            Self::Gone => f.write_str("the camera was unplugged"),
            Self::Ended => f.write_str("the recording has ended"),
            Self::Failed(error) => error.fmt(f),
        }
    }
}

/// An open stream of frames. Dropping it stops the stream.
pub trait FrameSource: Send {
    /// Configuration of the stream.
    fn info(&self) -> &StreamInfo;

    /// Waits for the next frame, at most `timeout`.
    ///
    /// # Errors
    /// See [`CaptureError`].
    fn next_frame(&mut self, timeout: Duration) -> Result<Frame, CaptureError>;

    /// Reads the control values; empty for sources without controls.
    ///
    /// # Errors
    /// When the device fails or is unplugged.
    fn controls(&mut self) -> Result<ControlValues>;

    /// Requested controls and frame rate that the camera did not accept.
    fn warnings(&self) -> &[String] {
        &[]
    }
}

/// Opens a camera, repeatedly after errors.
pub trait CameraOpener: Send {
    /// Role of the camera.
    fn role(&self) -> Role;

    /// Description for messages: `GelSight Mini, serial 2BNN4ZE7`.
    fn describe(&self) -> String;

    /// Opens the camera and starts its stream.
    ///
    /// # Errors
    /// [`gripcast_base::error::ErrorKind::Device`] for an absent camera; `Busy`, `Permission` or
    /// `Config`.
    fn open(&mut self) -> Result<Box<dyn FrameSource>>;
}
