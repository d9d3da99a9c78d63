//! The grasp of the paper: closure, force adjustment, lift.

mod protocol;
mod run;
mod scene;
mod start_check;
mod trace;

pub use protocol::{ForceRule, Protocol};
pub use run::{GraspOutcome, GraspResult, simulate};
pub use scene::{Finger, GelSpec, Scene};
pub use trace::{GelForce, Snapshot, StageName, Trace, TraceStep};
