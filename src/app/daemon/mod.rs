//! The engine behind `collect`: capture, inference, writing, and the session that joins them.
//!
//! ```text
//!  camera ─► capture thread ─► hub (newest frames) ─► decode thread ─► inference thread
//!                               │                                        │ findings
//!  key, pedal, script ─► engine ┴─ session ─► store thread ─► dataset    ▼
//!                               └──────────── status ───────────────► screen
//! ```

mod approach;
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

pub use calibration::stored_intrinsics;
pub use engine::{EngineLinks, EngineSetup, Stored, run};
pub use report::{CameraReport, CollectReport, Ended, GraspReport, PredictionReport};
pub use sheets::{Boards, read_sheets};
pub use status::{CameraState, CameraStatus, EngineStatus, PredictionStatus, Preview};
