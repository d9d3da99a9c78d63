//! Simulation of a grasp as in the paper: closure, force adjustment, lift.

#[cfg(test)]
mod fields_test;
mod friction_use;
#[cfg(test)]
mod not_converged_test;
#[cfg(test)]
mod other_pad_test;
mod placement;
mod protocol;
mod run;
#[cfg(any(test, feature = "testing"))]
mod sample_trace;
mod scene;
mod settings;
mod start;
mod start_check;
mod stepper;
mod summary;
pub mod trace;
mod trace_file;

pub use placement::{
    GRIPPER_OPENING_M, GraspPose, GripperState, Placement, height_above_ground, resting_pose,
};
pub use protocol::{ForceRule, Protocol};
pub(crate) use run::MIN_CONTACT_FORCE_N;
pub use run::{GraspOutcome, GraspResult, simulate, simulate_until, simulate_with_fields};
#[cfg(any(test, feature = "testing"))]
pub use sample_trace::sample_trace;
pub(crate) use scene::MAX_OPENING_M;
pub use scene::{Finger, GelSpec, Scene};
pub use settings::{GraspSettings, Preset, TACCEL_DRIVE_WEIGHT};
pub use start::{ChosenStablePose, GraspStart};
pub use stepper::{StepState, StepTarget, Stepper};
pub use summary::{GraspSummary, PerGel, STEADY_STEPS, StageWork};
pub use trace::{GelForce, Snapshot, StageName, Trace, TraceStep};
pub use trace_file::TraceFile;
