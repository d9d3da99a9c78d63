//! Settings and progress of the demo data.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::workers::par_map_single_threaded;

/// Settings of a demo dataset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DemoSettings {
    /// Random seed.
    pub seed: u64,
    /// 4 grasps of each object instead of 20, on the default mesh instead of the fine one.
    pub quick: bool,
    /// Folder with EGAD's B1, B4, C2 and C4 in `data/egad_eval/`, for the full dataset; built-in
    /// shapes are used otherwise.
    pub shared: Option<PathBuf>,
    /// Grasps that are processed in parallel, at least 1.
    pub jobs: usize,
}

impl DemoSettings {
    /// Number of grasps per label and object.
    pub(super) fn wanted_per_label(&self) -> usize {
        if self.quick { 2 } else { 10 }
    }

    /// Maximum number of candidates of an object: ten per requested grasp.
    pub(super) fn max_candidates(&self) -> usize {
        20 * self.wanted_per_label()
    }
}

/// Stage of the build.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DemoStage {
    /// Simulating candidates with a coarse mesh, to predict their labels.
    Screening,
    /// Simulating reality.
    Simulating,
    /// Rendering and storing images.
    Recording,
}

/// Progress of a stage; the first two stages may alternate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DemoProgress {
    /// Stage.
    pub stage: DemoStage,
    /// Number of finished grasps.
    pub done: usize,
    /// Number of grasps of this round.
    pub total: usize,
}

/// Progress callback and cancellation of a build.
#[derive(Clone, Copy)]
pub struct DemoWatch<'a> {
    /// Called from any thread after each grasp.
    pub on_progress: &'a (dyn Fn(DemoProgress) + Sync),
    /// Once true, no further grasp is started and the build ends with an error of kind `Stopped`.
    pub cancel: Option<&'a AtomicBool>,
}

impl DemoWatch<'_> {
    /// Does `work` for every item, `jobs` in parallel; returns the results in the order of the
    /// items.
    ///
    /// # Errors
    /// The error of the first failed item, after which no item is started; `Stopped`.
    pub(super) fn for_each<T: Sync, R: Send>(
        &self,
        jobs: usize,
        stage: DemoStage,
        items: &[T],
        work: &(dyn Fn(&T) -> Result<R> + Sync),
    ) -> Result<Vec<R>> {
        let total = items.len();
        let report = |done| (self.on_progress)(DemoProgress { stage, done, total });
        par_map_single_threaded(
            jobs,
            items,
            &|item| self.check().and_then(|()| work(item)),
            &report,
        )
    }

    pub(super) fn check(&self) -> Result<()> {
        if self.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
            return Err(Error::new(
                ErrorKind::Stopped,
                "stopped before the demo data was complete",
            )
            .remedy("rerun the same command to resume"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cancelled_watch_starts_nothing() {
        let stop = AtomicBool::new(true);
        let watch = DemoWatch {
            on_progress: &|_| (),
            cancel: Some(&stop),
        };
        let nothing = watch.for_each(2, DemoStage::Recording, &[1, 2, 3], &|_| {
            Err::<(), _>(Error::internal("started"))
        });
        assert_eq!(nothing.unwrap_err().kind(), ErrorKind::Stopped);
    }
}
