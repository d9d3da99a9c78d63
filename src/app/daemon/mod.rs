//! The engine behind `collect`: capture, inference, writing, and the session that joins them.

mod status;

pub use status::{CameraState, CameraStatus, EngineStatus, PredictionStatus, Preview};
