//! The writing thread: rotation, the total limit, the reserve, and the end at the first error.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::log_file::{CHUNK_NS, LogFile};
use super::queue::{Content, Entry, Queue, Taken, event};
use super::shelf::{FileName, Shelf};
use super::{BlackBoxSettings, Origin, Progress};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_capture::camera::monotonic_ns;
use gripcast_imaging::Role;

/// The writer, before its thread runs it.
pub(super) struct Writer {
    shelf: Box<dyn Shelf>,
    settings: BlackBoxSettings,
    origin: Origin,
    queue: Arc<Queue>,
    progress: Arc<Mutex<Progress>>,
    name: FileName,
    file: Option<LogFile>,
    /// Bytes of this collection's files that are closed.
    closed_bytes: u64,
    /// Frames in the present chunk.
    unwritten: BTreeMap<Role, u64>,
}

impl Writer {
    /// A writer of a collection that begins now.
    pub(super) fn new(
        shelf: Box<dyn Shelf>,
        settings: BlackBoxSettings,
        origin: Origin,
        queue: Arc<Queue>,
        progress: Arc<Mutex<Progress>>,
    ) -> Self {
        Self {
            shelf,
            settings,
            origin,
            queue,
            progress,
            name: FileName::first(),
            file: None,
            closed_bytes: 0,
            unwritten: BTreeMap::new(),
        }
    }

    /// Writes until the queue is closed or something fails; the reason is then in the progress.
    pub(super) fn run(mut self) {
        let result = self.record();
        // After an error the file stays as it is: whole up to its last chunk.
        self.file = None;
        if let Err(error) = result {
            self.queue.abandon();
            self.progress().stopped = Some(error.to_string().replace("\n  → ", " → "));
        }
    }

    fn record(&mut self) -> Result<()> {
        self.begin_file()?;
        loop {
            match self.queue.take(Duration::from_nanos(CHUNK_NS)) {
                Taken::Entry(entry) => self.write(entry)?,
                Taken::Nothing => self.write_chunk()?,
                Taken::Closed => return self.close_file(),
            }
        }
    }

    fn write(&mut self, entry: Entry) -> Result<()> {
        let is_full = |file: &LogFile| file.bytes() >= self.settings.file_bytes;
        if self.file.as_ref().is_some_and(is_full) {
            self.close_file()?;
            self.name.number += 1;
            self.begin_file()?;
        }
        let role = match &entry.content {
            Content::Frame { role, .. } => Some(*role),
            Content::Note { .. } => None,
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
            self.tell_written();
            self.keep_reserve()?;
        }
        Ok(())
    }

    fn write_chunk(&mut self) -> Result<()> {
        if let Some(file) = &mut self.file {
            let result = file.write_chunk();
            result.map_err(|e| self.failed("cannot write the black box", e))?;
        }
        self.tell_written();
        self.keep_reserve()
    }

    /// Ends the log in good order while the disk still has room for what matters.
    fn keep_reserve(&mut self) -> Result<()> {
        let Some(free) = self.shelf.free_bytes() else {
            return Ok(());
        };
        if free >= self.settings.reserve_bytes {
            return Ok(());
        }
        self.close_file()?;
        let (free_mb, reserve_mb) = (free / 1_000_000, self.settings.reserve_bytes / 1_000_000);
        let what =
            format!("the disk has {free_mb} MB free, and {reserve_mb} MB are kept for the dataset");
        Err(Error::new(ErrorKind::DiskFull, what)
            .at(self.settings.directory.display())
            .remedy("make room, or move the log by `black_box.directory`"))
    }

    fn begin_file(&mut self) -> Result<()> {
        self.keep_reserve()?;
        let removed = self.make_room()?;
        let output = self
            .shelf
            .create(&self.name.open())
            .map_err(|e| self.failed("cannot begin a file of the black box", e))?;
        let mut origin = self.origin.clone();
        origin.insert("part".into(), self.name.number.to_string());
        let file = LogFile::begin(output, self.queue.clock, &origin)
            .map_err(|e| self.failed("cannot begin a file of the black box", e))?;
        self.file = Some(file);
        self.progress().files += 1;
        if !removed.is_empty() {
            self.progress().removed_files += removed.len() as u64;
            let at_ns = monotonic_ns();
            let at = self.queue.clock.text(at_ns);
            let what = serde_json::json!({ "files": removed });
            let content = event(&at, "black_box_removed", &what);
            self.write(Entry { at_ns, content })?;
        }
        Ok(())
    }

    /// Removes the oldest files until another one fits; returns their names.
    fn make_room(&mut self) -> Result<Vec<String>> {
        let listed = self
            .shelf
            .list()
            .map_err(|e| self.failed("cannot use the directory of the black box", e))?;
        let mut files: Vec<_> = listed
            .into_iter()
            .filter_map(|(name, bytes)| Some((FileName::parse(&name)?, name, bytes)))
            .collect();
        files.sort();
        let mut total: u64 = files.iter().map(|(_, _, bytes)| bytes).sum();
        let room = self
            .settings
            .total_bytes
            .saturating_sub(self.settings.file_bytes);
        let mut removed = Vec::new();
        for (_, name, bytes) in files {
            if total <= room {
                break;
            }
            self.shelf
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
        self.tell_written();
        self.shelf
            .rename(&self.name.open(), &self.name.closed())
            .map_err(|e| self.failed("cannot name a file of the black box", e))?;
        Ok(())
    }

    /// All that was added is in the hands of the operating system.
    fn tell_written(&mut self) {
        let unwritten = std::mem::take(&mut self.unwritten);
        let open_bytes = self.file.as_ref().map_or(0, LogFile::bytes_on_disk);
        let mut progress = self.progress();
        progress.bytes = self.closed_bytes + open_bytes;
        for (role, frames) in unwritten {
            *progress.written.entry(role).or_default() += frames;
        }
    }

    fn progress(&self) -> MutexGuard<'_, Progress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn failed(&self, what: &str, error: std::io::Error) -> Error {
        let path = self.settings.directory.join(self.name.open());
        Error::io(what, error).at(path.display())
    }
}
