//! Exports a dataset to third-party formats (Hugging Face Parquet, WebDataset, LeRobot, Zarr) and
//! to the shards of `train` and `eval`.
//!
//! Equal datasets give equal bytes. An export is written under a hidden name and renamed when
//! complete. Damaged grasps are left out and listed in the report. Memory use is limited to the
//! ids, one grasp's images and one row group. `docs/reference/exports.md` describes each format.

mod facts;
mod fields;
mod format;
mod lerobot;
mod parquet;
mod plan;
mod report;
mod run;
mod selection;
mod shard_files;
mod source;
mod staged;
mod training;
mod webdataset;
mod zarr;

#[cfg(test)]
mod export_test;
#[cfg(test)]
mod fields_test;
#[cfg(test)]
mod sequence_test;

pub use crate::left_out::LeftOut;
pub use plan::{ExportFormat, ExportPlan, SequencePlan};
pub use report::ExportReport;
pub use run::export;
