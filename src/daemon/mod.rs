//! The engine behind `collect`: capture, inference, storage, and the session that connects them.
//!
//! ```text
//!  camera ─► capture thread ─► hub (newest frames) ─► decode thread ─► inference thread
//!                               │                                        │ prediction
//!  key, pedal, script ─► engine ┴─ session ─► store thread ─► dataset    ▼
//!                               └──────────── status ───────────────► screen
//!  frames, events, predictions ─► black box (optional, nothing waits for it)
//! ```

mod black_box;
mod boards;
mod calibration;
mod capture;
mod command_request;
mod decision;
mod decode;
mod engine;
mod gels;
mod histogram;
mod hub;
mod infer;
mod live_lift;
pub mod live_load;
mod pairing;
mod pre_grasp;
mod report;
mod shear;
mod start_report;
mod status;
mod store;
mod tasks;
mod thread;

pub use black_box::{BlackBoxReport, BlackBoxSettings, BlackBoxStatus, FrameCounts};
pub use boards::{Boards, read_object_boards};
pub use calibration::stored_intrinsics;
pub use command_request::CommandRequest;
pub use engine::{DecisionSettings, EngineLinks, EngineSetup, StoreEvent, run};
pub use gripcast_capture::camera::CameraState;
pub use infer::ModelInfo;
pub use report::{
    CameraReport, CollectReport, EndReason, GraspReport, LiftReport, PredictionReport,
};
pub use shear::{GelForces, GelScale};
pub use start_report::{StartFinding, StartSubject};
pub(crate) use status::disk_free_bytes;
pub use status::{
    CameraStatus, EngineStatus, GelStatus, LiftStatus, LiveMarkers, MarkerStatus, PredictionStatus,
    Preview, ShearStatus, unsure_words, verdict_of,
};
pub use tasks::{Heartbeat, TaskReport, TaskState, Tasks};
pub(crate) use thread::lock;
