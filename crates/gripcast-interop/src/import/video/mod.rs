//! Imports pairs of videos of two tactile sensors as a dataset of grasps.
//!
//! Each pair gives one grasp: the frames of the open gripper and those of the closed one, which are
//! given or found ([`onset`]). Frames after the grasp frame, and the length of a clip, are not in the
//! dataset: both may give the label away.

mod onset;
mod run;
mod table;
#[cfg(test)]
mod video_test;

pub use onset::{OnsetSettings, PairOnset, find_onset};
pub use run::{ImportedClip, VideoImport, VideoReport, import_videos};
pub use table::{Begins, ClipRow, clips_of};
