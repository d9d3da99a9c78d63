//! The black box: a continuous log of a collection as MCAP files, so that the lift itself can be
//! studied afterwards.
//!
//! ```text
//!  capture threads ─┐
//!  engine ──────────┼─► queue, bounded by bytes ─► writer thread ─► <utc>-<n>.mcap
//!  inference ───────┘   full: newest left out        rotation, total limit, reserve
//! ```
//!
//! It is never the source of truth and never costs a recording: nothing waits for it. What does
//! not fit into the queue is left out, counted and told in the log; what cannot be written ends
//! the log and not the collection. `docs/black-box.md` says what the files hold.

#[cfg(test)]
mod black_box_test;
mod clock;
mod log_file;
mod messages;
mod queue;
mod shelf;
mod writer;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use self::clock::WallClock;
use self::queue::Queue;
pub(super) use self::queue::{Tap, Topic};
use self::shelf::{DirectoryShelf, Shelf};
use self::writer::Writer;
use super::thread::spawn;
use gripcast_base::error::Result;
use gripcast_imaging::Role;

/// How long the end of a collection waits for the log's last bytes. A disk that hangs leaves a
/// file that was not closed; the grasps are on the disk long before.
const END_PATIENCE: Duration = Duration::from_secs(5);

/// What the black box may use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BlackBoxSettings {
    /// Directory of the files; made when it is absent. Other files in it are left alone.
    pub directory: PathBuf,
    /// Size from which a new file is begun, bytes.
    pub file_bytes: u64,
    /// Most that all files in the directory may take; the oldest make room, bytes.
    pub total_bytes: u64,
    /// Free space of the disks, of dataset and log, below which the log ends, bytes.
    pub reserve_bytes: u64,
    /// Most that waits in memory to be written, bytes.
    pub queue_bytes: usize,
}

/// What the files say about where they come from.
pub(super) type Origin = BTreeMap<String, String>;

/// How the black box does.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BlackBoxStatus {
    /// Directory of the files.
    pub directory: String,
    /// Written in this collection, bytes.
    pub bytes: u64,
    /// Frames that are not in the log because the queue was full, all cameras.
    pub dropped: u64,
    /// Older files that were removed to keep the total limit.
    pub removed_files: u64,
    /// Why nothing is logged any more.
    pub stopped: Option<String>,
}

/// Frames of a camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FrameCounts {
    /// In the log.
    pub written: u64,
    /// Not in the log because the queue was full.
    pub dropped: u64,
}

/// What the black box did, for the closing report.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct BlackBoxReport {
    /// Directory of the files.
    pub directory: String,
    /// Files begun in this collection.
    pub files: u64,
    /// Bytes of these files.
    pub bytes: u64,
    /// Older files that were removed to keep the total limit.
    pub removed_files: u64,
    /// Frames by camera.
    pub frames: BTreeMap<Role, FrameCounts>,
    /// Events, predictions and the like that are not in the log because the queue was full.
    pub dropped_notes: u64,
    /// Why it ended before the collection.
    pub stopped: Option<String>,
}

/// What the writer has done so far.
#[derive(Debug, Default)]
struct Progress {
    files: u64,
    bytes: u64,
    removed_files: u64,
    written: BTreeMap<Role, u64>,
    stopped: Option<String>,
}

/// The running black box.
#[derive(Debug)]
pub(super) struct BlackBox {
    directory: String,
    queue: Arc<Queue>,
    progress: Arc<Mutex<Progress>>,
    ended: Receiver<()>,
}

impl BlackBox {
    /// Starts the writer. A directory that cannot be written to shows in the status.
    ///
    /// # Errors
    /// When the operating system gives no thread.
    pub(super) fn start(
        settings: BlackBoxSettings,
        dataset: PathBuf,
        origin: Origin,
    ) -> Result<Self> {
        let shelf = DirectoryShelf::new(settings.directory.clone(), dataset);
        Self::on(Box::new(shelf), settings, origin)
    }

    fn on(shelf: Box<dyn Shelf>, settings: BlackBoxSettings, origin: Origin) -> Result<Self> {
        let directory = settings.directory.display().to_string();
        let clock = WallClock::now();
        let queue = Arc::new(Queue::new(settings.queue_bytes, clock));
        let progress = Arc::new(Mutex::new(Progress::default()));
        let (end, ended) = std::sync::mpsc::channel();
        let writer = Writer::new(
            shelf,
            settings,
            origin,
            Arc::clone(&queue),
            Arc::clone(&progress),
        );
        spawn("black-box".into(), move || {
            // Threads of capture and inference go first; where that is refused all are equal.
            let _ = rustix::process::nice(5);
            writer.run();
            // Nobody asks any more where the end of the collection did not wait.
            let _ = end.send(());
        })?;
        Ok(Self {
            directory,
            queue,
            progress,
            ended,
        })
    }

    /// Where frames and notes go in.
    pub(super) fn tap(&self) -> Tap {
        Tap::new(&self.queue)
    }

    /// How it does.
    pub(super) fn status(&self) -> BlackBoxStatus {
        let dropped = self.queue.dropped().values().sum();
        let progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        BlackBoxStatus {
            directory: self.directory.clone(),
            bytes: progress.bytes,
            dropped,
            removed_files: progress.removed_files,
            stopped: progress.stopped.clone(),
        }
    }

    /// Writes what waits, closes the file and tells what was done.
    pub(super) fn stop(self) -> BlackBoxReport {
        self.queue.close();
        let is_ended = self.ended.recv_timeout(END_PATIENCE).is_ok();
        let dropped = self.queue.dropped();
        let progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        let unfinished =
            || (!is_ended).then(|| "the disk took too long to close the file".to_owned());
        BlackBoxReport {
            directory: self.directory.clone(),
            files: progress.files,
            bytes: progress.bytes,
            removed_files: progress.removed_files,
            frames: frame_counts(&progress.written, &dropped),
            dropped_notes: self.queue.dropped_notes(),
            stopped: progress.stopped.clone().or_else(unfinished),
        }
    }
}

fn frame_counts(
    written: &BTreeMap<Role, u64>,
    dropped: &BTreeMap<Role, u64>,
) -> BTreeMap<Role, FrameCounts> {
    let count = |counts: &BTreeMap<Role, u64>, role| counts.get(&role).copied().unwrap_or(0);
    Role::ALL
        .into_iter()
        .filter(|role| written.contains_key(role) || dropped.contains_key(role))
        .map(|role| {
            let counts = FrameCounts {
                written: count(written, role),
                dropped: count(dropped, role),
            };
            (role, counts)
        })
        .collect()
}
