//! Replays annotated grasps in the simulators and says where simulation and reality agree (the
//! paper's §5.1, Tables 1 and 2).
//!
//! An [`ObjectFile`] says what was grasped. The [`Report`] is written as JSON; the page is drawn
//! from it.

mod case;
mod compare;
mod curves;
mod object_file;
mod picture;
mod recording;
#[cfg(test)]
mod replay_test;
mod report;
mod run;
mod score;
mod statistic;
mod sweep;
mod tactile_pair;

pub use case::{Case, CaseRecord, CaseStore};
pub use compare::{compare, read_report};
pub use object_file::{ObjectFile, ReplayObject, load_objects};
pub use recording::{RecordedGrasp, Recording};
pub use report::{
    CaseFacts, CellScore, ChangedOutcome, Changes, Confusion, Cost, Curves, DatasetFacts, Duel,
    EngineFacts, GraspCell, GraspFacts, GraspReplay, LeftOut, ObjectFacts, PicturePair,
    PoseSamples, Proportion, REPORT_FORMAT, REPORT_VERSION, Reality, Report, Score, Scores,
    Setting, TactilePair,
};
pub use run::{EngineSweep, ReplayInput, ReplayProgress, ReplaySettings, replay};
pub use score::{Outcomes, Scored};
pub use statistic::mcnemar_p;
pub use sweep::{SweepProgress, Swept, sweep};
