//! Training dashboard: progress, curves and best epoch.
//!
//! The training sends [`TrainingNews`], [`TrainingStatus`] collects them, [`draw`] shows it. The
//! terminal has its own thread, which the training never waits for.

mod dashboard;
mod plot;
mod screen;
mod status;

pub use dashboard::draw;
pub(crate) use screen::TrainingScreen;
pub(crate) use status::epoch_line;
pub use status::{TrainingNews, TrainingStatus};
