//! Frame sources and their supervision.

mod camera_state;
mod clock;
mod recorder;
mod replay;
mod rig_sources;
mod source;
mod stream_monitor;
mod supervised;
mod v4l2;
mod v4l2_controls;
#[cfg(test)]
mod v4l2_fake;
mod v4l2_ioctl;
mod v4l2_node;
mod v4l2_shared;

pub use camera_state::{CameraState, FrameQuality, MAX_DAMAGED_FRACTION, percent};
pub use clock::{Clock, ManualClock, MonotonicClock, monotonic_ns};
pub use recorder::Recorder;
pub use replay::{ReplayOpener, ReplaySource};
pub use rig_sources::{NoVirtualCameras, RigSources, VirtualCameras};
pub use source::{
    CameraIdentity, CameraOpener, CaptureError, ControlValues, FrameSource, StreamInfo,
};
pub use stream_monitor::{
    CameraCounters, FrameContent, FrameFacts, Health, StreamMonitor, StreamReport,
    SupervisionPolicy,
};
pub use supervised::{CameraEvent, content_of, health_of, run_camera};
pub use v4l2::V4l2Opener;
pub(crate) use v4l2_controls::{CONTROLS, FORMER_NAMES};
#[cfg(test)]
pub(crate) use v4l2_fake::{Camera as FakeCamera, FakeNodes};
pub use v4l2_ioctl::KernelNodes;
pub use v4l2_node::{
    Capabilities, ControlRange, ExtensionRequest, FilledBuffer, FrameSize, Interval, Layout,
    Readiness, VideoNode, VideoNodes,
};
pub use v4l2_shared::SharedBytes;
