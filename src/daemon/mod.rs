//! The engine behind `collect`: capture, inference, writing, and the session that joins them.
//!
//! ```text
//!  camera ─► capture thread ─► hub (newest frames) ─► decode thread ─► inference thread
//!                               │                                        │ findings
//!  key, pedal, script ─► engine ┴─ session ─► store thread ─► dataset    ▼
//!                               └──────────── status ───────────────► screen
//!  frames, events, predictions ─► black box (optional, nothing waits for it)
//! ```

mod approach;
mod asked;
mod black_box;
mod calibration;
mod capture;
mod decode;
mod engine;
mod histogram;
mod hub;
mod infer;
pub mod live_load;
mod pairing;
mod report;
mod sheets;
mod status;
mod store;
mod tasks;
mod thread;

pub use asked::Asked;
pub use black_box::{BlackBoxReport, BlackBoxSettings, BlackBoxStatus, FrameCounts};
pub use calibration::stored_intrinsics;
pub use engine::{EngineLinks, EngineSetup, Stored, run};
pub use infer::ModelFacts;
pub use report::{CameraReport, CollectReport, Ended, GraspReport, PredictionReport};
pub use sheets::{Boards, read_sheets};
pub use status::{
    CameraState, CameraStatus, EngineStatus, MarkerStatus, PredictionStatus, Preview, verdict_of,
};
pub use tasks::{Beat, TaskReport, TaskState, Tasks};
