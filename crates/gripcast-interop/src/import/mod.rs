//! Imports third-party datasets.
//!
//! Pairs of videos become a dataset of grasps ([`video`]). Shards for `train` and `eval` are made of
//! the *Feeling of Success* (Calandra et al., 2017, arXiv 1710.05512), real grasps with
//! two GelSight sensors and a Kinect. `docs/how-to/third-party-grasps.md` states how its layout was
//! verified.

mod feeling_of_success;
mod report;
mod run;
pub mod video;

#[cfg(test)]
mod import_test;

pub use crate::left_out::LeftOut;
pub use report::{ImportReport, ImportedSplit, SourceFile};
pub use run::import_feeling_of_success;
