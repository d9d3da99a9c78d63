//! Synthetic datasets: objects with properties and grasps; a plan of simulations that any number of
//! processes run; images; and curation of the dataset.
//!
//! ```text
//! family, acronym ─► drafts ─► plan ─► run (shards) ─► results ─┬─► merge ─► Parquet
//!   properties, grasp ───┘                simulate, render      │    curate     │
//!                                                               └───► report ◄──┘
//! ```
//!
//! See the paper's §3.2 and A.1. Every result depends on the plan alone.

pub mod acronym;
mod contact_maps;
pub mod curate;
mod engine;
pub mod family;
pub mod grasp;
mod merge;
mod object_mesh;
pub mod plan;
pub mod properties;
pub mod report;
mod run;
mod sample_images;
mod store;

pub use engine::planned_engine;
pub use merge::{MergeReport, MergeSettings, merge, select_simulations};
pub use object_mesh::planned_mesh;
pub use run::{ImageSelection, RunProgress, RunSettings, RunSummary, run, simulate_labels};
pub use store::{CpuSeconds, FAILED, RESULTS, ResultStore, SampleFile, SimulationResult};
