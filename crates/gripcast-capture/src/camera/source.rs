//! The seam between cameras and the rest: one trait, implemented by V4L2, replay and virtual
//! cameras alike.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use gripcast_base::error::{Error, Result};
use gripcast_imaging::{Frame, PixelFormat, Role};

/// Camera controls by their V4L2 name in snake case (`exposure_time_absolute`), as read back
/// from the device; unit as the driver defines it.
pub type ControlValues = BTreeMap<String, i64>;

/// Which physical camera a stream comes from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CameraIdentity {
    /// USB product string, for instance `GelSight Mini R0B 2BNN-4ZE7`.
    pub product: String,
    /// USB serial (`2BNN4ZE7`); empty where the device has none.
    pub serial: String,
    /// Number of the USB video-control interface; tells the D435's depth (0) from colour (3).
    pub interface: u8,
    /// USB port path (`3-2.1`), `virtual` or a directory.
    pub port: String,
    /// Device node of this moment, for messages only.
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

/// What a stream delivers, as read back from the driver after it was configured.
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
    /// Nominal frame rate, 1/s; what is measured is often less.
    pub nominal_fps: f64,
    /// Metres per count, for depth streams.
    pub depth_unit_m: Option<f64>,
}

/// Why no frame came.
#[derive(Debug)]
pub enum CaptureError {
    /// Nothing arrived within the timeout; the stream is still open.
    Timeout,
    /// The driver handed over a frame that it knows to be incomplete; the stream goes on.
    Damaged {
        /// Driver's frame counter.
        sequence: u32,
        /// What is wrong with it.
        reason: String,
    },
    /// The device is gone (unplugged); the source must be opened anew.
    Gone,
    /// A recorded stream has ended.
    Ended,
    /// Anything else; the source must be opened anew.
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

/// An open stream of frames. Dropping it stops the stream and never panics.
pub trait FrameSource: Send {
    /// What the stream delivers.
    fn info(&self) -> &StreamInfo;

    /// Waits for the next frame, at most `timeout`.
    ///
    /// # Errors
    /// See [`CaptureError`]: after `Timeout` and `Damaged` the stream goes on, after all others it
    /// has to be opened anew.
    fn next_frame(&mut self, timeout: Duration) -> Result<Frame, CaptureError>;

    /// Reads the control values back from the device; empty for sources without controls.
    ///
    /// # Errors
    /// When the device refuses or is gone.
    fn controls(&mut self) -> Result<ControlValues>;

    /// What did not come to hold when the stream was opened, one sentence each: a control that
    /// the camera lacks or changed, a frame rate it does not keep.
    fn warnings(&self) -> &[String] {
        &[]
    }
}

/// Opens one camera again and again: at the start, after an unplug, after a freeze.
pub trait CameraOpener: Send {
    /// Role of the camera.
    fn role(&self) -> Role;

    /// What is looked for, for messages: `GelSight Mini, serial 2BNN4ZE7`.
    fn describe(&self) -> String;

    /// Finds and opens the camera and starts its stream.
    ///
    /// # Errors
    /// [`gripcast_base::error::ErrorKind::Device`] while it is absent, `Busy`, `Permission` or `Config`
    /// otherwise.
    fn open(&mut self) -> Result<Box<dyn FrameSource>>;
}
