//! What is built, and how its progress is told.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::workers::par_map_single_threaded;

/// What a demo dataset is made of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DemoSettings {
    /// Everything that is drawn follows from it.
    pub seed: u64,
    /// 4 grasps of each object instead of 20, on the default mesh instead of the fine one.
    pub quick: bool,
    /// Folder with EGAD's B1, B4, C2 and C4 in `data/egad_eval/`, for the full dataset; the
    /// project's own shapes where there are none.
    pub shared: Option<PathBuf>,
    /// Grasps that are worked on at a time, each on one core; at least 1.
    pub jobs: usize,
}

impl DemoSettings {
    /// Grasps of each outcome and object.
    pub(super) fn wanted_of_class(&self) -> usize {
        if self.quick { 2 } else { 10 }
    }

    /// Candidates of an object that are drawn at most: ten for each grasp that is wanted.
    pub(super) fn most_candidates(&self) -> usize {
        20 * self.wanted_of_class()
    }
}

/// What is being done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DemoStage {
    /// Candidates are simulated with a coarse mesh, to find some of each outcome.
    Screening,
    /// Grasps are simulated as reality.
    Simulating,
    /// Images are rendered and stored.
    Recording,
}

/// How far a stage is; the first two stages may come by turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DemoProgress {
    /// What is being done.
    pub stage: DemoStage,
    /// Grasps done.
    pub done: usize,
    /// Grasps of this round.
    pub of: usize,
}

/// Ways to follow and to stop the building.
#[derive(Clone, Copy)]
pub struct DemoWatch<'a> {
    /// Called from any thread after each grasp.
    pub progress: &'a (dyn Fn(DemoProgress) + Sync),
    /// Once true, no further grasp is begun and building ends with an error of kind `Stopped`.
    pub cancel: Option<&'a AtomicBool>,
}

impl DemoWatch<'_> {
    /// Does `work` for every item, `jobs` at a time; results in the order of the items.
    ///
    /// # Errors
    /// The error of the first item that failed, after which none is begun; `Stopped`.
    pub(super) fn for_each<T: Sync, R: Send>(
        &self,
        jobs: usize,
        stage: DemoStage,
        items: &[T],
        work: &(dyn Fn(&T) -> Result<R> + Sync),
    ) -> Result<Vec<R>> {
        let of = items.len();
        let told = |done| (self.progress)(DemoProgress { stage, done, of });
        par_map_single_threaded(
            jobs,
            items,
            &|item| self.check().and_then(|()| work(item)),
            &told,
        )
    }

    pub(super) fn check(&self) -> Result<()> {
        if self.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
            return Err(
                Error::new(ErrorKind::Stopped, "stopped before the demo data was whole")
                    .remedy("run the same command again: it goes on where it stopped"),
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stopped_watch_begins_nothing() {
        let stop = AtomicBool::new(true);
        let watch = DemoWatch {
            progress: &|_| (),
            cancel: Some(&stop),
        };
        let nothing = watch.for_each(2, DemoStage::Recording, &[1, 2, 3], &|_| {
            Err::<(), _>(Error::internal("begun"))
        });
        assert_eq!(nothing.unwrap_err().kind(), ErrorKind::Stopped);
    }
}
