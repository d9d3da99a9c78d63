//! Frame sources and their supervision.

mod source;

pub use source::{
    CameraIdentity, CameraOpener, CaptureError, ControlValues, FrameSource, StreamInfo,
};
