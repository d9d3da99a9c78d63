//! The dataset on disk: one directory per grasp, crash-safe, readable in one line by
//! Hugging Face `imagefolder` and pandas.
//!
//! Layout and durability rules: `docs/reference/dataset-format.md`.
//!
//! * [`DatasetWriter`] writes, one process at a time; [`Dataset`] reads
//! * [`verify`] finds torn, missing, altered, duplicated and leaking items;
//!   [`recover`] keeps every readable grasp and moves the rest to `trash/`
//! * [`split`] assigns grasps to splits without leakage; [`summary`] counts them
//!
//! ```no_run
//! use gripcast_dataset::Dataset;
//!
//! let dataset = Dataset::open("my-dataset")?;
//! for grasp in dataset.grasps()? {
//!     let grasp = grasp?;
//!     println!("{} {} {:?}", grasp.id, grasp.object, grasp.outcome);
//! }
//! # Ok::<(), gripcast_base::error::Error>(())
//! ```

mod capture;
mod counts;
#[cfg(test)]
mod crash_test;
#[cfg(test)]
mod damage_test;
mod descriptor;
mod digest;
mod disk;
mod encode;
mod field;
#[cfg(test)]
mod field_test;
mod grasp;
mod grasp_index;
mod image_file;
mod immutable;
mod index;
mod layout;
mod lift;
mod lock;
mod migrate;
mod names;
mod opening;
mod prediction;
mod problem;
mod provenance;
mod reader;
mod rebuild;
mod record_file;
mod recover;
#[cfg(any(test, feature = "testing"))]
pub mod sample;
mod schema;
pub mod shard;
mod split;
mod stored_file;
mod summary;
mod trash;
mod unfinished;
mod verify;
mod writer;

pub use capture::{CapturedCamera, GraspMeta, StageCapture};
pub use counts::GraspCounts;
pub use descriptor::{Descriptor, NewDataset};
pub use digest::FileDigest;
pub use field::{FieldArray, FieldRecord, MARKERS};
pub use grasp::{
    BoardKeys, CameraRecord, GraspRecord, Outcome, OverriddenGuard, PoseQuality, PoseRecord,
    SimulatedTruth, StageRecord,
};
pub use grasp_index::{GraspIndex, IndexWork};
pub use gripcast_base::files::{FieldName, GraspId};
pub use index::{IndexRow, ReindexReport, metadata_jsonl, reindex};
pub use layout::{Stage, image_name, pre_grasp_name};
pub use lift::{LiftCamera, LiftFrame, LiftRecord};
pub use migrate::{MigrateReport, migrate};
pub use names::{EditReport, EditedGrasp, NameChange, Selection, edit};
pub use opening::OpenReport;
pub use prediction::{AdaptedPrediction, LiftVerdict, OpenOutcomes, PredictionRecord};
pub use problem::{Problem, ProblemKind, ProblemSummary, VerifyReport};
pub use provenance::Provenance;
pub use reader::{Dataset, TACTILE_SIZE};
pub use record_file::PendingInitial;
pub use recover::{Action, ActionKind, RecoverReport, recover};
pub use schema::SCHEMA_VERSION;
pub use split::{GroupKey, SplitFile, SplitMembers, SplitPlan, split};
pub use summary::{Agreement, Summary, summary};
pub use verify::verify;
pub use writer::DatasetWriter;
