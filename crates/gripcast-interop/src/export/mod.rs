//! A finished dataset in the formats of others: Hugging Face Parquet, WebDataset, LeRobot, Zarr; and
//! as the shards that `train` and `eval` read.
//!
//! An export is derived: the same dataset makes the same bytes, and no dataset is made of it. It is
//! written under a hidden name and gets its own when it is whole. Of a damaged grasp nothing is
//! exported; the report names it. Memory holds the ids, one grasp's images and one row group.
//! `docs/exports.md` says what each format holds.

mod choice;
mod format;
mod lerobot;
mod parquet;
mod plan;
mod report;
mod run;
mod shard_files;
mod source;
mod staged;
mod training;
mod webdataset;
mod zarr;

#[cfg(test)]
mod export_test;

pub use crate::left_out::LeftOut;
pub use plan::{ExportFormat, ExportPlan};
pub use report::ExportReport;
pub use run::export;
