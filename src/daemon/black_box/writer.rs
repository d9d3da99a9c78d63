//! The writer thread: rotation, total limit, disk reserve, and the end at the first error.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use super::log_dir::{LogDir, LogName};
use super::mcap_log::{CHUNK_NS, McapLog};
use super::queue::{Content, Entry, Next, Queue, event};
use super::{BlackBoxReport, BlackBoxSettings, Provenance};
use crate::daemon::thread::lock;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_capture::camera::monotonic_ns;
use gripcast_imaging::Role;

/// State of the writer thread.
pub(super) struct Writer {
    log_dir: Box<dyn LogDir>,
    settings: BlackBoxSettings,
    provenance: Provenance,
    queue: Arc<Queue>,
    report: Arc<Mutex<BlackBoxReport>>,
    name: LogName,
    file: Option<McapLog>,
    /// Bytes of the closed files of this collection.
    closed_bytes: u64,
    /// Frames in the current chunk.
    unwritten: BTreeMap<Role, u64>,
}

impl Writer {
    /// Creates the writer of a new collection.
    pub(super) fn new(
        log_dir: Box<dyn LogDir>,
        settings: BlackBoxSettings,
        provenance: Provenance,
        queue: Arc<Queue>,
        report: Arc<Mutex<BlackBoxReport>>,
    ) -> Self {
        Self {
            log_dir,
            settings,
            provenance,
            queue,
            report,
            name: LogName::first(),
            file: None,
            closed_bytes: 0,
            unwritten: BTreeMap::new(),
        }
    }

    /// Writes until the queue is closed or an error occurs, which goes to the report.
    pub(super) fn run(mut self) {
        let result = self.write_queue();
        // After an error the file is valid up to its last chunk.
        self.file = None;
        if let Err(error) = result {
            self.queue.abandon();
            self.report().stopped = Some(error.to_string().replace("\n  → ", " → "));
        }
    }

    fn write_queue(&mut self) -> Result<()> {
        self.start_file()?;
        loop {
            match self.queue.next(Duration::from_nanos(CHUNK_NS)) {
                Next::Entry(entry) => self.write(entry)?,
                Next::Timeout => self.write_chunk()?,
                Next::Closed => return self.close_file(),
            }
        }
    }

    fn write(&mut self, entry: Entry) -> Result<()> {
        let is_full = |file: &McapLog| file.bytes() >= self.settings.file_bytes;
        if self.file.as_ref().is_some_and(is_full) {
            self.close_file()?;
            self.name.number += 1;
            self.start_file()?;
        }
        let role = match &entry.content {
            Content::Frame { role, .. } => Some(*role),
            Content::Json { .. } => None,
        };
        let Some(file) = &mut self.file else {
            return Ok(());
        };
        let result = file.add(entry);
        let is_written = result.map_err(|e| self.failed("cannot write the black box", e))?;
        if let Some(role) = role {
            *self.unwritten.entry(role).or_default() += 1;
        }
        if is_written {
            self.update_report();
            self.check_reserve()?;
        }
        Ok(())
    }

    fn write_chunk(&mut self) -> Result<()> {
        if let Some(file) = &mut self.file {
            let result = file.write_chunk();
            result.map_err(|e| self.failed("cannot write the black box", e))?;
        }
        self.update_report();
        self.check_reserve()
    }

    /// Ends the log with a valid file while the disk still has room for the dataset.
    fn check_reserve(&mut self) -> Result<()> {
        let reserve = self.settings.reserve_bytes;
        let Some(free) = self.log_dir.free_bytes().filter(|free| *free < reserve) else {
            return Ok(());
        };
        self.close_file()?;
        let (free_mb, reserve_mb) = (free / 1_000_000, reserve / 1_000_000);
        let what =
            format!("the disk has {free_mb} MB free, {reserve_mb} MB are reserved for the dataset");
        Err(Error::new(ErrorKind::DiskFull, what)
            .at(self.settings.directory.display())
            .remedy("free disk space, or set `black_box.directory` to another disk"))
    }

    fn start_file(&mut self) -> Result<()> {
        self.check_reserve()?;
        let removed = self.remove_old_files()?;
        let mut metadata = self.provenance.clone();
        metadata.insert("part".into(), self.name.number.to_string());
        let file = self
            .log_dir
            .create(&self.name.open())
            .and_then(|file| McapLog::start(file, self.queue.clock, metadata))
            .map_err(|e| self.failed("cannot create a file of the black box", e))?;
        self.file = Some(file);
        self.report().files += 1;
        if !removed.is_empty() {
            self.report().removed_files += removed.len() as u64;
            let at_ns = monotonic_ns();
            let at = self.queue.clock.text(at_ns);
            let what = serde_json::json!({ "files": removed });
            let content = event(&at, "black_box_removed", &what);
            self.write(Entry { at_ns, content })?;
        }
        Ok(())
    }

    /// Removes the oldest files until another one fits, and returns their names.
    fn remove_old_files(&mut self) -> Result<Vec<String>> {
        let listed = self
            .log_dir
            .list()
            .map_err(|e| self.failed("cannot use the directory of the black box", e))?;
        let mut files: Vec<_> = listed
            .into_iter()
            .filter_map(|(name, bytes)| Some((LogName::parse(&name)?, name, bytes)))
            .collect();
        files.sort();
        let mut total: u64 = files.iter().map(|(_, _, bytes)| bytes).sum();
        let BlackBoxSettings {
            total_bytes,
            file_bytes,
            ..
        } = self.settings;
        let mut removed = Vec::new();
        for (_, name, bytes) in files {
            if total <= total_bytes.saturating_sub(file_bytes) {
                break;
            }
            self.log_dir
                .remove(&name)
                .map_err(|e| self.failed("cannot remove an old file of the black box", e))?;
            total -= bytes;
            removed.push(name);
        }
        Ok(removed)
    }

    fn close_file(&mut self) -> Result<()> {
        let Some(file) = self.file.take() else {
            return Ok(());
        };
        let bytes = file
            .close()
            .map_err(|e| self.failed("cannot close a file of the black box", e))?;
        self.closed_bytes += bytes;
        self.update_report();
        self.log_dir
            .rename(&self.name.open(), &self.name.closed())
            .map_err(|e| self.failed("cannot rename a file of the black box", e))
    }

    /// Counts everything added so far as written.
    fn update_report(&mut self) {
        let unwritten = std::mem::take(&mut self.unwritten);
        let open_bytes = self.file.as_ref().map_or(0, McapLog::bytes_on_disk);
        let mut report = self.report();
        report.bytes = self.closed_bytes + open_bytes;
        for (role, frames) in unwritten {
            report.frames.entry(role).or_default().written += frames;
        }
    }

    fn report(&self) -> MutexGuard<'_, BlackBoxReport> {
        lock(&self.report)
    }

    fn failed(&self, what: &str, error: std::io::Error) -> Error {
        let path = self.settings.directory.join(self.name.open());
        Error::io(what, error).at(path.display())
    }
}
