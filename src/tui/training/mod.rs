//! The dashboard of a training: progress, curves and the best epoch while it goes on.
//!
//! The training tells [`TrainingNews`]; [`TrainingStatus`] gathers them; [`draw`] shows it. The
//! terminal has a thread of its own, which the training never waits for.

mod dashboard;
mod plot;
mod screen;
mod status;

pub use dashboard::draw;
pub(crate) use screen::TrainingScreen;
pub(crate) use status::epoch_line;
pub use status::{TrainingNews, TrainingStatus};
