//! Frame sources and their supervision.

mod source;
mod v4l2;
mod v4l2_controls;
#[cfg(test)]
mod v4l2_fake;
mod v4l2_ioctl;
mod v4l2_node;

pub use source::{
    CameraIdentity, CameraOpener, CaptureError, ControlValues, FrameSource, StreamInfo,
};
pub use v4l2::V4l2Opener;
pub(crate) use v4l2_controls::{CONTROLS, FORMER_NAMES};
#[cfg(test)]
pub(crate) use v4l2_fake::{Camera as FakeCamera, FakeNodes};
pub use v4l2_ioctl::KernelNodes;
pub use v4l2_node::{
    Capabilities, ControlRange, ExtensionRequest, Filled, FrameSize, Interval, Layout, Readiness,
    VideoNode, VideoNodes,
};
