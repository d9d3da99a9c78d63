//! Replays annotated grasps in the simulators and measures how often simulation and reality agree
//! (the paper's §5.1, Tables 1 and 2).
//!
//! An [`ObjectFile`] describes a grasped object; a [`Recording`] contains the grasps of a dataset
//! that can be replayed; [`replay`] simulates each as several [`Case`]s, stores them in a
//! [`CaseStore`], scores them ([`OutcomeTable`]) and creates the [`Report`]. The report is written
//! as JSON; the
//! [`page`] is rendered from it. [`build_demo`] creates a dataset whose reality is simulated.

mod camera_view;
mod case;
mod compare;
mod curves;
mod demo;
mod grasp_chart;
mod html;
mod object_file;
mod recording;
#[cfg(test)]
mod replay_test;
mod report;
mod run;
#[cfg(test)]
mod sample_report;
mod score;
mod sweep;
mod tactile_pair;

pub use case::{Case, CaseRecord, CaseStore};
pub use compare::{compare, read_report};
pub use demo::{DemoData, DemoProgress, DemoSettings, DemoStage, DemoWatch, build_demo};
pub use grasp_chart::plot;
pub use html::page;
pub use object_file::{ObjectFile, ReplayObject, load_objects};
pub use recording::{MeasuredForce, RecordedGrasp, Recording};
pub use report::{
    CaseFacts, CellScore, ChangedOutcome, Changes, Confusion, Cost, Curves, DatasetFacts,
    EngineComparison, EngineFacts, ExcludedGrasp, GraspCell, GraspFacts, GraspReplay, ImagePair,
    ObjectFacts, PoseSamples, Proportion, REPORT_FORMAT, REPORT_VERSION, Reality, Report, Score,
    Scores, Setting, TactilePair, report_schema,
};
pub use run::{EngineSweep, ReplayInput, ReplayProgress, ReplaySettings, replay};
pub use score::{OutcomeTable, Scoring};
pub use sweep::{SweepProgress, SweepResult, sweep};
