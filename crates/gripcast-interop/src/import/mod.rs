//! Datasets of others as shards that `train` and `eval` read.
//!
//! One is known: the *Feeling of Success* (Calandra et al., 2017, arXiv 1710.05512), real grasps
//! with two GelSight sensors and a Kinect. `docs/training.md` says what of its layout could be
//! verified, and where.

mod feeling_of_success;
mod report;
mod run;

#[cfg(test)]
mod import_test;

pub use crate::left_out::LeftOut;
pub use report::{ImportReport, ImportedPart, SourceFile};
pub use run::import_feeling_of_success;
