//! The crash-safe writer.
//!
//! A method that returns `Ok` has stored its result durably; one that fails leaves the previous
//! state. Each change becomes visible by one `rename`; its files are flushed before, the directory
//! after. `docs/reference/dataset-format.md` lists the state after a crash between any two
//! operations, and a test covers all of them. One file, because all changes share the order of their
//! steps.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;

use jiff::Timestamp;

use super::capture::{EncodedStage, GraspMeta, StageCapture};
use super::counts::GraspCounts;
use super::descriptor::{Descriptor, SOFTWARE};
use super::digest::FileDigest;
use super::disk::{Disk, is_partial, move_item, remove_item, replace};
use super::grasp::{GraspRecord, Outcome, OverriddenGuard, PoseRecord, StageRecord};
use super::grasp_index::GraspIndex;
use super::layout::{
    GRASP_JSON, INITIAL_JSON, Layout, METADATA_JSONL, PRE_GRASP_PREFIX, Stage, id_at,
};
use super::lock::DatasetLock;
use super::prediction::LiftVerdict;
use super::reader::load_frame;
use super::record_file::{
    PendingInitial, check_files, read_grasp, read_grasp_of, read_initial, to_json,
};
use super::schema::SCHEMA_VERSION;
use super::trash::free_slot;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName, GraspId, ObjectName};
use gripcast_imaging::{Frame, Role};

/// Grasps in [`DatasetWriter::mean_grasp_bytes`]: enough for a mean, few enough to follow a change of
/// cameras.
const MEAN_OF_GRASPS: usize = 100;

/// Writes a dataset and holds its lock.
pub struct DatasetWriter {
    pub(super) layout: Layout,
    pub(super) disk: Box<dyn Disk>,
    pub(super) descriptor: Descriptor,
    pub(super) index: GraspIndex,
    /// Revision of the index that `metadata.jsonl` has.
    pub(super) stored_revision: Option<u64>,
    log: Option<File>,
    _lock: DatasetLock,
}

impl DatasetWriter {
    /// Description of the dataset, from `dataset.toml`.
    #[must_use]
    pub fn descriptor(&self) -> &Descriptor {
        &self.descriptor
    }

    /// Directory of the dataset.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.layout.root()
    }

    /// Stores an initial frame; durable when this returns.
    ///
    /// # Errors
    /// `Input` for an invalid frame; `DiskFull`, `Io`, … with nothing changed.
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
        self.migrate()?;
        self.create_pending(&pending, |disk, dir| {
            contents
                .iter()
                .try_for_each(|(name, bytes)| disk.write(&dir.join(name), bytes))
        })?;
        Ok(pending)
    }

    /// Loads the frames of a pending initial from the disk; YUYV frames as RGB with the pixels
    /// that the sent frame decodes to.
    ///
    /// # Errors
    /// `NotFound` or `Input` when a file is missing or altered.
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

    /// Completes a pending initial frame to a grasp; durable when this returns.
    ///
    /// # Errors
    /// `NotFound` when the initial frame is missing; `Input` for an invalid frame; `DiskFull`,
    /// `Io`, … with the initial frame still pending.
    pub fn save_grasp(
        &mut self,
        pending: &PendingInitial,
        capture: &StageCapture,
        meta: GraspMeta,
    ) -> Result<GraspRecord> {
        let dir = self.layout.pending(&pending.id);
        if !dir.join(INITIAL_JSON).is_file() {
            return Err(
                Error::not_found(format!("initial frame of {} not found", pending.id))
                    .at(dir.display())
                    .remedy("check that the disk is mounted, then take the initial frame again"),
            );
        }
        let EncodedStage {
            record: stage,
            pre_grasp_frames,
            contents,
            files,
        } = capture.encode(Stage::Grasp)?;
        let record = GraspRecord {
            truth: capture.truth.as_deref().cloned(),
            pre_grasp_frames,
            pose: capture.pose.as_deref().cloned(),
            ..grasp_record(pending, stage, files, meta)
        };
        let json = to_json(&record)?;
        self.migrate()?;
        self.complete(&record.id, &contents, &json).map_err(|e| {
            self.failed("cannot save the grasp", e)
                .remedy("fix this, then trigger again: the initial frame is still saved")
        })?;
        self.insert(&record);
        Ok(record)
    }

    /// Sets or removes the label of a grasp, with the verdict in the lift when it was given. That of
    /// the first label stays: later ones see frames from after the lift.
    ///
    /// # Errors
    /// `NotFound` without that grasp; `DiskFull`, `Io`, … with the label as before.
    pub fn set_outcome(
        &mut self,
        id: &GraspId,
        outcome: Outcome,
        time: Timestamp,
        verdict: Option<LiftVerdict>,
    ) -> Result<GraspRecord> {
        self.change(id, &format!("cannot label {id}"), |record| {
            record.outcome = outcome;
            record.lift_verdict = record.lift_verdict.or(verdict);
            record.labelled_at = (outcome != Outcome::Unlabelled).then(|| time.to_string());
            Ok(())
        })
    }

    /// Stores the gripper pose of a grasp.
    ///
    /// # Errors
    /// `Input` if the stored pose was corrected by hand and this one was not; `NotFound` without
    /// that grasp; `DiskFull`, `Io`, … with the pose as before.
    pub fn set_pose(&mut self, id: &GraspId, pose: PoseRecord) -> Result<GraspRecord> {
        self.change(id, &format!("cannot annotate {id}"), |record| {
            let by_hand = record.pose.as_ref().is_some_and(|p| p.corrected_by_hand);
            if by_hand && !pose.corrected_by_hand {
                return Err(Error::input(format!(
                    "the pose of {id} was corrected by hand and is not overwritten"
                )));
            }
            record.pose = Some(pose);
            Ok(())
        })
    }

    /// Moves a pending initial frame to `trash/`.
    ///
    /// # Errors
    /// `NotFound` when it is missing; `Io`, … with nothing changed.
    pub fn discard_initial(&mut self, pending: &PendingInitial) -> Result<()> {
        let id = &pending.id;
        self.vacate_trash(id)
            .and_then(|()| {
                move_item(
                    self.disk.as_ref(),
                    &self.layout.pending(id),
                    &self.layout.trashed(id),
                )
            })
            .map_err(|e| self.failed(&format!("cannot discard the initial frame of {id}"), e))
    }

    /// Restores a discarded initial frame.
    ///
    /// # Errors
    /// `NotFound` when it is not in `trash/`; `Input` when it is damaged; `Io`, ….
    pub fn restore_initial(&mut self, id: &GraspId) -> Result<PendingInitial> {
        let trashed = self.layout.trashed(id);
        let pending = read_initial(&trashed)?;
        check_files(&trashed, &pending.files)?;
        move_item(self.disk.as_ref(), &trashed, &self.layout.pending(id))
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
        let names: BTreeSet<&FileName> = record.initial.files().collect();
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
        self.migrate()?;
        self.create_pending(&pending, |disk, to| {
            names
                .iter()
                .try_for_each(|name| link_or_copy(disk, &dir.join(name), &to.join(name)))
        })?;
        // Before this rename the grasp exists and its reopened initial frame is ignored.
        let undone = self
            .vacate_trash(id)
            .and_then(|()| move_item(self.disk.as_ref(), &dir, &self.layout.trashed(id)));
        if let Err(error) = undone {
            self.remove_pending(&pending.id);
            return Err(self.failed(&format!("cannot undo {id}"), error));
        }
        self.remove(id);
        Ok(pending)
    }

    /// Restores an undone grasp; the initial frame reopened by the undo moves to `trash/`.
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
        move_item(self.disk.as_ref(), &trashed, &self.layout.grasp(id))
            .map_err(|e| self.failed(&format!("cannot restore {id}"), e))?;
        self.insert(&record);
        if let Some(pending) = reopened {
            // It is obsolete; on failure, the next opening moves it.
            let _ = self.discard_initial(pending);
        }
        Ok(record)
    }

    /// Moves a grasp to `trash/`; [`DatasetWriter::redo_grasp`] restores it.
    ///
    /// # Errors
    /// `NotFound` without that grasp; `Io`, … with the grasp as before.
    pub fn trash_grasp(&mut self, id: &GraspId) -> Result<GraspRecord> {
        let record = self.read(id)?;
        self.vacate_trash(id)
            .and_then(|()| {
                move_item(
                    self.disk.as_ref(),
                    &self.layout.grasp(id),
                    &self.layout.trashed(id),
                )
            })
            .map_err(|e| self.failed(&format!("cannot move {id} to the trash"), e))?;
        self.remove(id);
        Ok(record)
    }

    /// Current number of grasps.
    #[must_use]
    pub fn counts(&self) -> GraspCounts {
        self.index.counts()
    }

    /// Number of grasps.
    #[must_use]
    pub fn grasps(&self) -> usize {
        self.index.len()
    }

    /// Object and outcome of an existing grasp.
    #[must_use]
    pub fn outcome(&self, id: &GraspId) -> Option<(ObjectName, Outcome)> {
        let row = self.index.get(id)?;
        Some((row.object.clone(), row.outcome))
    }

    /// Mean size of the newest hundred grasps, bytes; `None` without grasps.
    #[must_use]
    pub fn mean_grasp_bytes(&self) -> Option<u64> {
        let newest = self.index.newest(None, MEAN_OF_GRASPS, |_| true);
        let bytes: u64 = newest.iter().map(|(_, row)| row.bytes).sum();
        bytes
            .checked_div(newest.len() as u64)
            .filter(|mean| *mean > 0)
    }

    /// Free space for this user on the dataset's disk, bytes.
    ///
    /// # Errors
    /// `NotFound` when the dataset is missing, `Io`, ….
    pub fn free_bytes(&self) -> Result<u64> {
        let stat = rustix::fs::statvfs(self.layout.root())
            .map_err(|e| self.failed("cannot query the free space", e.into()))?;
        Ok(stat.f_bavail.saturating_mul(stat.f_frsize))
    }

    /// Appends a line to this session's file in `logs/`. Not flushed: a log holds no grasps.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, ….
    pub fn log_event(&mut self, event: &serde_json::Value) -> Result<()> {
        let result = self.log_file().and_then(|mut file| {
            // One write, so that lines are complete even if the process is killed.
            file.write_all(format!("{event}\n").as_bytes())
        });
        result.map_err(|e| self.failed("cannot write the log", e))
    }

    /// Writes `metadata.jsonl` if it is out of date. Grasps are safe without it; call it after a
    /// save was acknowledged.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, … with the old index in place.
    pub fn flush_index(&mut self) -> Result<()> {
        if self.stored_revision == Some(self.index.revision()) {
            return Ok(());
        }
        let (revision, text) = self.index.to_jsonl();
        replace(
            self.disk.as_ref(),
            &self.layout.top(),
            METADATA_JSONL,
            text.as_bytes(),
        )
        .map_err(|e| self.failed("cannot write the index", e))?;
        self.stored_revision = Some(revision);
        Ok(())
    }
}

impl DatasetWriter {
    pub(super) fn new(
        layout: Layout,
        disk: Box<dyn Disk>,
        lock: DatasetLock,
        descriptor: Descriptor,
        index: GraspIndex,
    ) -> Self {
        Self {
            layout,
            disk,
            descriptor,
            index,
            stored_revision: None,
            log: None,
            _lock: lock,
        }
    }

    pub(super) fn failed(&self, what: &str, error: io::Error) -> Error {
        self.layout.failed(what, error)
    }

    fn insert(&mut self, record: &GraspRecord) {
        self.index.insert(record);
    }

    fn remove(&mut self, id: &GraspId) {
        self.index.remove(id);
    }

    pub(super) fn read(&self, id: &GraspId) -> Result<GraspRecord> {
        read_grasp_of(&self.layout, id).map_err(|e| {
            if e.kind() == ErrorKind::NotFound {
                Error::not_found(format!("grasp {id} not found"))
                    .at(self.layout.root().display())
                    .remedy("it was undone or moved, or the disk is no longer mounted")
            } else {
                e
            }
        })
    }

    /// Replaces the record of a grasp; `what` is the beginning of the error.
    pub(super) fn change(
        &mut self,
        id: &GraspId,
        what: &str,
        change: impl FnOnce(&mut GraspRecord) -> Result<()>,
    ) -> Result<GraspRecord> {
        let dir = self.layout.grasp(id);
        let before = self.read(id)?;
        let mut record = before.clone();
        change(&mut record)?;
        record.schema = SCHEMA_VERSION;
        self.migrate()?;
        let json = to_json(&record)?;
        if let Err(error) = replace(self.disk.as_ref(), &dir, GRASP_JSON, &json) {
            // The rename may have succeeded before the flush of the directory failed.
            let _ = replace(self.disk.as_ref(), &dir, GRASP_JSON, &to_json(&before)?);
            return Err(self.failed(what, error));
        }
        self.insert(&record);
        Ok(record)
    }

    fn free_id(&self, time: Timestamp) -> GraspId {
        let is_free = |id: &GraspId| {
            let layout = &self.layout;
            let dirs = [layout.grasp(id), layout.pending(id), layout.trashed(id)];
            !dirs.iter().any(BeneathPath::is_taken)
        };
        let mut offset = 0;
        loop {
            let id = id_at(time, offset);
            if is_free(&id) {
                return id;
            }
            offset += 1;
        }
    }

    /// Creates the directory of a pending initial frame; `fill` adds the image files.
    fn create_pending(
        &self,
        pending: &PendingInitial,
        fill: impl FnOnce(&dyn Disk, &BeneathPath) -> io::Result<()>,
    ) -> Result<()> {
        let json = to_json(pending)?;
        let dir = self.layout.pending(&pending.id);
        let disk = self.disk.as_ref();
        let created = disk
            .create_dir(&dir)
            .and_then(|()| fill(disk, &dir))
            .and_then(|()| replace(disk, &dir, INITIAL_JSON, &json))
            .and_then(|()| disk.sync_dir(&self.layout.grasps()));
        created.map_err(|e| {
            self.remove_pending(&pending.id);
            self.failed("cannot save the initial frame", e)
        })
    }

    /// Removes a pending directory that was not acknowledged. Without its record, the next opening
    /// moves the rest to `trash/`.
    fn remove_pending(&self, id: &GraspId) {
        let dir = self.layout.pending(id);
        let _ = self.disk.remove_file(&dir.join(INITIAL_JSON));
        remove_item(self.disk.as_ref(), &dir);
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
        // The grasp's record holds both stages; the next opening removes a leftover.
        let _ = disk.remove_file(&grasp.join(INITIAL_JSON));
        Ok(())
    }

    /// Renames an existing `trash/<id>`.
    fn vacate_trash(&self, id: &GraspId) -> io::Result<()> {
        let slot = self.layout.trashed(id);
        if !slot.is_taken() {
            return Ok(());
        }
        self.disk.rename_new(&slot, &free_slot(&self.layout, id))
    }

    fn log_file(&mut self) -> io::Result<&File> {
        if self.log.is_none() {
            let name = Timestamp::now().strftime("%Y-%m-%dT%H-%M-%SZ");
            let name = FileName::from_words(&[&name.to_string(), "jsonl"]);
            self.log = Some(self.layout.logs().join(name).append()?);
        }
        self.log
            .as_ref()
            .ok_or_else(|| io::ErrorKind::NotFound.into())
    }
}

impl Drop for DatasetWriter {
    fn drop(&mut self) {
        // The next opening rewrites a stale index from the records.
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
        outcome: meta.outcome,
        labelled_at: (meta.outcome != Outcome::Unlabelled).then(|| stage.captured_at.clone()),
        initial: pending.stage.clone(),
        grasp: stage,
        pre_grasp_frames: Vec::new(),
        pose: None,
        boards: meta.boards,
        prediction: meta.prediction,
        overridden_guards,
        calibration: meta.calibration,
        lift: None,
        lift_verdict: None,
        files,
        note: meta.note,
        truth: None,
    }
}

/// Removes leftovers of an earlier attempt at the grasp from a pending directory, the record
/// first: without it the rest counts as incomplete.
fn remove_grasp_files(disk: &dyn Disk, pending: &BeneathPath) -> io::Result<()> {
    let record = pending.join(GRASP_JSON);
    if record.is_taken() {
        disk.remove_file(&record)?;
    }
    for entry in pending.entries()? {
        let name = entry.name();
        let of_grasp = name.starts_with("grasp.") || name.starts_with(PRE_GRASP_PREFIX);
        if of_grasp || is_partial(&name) {
            disk.remove_file(&entry)?;
        }
    }
    Ok(())
}

fn link_or_copy(disk: &dyn Disk, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
    // A hard link to a symbolic link would be another symbolic link.
    if from.is_link() {
        return disk.write(to, &from.read(FileKind::Image)?);
    }
    match disk.link(from, to) {
        // Some file systems do not support links.
        Err(e) if e.kind() != io::ErrorKind::NotFound => {
            disk.write(to, &from.read(FileKind::Image)?)
        }
        other => other,
    }
}
