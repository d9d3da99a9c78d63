//! The black box: a rolling log of a collection as MCAP files, for later analysis of the lift.
//!
//! ```text
//!  capture threads ─┐
//!  engine ──────────┼─► queue, bounded by bytes ─► writer thread ─► <utc>-<n>.mcap
//!  inference ───────┘   full: drop newest            rotation, size limit, reserve
//! ```
//!
//! Nothing waits for the black box. Frames that do not fit into the queue are dropped, counted and
//! reported in the log; a write error ends the log, not the collection.
//! `docs/reference/black-box.md` describes the files.

#[cfg(test)]
mod black_box_test;
mod clock;
mod log_dir;
mod mcap_log;
mod queue;
mod writer;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use self::clock::WallClock;
use self::log_dir::DiskLogDir;
use self::queue::Queue;
pub(super) use self::queue::Tap;
use self::writer::Writer;
use super::thread::{lock, spawn};
use gripcast_base::error::Result;
use gripcast_imaging::Role;
pub(super) use gripcast_interop::black_box::Topic;

/// Maximum wait for the last bytes of the log at the end of a collection. If the disk hangs, the
/// last file stays open; the grasps have been durable long before.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(5);

/// Settings of the black box.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BlackBoxSettings {
    /// Directory of the log files, created if missing. Other files in it are not touched.
    pub directory: PathBuf,
    /// Size at which a new file is started, bytes.
    pub file_bytes: u64,
    /// Maximum total size of the log files, bytes; the oldest are removed.
    pub total_bytes: u64,
    /// Free disk space, of dataset and log, below which logging stops, bytes.
    pub reserve_bytes: u64,
    /// Maximum size of the queue in memory, bytes.
    pub queue_bytes: usize,
}

/// Metadata of the log files: dataset, rig, model.
pub(super) type Provenance = BTreeMap<String, String>;

/// State of the black box.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BlackBoxStatus {
    /// Directory of the log files.
    pub directory: String,
    /// Bytes written in this collection.
    pub bytes: u64,
    /// Frames of all cameras dropped because the queue was full.
    pub dropped: u64,
    /// Old files removed to keep the total limit.
    pub removed_files: u64,
    /// Reason why logging stopped.
    pub stopped: Option<String>,
}

/// Frame counts of a camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FrameCounts {
    /// Frames in the log.
    pub written: u64,
    /// Frames dropped because the queue was full.
    pub dropped: u64,
}

/// Closing report of the black box.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct BlackBoxReport {
    /// Directory of the log files.
    pub directory: String,
    /// Files started in this collection.
    pub files: u64,
    /// Bytes of these files.
    pub bytes: u64,
    /// Old files removed to keep the total limit.
    pub removed_files: u64,
    /// Frame counts by camera.
    pub frames: BTreeMap<Role, FrameCounts>,
    /// JSON messages dropped because the queue was full.
    pub dropped_messages: u64,
    /// Reason why logging stopped before the collection ended.
    pub stopped: Option<String>,
}

/// The running black box.
#[derive(Debug)]
pub(super) struct BlackBox {
    queue: Arc<Queue>,
    report: Arc<Mutex<BlackBoxReport>>,
    ended: Receiver<()>,
}

impl BlackBox {
    /// Starts the writer thread. An unusable directory is reported in the status.
    ///
    /// # Errors
    /// `Io` if the thread cannot be started.
    pub(super) fn start(
        settings: BlackBoxSettings,
        dataset: PathBuf,
        provenance: Provenance,
    ) -> Result<Self> {
        let queue = Arc::new(Queue::new(settings.queue_bytes, WallClock::now()));
        let report = Arc::new(Mutex::new(BlackBoxReport {
            directory: settings.directory.display().to_string(),
            ..BlackBoxReport::default()
        }));
        let (end, ended) = std::sync::mpsc::channel();
        let writer = Writer::new(
            Box::new(DiskLogDir::new(settings.directory.clone(), dataset)),
            settings,
            provenance,
            Arc::clone(&queue),
            Arc::clone(&report),
        );
        spawn("black-box".into(), move || {
            // Capture and inference have priority, where the system allows it.
            let _ = rustix::process::nice(5);
            writer.run();
            // Fails if `stop` has timed out.
            let _ = end.send(());
        })?;
        Ok(Self {
            queue,
            report,
            ended,
        })
    }

    /// Returns an input for frames and messages.
    pub(super) fn tap(&self) -> Tap {
        Tap::new(&self.queue)
    }

    /// Returns the current state.
    pub(super) fn status(&self) -> BlackBoxStatus {
        let dropped = self.queue.dropped().values().sum();
        let report = lock(&self.report);
        BlackBoxStatus {
            directory: report.directory.clone(),
            bytes: report.bytes,
            dropped,
            removed_files: report.removed_files,
            stopped: report.stopped.clone(),
        }
    }

    /// Writes the queued entries, closes the file and returns the report.
    pub(super) fn stop(self) -> BlackBoxReport {
        self.queue.close();
        let is_ended = self.ended.recv_timeout(CLOSE_TIMEOUT).is_ok();
        let mut report = lock(&self.report).clone();
        for (role, dropped) in self.queue.dropped() {
            report.frames.entry(role).or_default().dropped = dropped;
        }
        report.dropped_messages = self.queue.dropped_messages();
        if !is_ended && report.stopped.is_none() {
            report.stopped = Some("the disk took too long to close the file".to_owned());
        }
        report
    }
}
