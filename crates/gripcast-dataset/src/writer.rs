//! The crash-safe writer.
//!
//! A method that returns `Ok` has its result on the disk, whatever happens next; one that fails
//! leaves what was there before. Each change becomes visible by one `rename`; everything it needs
//! is forced to the disk before, and the directory after. `docs/dataset-format.md` lists what a
//! crash between any two operations leaves, and a test goes through all of them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;

use jiff::Timestamp;

use super::capture::{EncodedStage, GraspMeta, StageCapture};
use super::counts::GraspCounts;
use super::descriptor::{Descriptor, SOFTWARE};
use super::digest::FileDigest;
use super::disk::{Disk, is_partial, replace};
use super::grasp::{GraspRecord, Outcome, OverriddenGuard, PoseRecord, StageRecord};
use super::index::{IndexRow, to_jsonl};
use super::layout::{
    APPROACH_PREFIX, GRASP_JSON, INITIAL_JSON, Layout, METADATA_JSONL, Stage, id_at,
};
use super::lock::DatasetLock;
use super::reader::load_frame;
use super::record_file::{PendingInitial, check_files, read_grasp, read_initial, to_json};
use super::schema::SCHEMA_VERSION;
use super::trash::free_slot;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName, GraspId};
use gripcast_imaging::{Frame, Role};

/// Writes a dataset; holds its lock.
pub struct DatasetWriter {
    pub(super) layout: Layout,
    pub(super) disk: Box<dyn Disk>,
    pub(super) descriptor: Descriptor,
    pub(super) rows: BTreeMap<GraspId, IndexRow>,
    pub(super) index_is_stale: bool,
    log: Option<File>,
    _lock: DatasetLock,
}

impl DatasetWriter {
    /// What the dataset says about itself.
    #[must_use]
    pub fn descriptor(&self) -> &Descriptor {
        &self.descriptor
    }

    /// Where the dataset is.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.layout.root()
    }

    /// Stores an initial frame; durable when this returns.
    ///
    /// # Errors
    /// `Input` for a frame that is not what it says; `DiskFull`, `Io`, … with nothing changed.
    pub fn save_initial(
        &mut self,
        capture: &StageCapture,
        overridden_guards: Vec<OverriddenGuard>,
    ) -> Result<PendingInitial> {
        let EncodedStage {
            record,
            contents,
            files,
            ..
        } = capture.encode(Stage::Initial)?;
        let pending = PendingInitial {
            schema: SCHEMA_VERSION,
            id: self.free_id(capture.captured_at),
            software: SOFTWARE.to_owned(),
            stage: record,
            overridden_guards,
            files,
            reopened_from: None,
        };
        self.make_pending(&pending, |disk, dir| {
            contents
                .iter()
                .try_for_each(|(name, bytes)| disk.write(&dir.join(name), bytes))
        })?;
        Ok(pending)
    }

    /// The frames of a pending initial, read back from the disk; YUYV frames as RGB, with exactly
    /// the pixels that the frame as sent decodes to.
    ///
    /// # Errors
    /// `NotFound` or `Input` when a file is missing or not what was stored.
    pub fn pending_frames(&self, pending: &PendingInitial) -> Result<BTreeMap<Role, Frame>> {
        let dir = self.layout.pending(&pending.id);
        check_files(&dir, &pending.files)?;
        pending
            .stage
            .cameras
            .iter()
            .map(|(&role, camera)| Ok((role, load_frame(&dir, camera)?)))
            .collect()
    }

    /// Completes a pending initial to a grasp; whole and durable when this returns.
    ///
    /// # Errors
    /// `NotFound` when the initial frame has gone; `Input` for a frame that is not what it says;
    /// `DiskFull`, `Io`, … after which the initial frame is pending as before.
    pub fn save_grasp(
        &mut self,
        pending: &PendingInitial,
        capture: &StageCapture,
        meta: GraspMeta,
    ) -> Result<GraspRecord> {
        let dir = self.layout.pending(&pending.id);
        if !dir.join(INITIAL_JSON).is_file() {
            return Err(Error::not_found(format!(
                "the initial frame of {} is no longer there",
                pending.id
            ))
            .at(dir.display())
            .remedy("check that the disk is still there, then take the initial frame again"));
        }
        let EncodedStage {
            record: stage,
            approach,
            contents,
            files,
        } = capture.encode(Stage::Grasp)?;
        let record = GraspRecord {
            truth: capture.truth.as_deref().cloned(),
            approach,
            pose: capture.pose.as_deref().cloned(),
            ..grasp_record(pending, stage, files, meta)
        };
        let json = to_json(&record)?;
        self.complete(&record.id, &contents, &json).map_err(|e| {
            self.failed("cannot save the grasp", e)
                .remedy("fix that, then trigger again: the initial frame is still saved")
        })?;
        self.insert(&record);
        Ok(record)
    }

    /// Labels a grasp, or takes its label back.
    ///
    /// # Errors
    /// `NotFound` without that grasp; `DiskFull`, `Io`, … with the label as before.
    pub fn set_outcome(
        &mut self,
        id: &GraspId,
        outcome: Outcome,
        at: Timestamp,
    ) -> Result<GraspRecord> {
        self.change(id, &format!("cannot label {id}"), |record| {
            record.outcome = outcome;
            record.labelled_at = (outcome != Outcome::Unlabelled).then(|| at.to_string());
            Ok(())
        })
    }

    /// Writes down where the gripper was.
    ///
    /// # Errors
    /// `Input` if a person has corrected the pose that is there and this one is not by hand;
    /// `NotFound` without that grasp; `DiskFull`, `Io`, … with the pose as before.
    pub fn set_pose(&mut self, id: &GraspId, pose: PoseRecord) -> Result<GraspRecord> {
        self.change(id, &format!("cannot annotate {id}"), |record| {
            let by_hand = record.pose.as_ref().is_some_and(|p| p.corrected_by_hand);
            if by_hand && !pose.corrected_by_hand {
                return Err(Error::input(format!(
                    "the pose of {id} was corrected by hand and is kept"
                )));
            }
            record.pose = Some(pose);
            Ok(())
        })
    }

    /// Moves a pending initial to `trash/`.
    ///
    /// # Errors
    /// `NotFound` when it has gone; `Io`, … with nothing changed.
    pub fn discard_initial(&mut self, pending: &PendingInitial) -> Result<()> {
        let id = &pending.id;
        self.vacate_trash(id)
            .and_then(|()| self.move_dir(&self.layout.pending(id), &self.layout.trashed(id)))
            .map_err(|e| self.failed(&format!("cannot discard the initial frame of {id}"), e))
    }

    /// Brings a discarded initial frame back.
    ///
    /// # Errors
    /// `NotFound` when it is not in `trash/`; `Input` when it is damaged; `Io`, ….
    pub fn restore_initial(&mut self, id: &GraspId) -> Result<PendingInitial> {
        let trashed = self.layout.trashed(id);
        let pending = read_initial(&trashed)?;
        check_files(&trashed, &pending.files)?;
        self.move_dir(&trashed, &self.layout.pending(id))
            .map_err(|e| self.failed(&format!("cannot restore the initial frame of {id}"), e))?;
        Ok(pending)
    }

    /// Moves a grasp to `trash/` and makes its initial frame pending again, under a new id.
    ///
    /// # Errors
    /// `NotFound` without that grasp; `DiskFull`, `Io`, … with the grasp as before.
    pub fn undo_grasp(&mut self, id: &GraspId) -> Result<PendingInitial> {
        let record = self.read(id)?;
        let dir = self.layout.grasp(id);
        let captured_at = record.initial.captured_at.parse().unwrap_or_default();
        let names: BTreeSet<&FileName> = record.initial.cameras.values().map(|c| &c.file).collect();
        let pending = PendingInitial {
            schema: SCHEMA_VERSION,
            id: self.free_id(captured_at),
            software: SOFTWARE.to_owned(),
            overridden_guards: record
                .overridden_guards
                .iter()
                .filter(|guard| guard.stage == Stage::Initial.name())
                .cloned()
                .collect(),
            files: record
                .files
                .iter()
                .filter(|(name, _)| names.contains(name))
                .map(|(name, digest)| (name.clone(), digest.clone()))
                .collect(),
            stage: record.initial.clone(),
            reopened_from: Some(id.clone()),
        };
        self.make_pending(&pending, |disk, to| {
            names
                .iter()
                .try_for_each(|name| link_or_copy(disk, &dir.join(name), &to.join(name)))
        })?;
        // Until this rename the grasp is there and its reopened initial frame does not count.
        let undone = self
            .vacate_trash(id)
            .and_then(|()| self.move_dir(&dir, &self.layout.trashed(id)));
        if let Err(error) = undone {
            self.remove_pending(&pending.id);
            return Err(self.failed(&format!("cannot undo {id}"), error));
        }
        self.remove(id);
        Ok(pending)
    }

    /// Brings an undone grasp back; the initial frame that undoing it reopened moves to `trash/`.
    ///
    /// # Errors
    /// `NotFound` when it is not in `trash/`; `Input` when it is damaged; `Io`, ….
    pub fn redo_grasp(
        &mut self,
        id: &GraspId,
        reopened: Option<&PendingInitial>,
    ) -> Result<GraspRecord> {
        let trashed = self.layout.trashed(id);
        let record = read_grasp(&trashed)?;
        check_files(&trashed, &record.files)?;
        self.move_dir(&trashed, &self.layout.grasp(id))
            .map_err(|e| self.failed(&format!("cannot bring {id} back"), e))?;
        self.insert(&record);
        if let Some(pending) = reopened {
            // It no longer counts, now that its grasp is back; the next opening would clear it.
            let _ = self.discard_initial(pending);
        }
        Ok(record)
    }

    /// Moves a grasp to `trash/`; [`DatasetWriter::redo_grasp`] brings it back.
    ///
    /// # Errors
    /// `NotFound` without that grasp; `Io`, … with the grasp as before.
    pub fn trash_grasp(&mut self, id: &GraspId) -> Result<GraspRecord> {
        let record = self.read(id)?;
        self.vacate_trash(id)
            .and_then(|()| self.move_dir(&self.layout.grasp(id), &self.layout.trashed(id)))
            .map_err(|e| self.failed(&format!("cannot move {id} to the trash"), e))?;
        self.remove(id);
        Ok(record)
    }

    /// Grasps that are there now.
    #[must_use]
    pub fn counts(&self) -> GraspCounts {
        let mut counts = GraspCounts::default();
        for row in self.rows.values() {
            counts.add(&row.object, row.outcome);
        }
        counts
    }

    /// Object and outcome of a grasp that is there.
    #[must_use]
    pub fn outcome(&self, id: &GraspId) -> Option<(&str, Outcome)> {
        let row = self.rows.get(id)?;
        Some((&row.object, row.outcome))
    }

    /// Space left for this user on the dataset's disk, bytes.
    ///
    /// # Errors
    /// `NotFound` when the dataset has gone, `Io`, ….
    pub fn free_bytes(&self) -> Result<u64> {
        let stat = rustix::fs::statvfs(self.layout.root())
            .map_err(|e| self.failed("cannot ask for the free space", e.into()))?;
        Ok(stat.f_bavail.saturating_mul(stat.f_frsize))
    }

    /// Appends a line to this session's file in `logs/`. Not forced to the disk: a log explains
    /// grasps, it does not hold any.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, ….
    pub fn log_event(&mut self, event: &serde_json::Value) -> Result<()> {
        let result = self.log_file().and_then(|mut file| {
            // One write, so that lines of a killed process are whole.
            file.write_all(format!("{event}\n").as_bytes())
        });
        result.map_err(|e| self.failed("cannot write the log", e))
    }

    /// Writes `metadata.jsonl` if it is not up to date. Grasps are safe without it; call it after
    /// a save was acknowledged.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, … with the old index in place.
    pub fn flush_index(&mut self) -> Result<()> {
        if !self.index_is_stale {
            return Ok(());
        }
        let text = to_jsonl(&self.rows);
        replace(
            self.disk.as_ref(),
            &self.layout.top(),
            METADATA_JSONL,
            text.as_bytes(),
        )
        .map_err(|e| self.failed("cannot write the index", e))?;
        self.index_is_stale = false;
        Ok(())
    }
}

impl DatasetWriter {
    pub(super) fn new(
        layout: Layout,
        disk: Box<dyn Disk>,
        lock: DatasetLock,
        descriptor: Descriptor,
    ) -> Self {
        Self {
            layout,
            disk,
            descriptor,
            rows: BTreeMap::new(),
            index_is_stale: false,
            log: None,
            _lock: lock,
        }
    }

    pub(super) fn failed(&self, what: &str, error: io::Error) -> Error {
        self.layout.failed(what, error)
    }

    fn insert(&mut self, record: &GraspRecord) {
        self.rows.insert(record.id.clone(), IndexRow::of(record));
        self.index_is_stale = true;
    }

    fn remove(&mut self, id: &GraspId) {
        self.rows.remove(id);
        self.index_is_stale = true;
    }

    fn read(&self, id: &GraspId) -> Result<GraspRecord> {
        read_grasp(&self.layout.grasp(id)).map_err(|e| {
            if e.kind() == ErrorKind::NotFound {
                Error::not_found(format!("there is no grasp {id}"))
                    .at(self.layout.root().display())
                    .remedy("it was undone or moved away, or the disk has gone")
            } else {
                e
            }
        })
    }

    /// Replaces the record of a grasp; `what` begins the error.
    fn change(
        &mut self,
        id: &GraspId,
        what: &str,
        change: impl FnOnce(&mut GraspRecord) -> Result<()>,
    ) -> Result<GraspRecord> {
        let dir = self.layout.grasp(id);
        let before = self.read(id)?;
        let mut record = before.clone();
        change(&mut record)?;
        let json = to_json(&record)?;
        if let Err(error) = replace(self.disk.as_ref(), &dir, GRASP_JSON, &json) {
            // The rename may have happened before the directory could not be flushed.
            let _ = replace(self.disk.as_ref(), &dir, GRASP_JSON, &to_json(&before)?);
            return Err(self.failed(what, error));
        }
        self.insert(&record);
        Ok(record)
    }

    fn free_id(&self, at: Timestamp) -> GraspId {
        let is_free = |id: &GraspId| {
            let layout = &self.layout;
            let places = [layout.grasp(id), layout.pending(id), layout.trashed(id)];
            !places.iter().any(BeneathPath::is_taken)
        };
        let mut later = 0;
        loop {
            let id = id_at(at, later);
            if is_free(&id) {
                return id;
            }
            later += 1;
        }
    }

    /// Makes the directory of a pending initial; `fill` puts the image files there.
    fn make_pending(
        &self,
        pending: &PendingInitial,
        fill: impl FnOnce(&dyn Disk, &BeneathPath) -> io::Result<()>,
    ) -> Result<()> {
        let json = to_json(pending)?;
        let dir = self.layout.pending(&pending.id);
        let disk = self.disk.as_ref();
        let made = disk
            .create_dir(&dir)
            .and_then(|()| fill(disk, &dir))
            .and_then(|()| replace(disk, &dir, INITIAL_JSON, &json))
            .and_then(|()| disk.sync_dir(&self.layout.grasps()));
        made.map_err(|e| {
            self.remove_pending(&pending.id);
            self.failed("cannot save the initial frame", e)
        })
    }

    /// Takes back a pending directory that was not acknowledged. What cannot be removed lacks its
    /// record, and the next opening sets it aside.
    fn remove_pending(&self, id: &GraspId) {
        let dir = self.layout.pending(id);
        let _ = self.disk.remove_file(&dir.join(INITIAL_JSON));
        for entry in dir.entries().into_iter().flatten() {
            let _ = self.disk.remove_file(&entry);
        }
        let _ = self.disk.remove_dir(&dir);
    }

    /// Writes the grasp's files beside the initial frame and renames the directory.
    fn complete(
        &self,
        id: &GraspId,
        contents: &BTreeMap<FileName, Vec<u8>>,
        json: &[u8],
    ) -> io::Result<()> {
        let disk = self.disk.as_ref();
        let pending = self.layout.pending(id);
        let grasp = self.layout.grasp(id);
        let written = remove_grasp_files(disk, &pending)
            .and_then(|()| {
                contents
                    .iter()
                    .try_for_each(|(name, bytes)| disk.write(&pending.join(name), bytes))
            })
            .and_then(|()| replace(disk, &pending, GRASP_JSON, json))
            .and_then(|()| disk.rename_new(&pending, &grasp))
            .and_then(|()| {
                disk.sync_dir(&self.layout.grasps()).inspect_err(|_| {
                    let _ = disk.rename_new(&grasp, &pending);
                })
            });
        if let Err(error) = written {
            let _ = remove_grasp_files(disk, &pending);
            return Err(error);
        }
        // The grasp's own record holds both stages now; a leftover is cleared at the next opening.
        let _ = disk.remove_file(&grasp.join(INITIAL_JSON));
        Ok(())
    }

    /// Frees `trash/<id>`.
    fn vacate_trash(&self, id: &GraspId) -> io::Result<()> {
        let place = self.layout.trashed(id);
        if !place.is_taken() {
            return Ok(());
        }
        self.disk.rename_new(&place, &free_slot(&self.layout, id))
    }

    /// Renames a directory between `grasps/` and `trash/`, durably.
    fn move_dir(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
        let disk = self.disk.as_ref();
        disk.rename_new(from, to)?;
        // The new name first: a crash between the two may leave both names, never none.
        let synced = [to, from]
            .into_iter()
            .try_for_each(|place| disk.sync_dir(&place.parent()));
        synced.inspect_err(|_| {
            let _ = disk.rename_new(to, from);
        })
    }

    fn log_file(&mut self) -> io::Result<&File> {
        if self.log.is_none() {
            let name = Timestamp::now().strftime("%Y-%m-%dT%H-%M-%SZ");
            let name = FileName::of_words(&[&name.to_string(), "jsonl"]);
            self.log = Some(self.layout.logs().join(name).append()?);
        }
        self.log
            .as_ref()
            .ok_or_else(|| io::ErrorKind::NotFound.into())
    }
}

impl Drop for DatasetWriter {
    fn drop(&mut self) {
        // The records hold everything; a stale index is renewed at the next opening.
        let _ = self.flush_index();
    }
}

fn grasp_record(
    pending: &PendingInitial,
    stage: StageRecord,
    grasp_files: BTreeMap<FileName, FileDigest>,
    meta: GraspMeta,
) -> GraspRecord {
    let mut files = pending.files.clone();
    files.extend(grasp_files);
    let mut overridden_guards = pending.overridden_guards.clone();
    overridden_guards.extend(meta.overridden_guards);
    GraspRecord {
        schema: SCHEMA_VERSION,
        id: pending.id.clone(),
        object: meta.object,
        scene: meta.scene,
        operator: meta.operator,
        rig: meta.rig,
        software: SOFTWARE.to_owned(),
        outcome: Outcome::Unlabelled,
        labelled_at: None,
        initial: pending.stage.clone(),
        grasp: stage,
        approach: Vec::new(),
        pose: None,
        boards: meta.boards,
        prediction: meta.prediction,
        overridden_guards,
        calibration: meta.calibration,
        files,
        note: meta.note,
        truth: None,
    }
}

/// Removes what an earlier attempt at the grasp left in a pending directory, the record first:
/// without it the rest is known to be incomplete.
fn remove_grasp_files(disk: &dyn Disk, pending: &BeneathPath) -> io::Result<()> {
    let record = pending.join(GRASP_JSON);
    if record.is_taken() {
        disk.remove_file(&record)?;
    }
    for entry in pending.entries()? {
        let name = entry.name();
        let of_grasp = name.starts_with("grasp.") || name.starts_with(APPROACH_PREFIX);
        if of_grasp || is_partial(&name) {
            disk.remove_file(&entry)?;
        }
    }
    Ok(())
}

fn link_or_copy(disk: &dyn Disk, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
    // A second name of a symbolic link would be another link.
    if from.is_link() {
        return disk.write(to, &from.read(FileKind::Image)?);
    }
    match disk.link(from, to) {
        // Some file systems know no links.
        Err(e) if e.kind() != io::ErrorKind::NotFound => {
            disk.write(to, &from.read(FileKind::Image)?)
        }
        other => other,
    }
}
