//! The dataset on disk: one directory a grasp, crash-safe, readable in one line by
//! Hugging Face `imagefolder` and pandas.
//!
//! Layout and durability rules: `docs/dataset-format.md`.

mod grasp;

pub use grasp::{
    CameraRecord, FileDigest, GraspId, GraspRecord, Outcome, OverriddenGuard, PoseRecord,
    PredictionRecord, StageRecord,
};
