//! Replays annotated grasps in the simulators and says where simulation and reality agree (the
//! paper's §5.1, Tables 1 and 2).
//!
//! An [`ObjectFile`] says what was grasped. The [`Report`] is written as JSON; the page is drawn
//! from it.

mod html;
mod object_file;
mod report;
#[cfg(test)]
mod sample_report;
mod schema;

pub use html::page;
pub use object_file::ObjectFile;
pub use report::{
    CaseFacts, CellScore, ChangedOutcome, Changes, Confusion, Cost, Curves, DatasetFacts, Duel,
    EngineFacts, GraspCell, GraspFacts, GraspReplay, LeftOut, ObjectFacts, PicturePair,
    PoseSamples, Proportion, REPORT_FORMAT, REPORT_VERSION, Reality, Report, Score, Scores,
    Setting, TactilePair,
};
pub use schema::report_schema;
