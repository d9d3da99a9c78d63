//! Frame sources and their supervision.

mod clock;
mod recorder;
mod replay;
mod source;
mod stream_monitor;
mod supervised;
mod virtual_camera;
mod virtual_scene;

pub use clock::{Clock, ManualClock, MonotonicClock, monotonic_ns};
pub use recorder::Recorder;
pub use replay::{ReplayOpener, ReplayPace, ReplaySource};
pub use source::{
    CameraIdentity, CameraOpener, CaptureError, ControlValues, FrameSource, StreamInfo,
};
pub use stream_monitor::{
    CameraCounters, FrameFacts, Health, StreamMonitor, StreamReport, SupervisionPolicy,
};
pub use supervised::{CameraEvent, run_camera};
pub use virtual_camera::{VirtualOpener, VirtualRig};
pub use virtual_scene::{Grip, SceneMoment, VirtualGrasp, VirtualHand, VirtualObject};
