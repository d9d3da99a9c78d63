//! Injects a fault of the process, the power or the disk into every file operation of a whole
//! session.
//!
//! Longer than 600 lines: the disk that injects the faults is part of every test.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};

use super::disk::{Disk, SystemDisk, is_partial};
use super::grasp_index::GraspIndex;
use super::layout::Layout;
use super::reader::Dataset;
use super::sample::{capture_with_fields as capture, lift, meta, new_dataset};
use super::verify::verify;
use super::writer::DatasetWriter;
use super::{GraspId, GraspRecord, NameChange, Outcome, PendingInitial};
use gripcast_base::error::{ErrorKind, Result};
use gripcast_base::files::{BeneathPath, ContentKey, Label, ObjectName};

/// Fault at the chosen operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    /// The process is killed; its changes remain.
    Kill,
    /// The power fails; names that were not flushed are lost, or the later half of
    /// them.
    PowerLoss { all: bool },
    /// The operation fails with a full disk, the next ones succeed.
    FullOnce,
    /// The disk is full from this operation on; renaming and removing still work.
    Full,
    /// The disk is unplugged from this operation on.
    Unplugged,
}

/// How to revert a change that was not flushed.
enum Revert {
    RemoveFile(PathBuf),
    RemoveDir(PathBuf),
    RestoreFile(PathBuf, Vec<u8>),
    RestoreDir(PathBuf),
    Rename {
        from: PathBuf,
        to: PathBuf,
        replaced: Option<Vec<u8>>,
    },
}

struct Change {
    /// Directories that must still be flushed.
    unflushed: BTreeSet<PathBuf>,
    revert: Revert,
}

struct State {
    /// `grasps/` and `trash/` are on different disks.
    two_disks: bool,
    /// Operations so far.
    count: usize,
    at: usize,
    fault: Option<Fault>,
    struck: bool,
    changes: Vec<Change>,
}

/// A disk that fails at one operation. Files are real; flushing is only recorded.
#[derive(Clone)]
struct FailingDisk(Arc<Mutex<State>>);

impl FailingDisk {
    fn new(at: usize, fault: Option<Fault>) -> Self {
        Self(Arc::new(Mutex::new(State {
            two_disks: false,
            count: 0,
            at,
            fault,
            struck: false,
            changes: Vec::new(),
        })))
    }

    /// As [`new`](Self::new), with `trash/` on another disk than `grasps/`.
    fn with_two_disks(at: usize, fault: Option<Fault>) -> Self {
        let disk = Self::new(at, fault);
        disk.state().two_disks = true;
        disk
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap()
    }

    fn count(&self) -> usize {
        self.state().count
    }

    /// Counts an operation; fails if the fault says so. `grows`: it needs space.
    fn step(&self, grows: bool) -> io::Result<()> {
        let mut state = self.state();
        let number = state.count;
        state.count += 1;
        let Some(fault) = state.fault else {
            return Ok(());
        };
        let fails = match fault {
            Fault::Kill | Fault::PowerLoss { .. } | Fault::Unplugged => number >= state.at,
            Fault::FullOnce => number == state.at,
            Fault::Full => number >= state.at && grows,
        };
        if !fails {
            return Ok(());
        }
        state.struck = true;
        Err(match fault {
            Fault::FullOnce | Fault::Full => io::ErrorKind::StorageFull.into(),
            _ => io::Error::other("the disk is unplugged"),
        })
    }

    fn note(&self, paths: &[&Path], revert: Revert) {
        let unflushed = paths
            .iter()
            .map(|path| path.parent().unwrap().to_owned())
            .collect();
        self.state().changes.push(Change { unflushed, revert });
    }

    /// Records a rename; directories below `from` get their new names.
    fn note_rename(&self, from: &Path, to: &Path, replaced: Option<Vec<u8>>) {
        for change in &mut self.state().changes {
            let names = std::mem::take(&mut change.unflushed);
            change.unflushed = names
                .into_iter()
                .map(|name| moved(&name, from, to))
                .collect();
        }
        let revert = Revert::Rename {
            from: from.to_owned(),
            to: to.to_owned(),
            replaced,
        };
        self.note(&[from, to], revert);
    }

    /// Simulates a power failure: loses all names that were not flushed, or the later half.
    fn lose_power(&self, all: bool) {
        let changes = std::mem::take(&mut self.state().changes);
        let unflushed = changes.iter().filter(|c| !c.unflushed.is_empty()).count();
        let mut to_lose = if all {
            unflushed
        } else {
            unflushed.div_ceil(2)
        };
        let mut kept_renames: Vec<(PathBuf, PathBuf)> = Vec::new();
        for change in changes.into_iter().rev() {
            if change.unflushed.is_empty() || to_lose == 0 {
                if let Revert::Rename { from, to, .. } = change.revert {
                    kept_renames.push((from, to));
                }
                continue;
            }
            to_lose -= 1;
            change.revert.run(|path| {
                kept_renames
                    .iter()
                    .rev()
                    .fold(path, |path, (from, to)| moved(&path, from, to))
            });
        }
    }
}

/// Path of `path` after a rename of `from` to `to`.
fn moved(path: &Path, from: &Path, to: &Path) -> PathBuf {
    match path.strip_prefix(from) {
        Ok(rest) if rest.as_os_str().is_empty() => to.to_owned(),
        Ok(rest) => to.join(rest),
        Err(_) => path.to_owned(),
    }
}

impl Revert {
    /// `now`: maps an old path to the current one.
    fn run(self, now: impl Fn(PathBuf) -> PathBuf) {
        match self {
            Self::RemoveFile(path) => fs::remove_file(now(path)).unwrap(),
            Self::RemoveDir(path) => fs::remove_dir_all(now(path)).unwrap(),
            Self::RestoreFile(path, bytes) => {
                let path = now(path);
                // Otherwise the removal of its directory was flushed.
                if path.parent().is_some_and(Path::is_dir) {
                    fs::write(path, bytes).unwrap();
                }
            }
            Self::RestoreDir(path) => fs::create_dir(now(path)).unwrap(),
            Self::Rename { from, to, replaced } => {
                let to = now(to);
                fs::rename(&to, now(from)).unwrap();
                if let Some(bytes) = replaced {
                    fs::write(to, bytes).unwrap();
                }
            }
        }
    }
}

impl Disk for FailingDisk {
    fn create_dir(&self, path: &BeneathPath) -> io::Result<()> {
        self.step(true)?;
        let path = &path.shown();
        fs::create_dir(path)?;
        self.note(&[path], Revert::RemoveDir(path.to_owned()));
        Ok(())
    }

    fn write(&self, path: &BeneathPath, bytes: &[u8]) -> io::Result<()> {
        self.step(true)?;
        let path = &path.shown();
        let is_new = !path.exists();
        fs::write(path, &bytes[..bytes.len() / 2])?;
        if is_new {
            self.note(&[path], Revert::RemoveFile(path.to_owned()));
        }
        // The disk is full or the process killed in the middle of the file.
        self.step(true)?;
        fs::write(path, bytes)?;
        // The flush: before it the contents are not durable.
        self.step(true).inspect_err(|_| {
            if matches!(self.state().fault, Some(Fault::PowerLoss { .. })) {
                fs::write(path, vec![0; bytes.len()]).unwrap();
            }
        })
    }

    fn link(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
        self.step(true)?;
        let (from, to) = (&from.shown(), &to.shown());
        fs::hard_link(from, to)?;
        self.note(&[to], Revert::RemoveFile(to.to_owned()));
        Ok(())
    }

    fn rename(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
        self.step(false)?;
        let (from, to) = (&from.shown(), &to.shown());
        let replaced = fs::read(to).ok();
        fs::rename(from, to)?;
        self.note_rename(from, to, replaced);
        Ok(())
    }

    fn rename_new(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
        self.step(false)?;
        if self.state().two_disks && from.parent() != to.parent() {
            return Err(io::ErrorKind::CrossesDevices.into());
        }
        SystemDisk.rename_new(from, to)?;
        self.note_rename(&from.shown(), &to.shown(), None);
        Ok(())
    }

    fn remove_file(&self, path: &BeneathPath) -> io::Result<()> {
        self.step(false)?;
        let path = &path.shown();
        let bytes = fs::read(path)?;
        fs::remove_file(path)?;
        self.note(&[path], Revert::RestoreFile(path.to_owned(), bytes));
        Ok(())
    }

    fn remove_dir(&self, path: &BeneathPath) -> io::Result<()> {
        self.step(false)?;
        let path = &path.shown();
        fs::remove_dir(path)?;
        self.note(&[path], Revert::RestoreDir(path.to_owned()));
        Ok(())
    }

    fn sync_dir(&self, path: &BeneathPath) -> io::Result<()> {
        self.step(false)?;
        for change in &mut self.state().changes {
            change.unflushed.remove(&path.shown());
        }
        Ok(())
    }
}

/// Object, scene and outcome of a grasp, and its number of lift frames.
type Labelled = (ObjectName, Label, Outcome, usize);

/// A folder in memory where there is one: crashes are simulated, and waiting for a disk at each
/// operation takes five times as long.
fn memory_folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").unwrap_or_else(|_| tempfile::tempdir().unwrap())
}

fn labelled(record: GraspRecord) -> Labelled {
    let lift = record.lift.iter().flat_map(|lift| lift.cameras.values());
    let frames = lift.map(|camera| camera.frames.len()).sum();
    (record.object, record.scene, record.outcome, frames)
}

/// State acknowledged to the operator.
#[derive(Clone, Debug, Default, PartialEq)]
struct Acknowledged {
    grasps: BTreeMap<GraspId, Labelled>,
    pending: Option<GraspId>,
    /// Undone grasps, which can be restored.
    undone: BTreeSet<GraspId>,
}

impl Acknowledged {
    fn insert(&mut self, record: GraspRecord) {
        self.grasps.insert(record.id.clone(), labelled(record));
    }
}

/// Steps of the session under test.
#[derive(Clone, Copy, Debug)]
enum Step {
    Calibration,
    Initial(u32),
    Discard,
    Restore,
    Grasp(u32, &'static str),
    Lift(u32),
    Label(Outcome),
    Rename(&'static str),
    Undo,
    Redo,
    Trash,
    RestoreFromTrash,
    Index,
}

const SESSION: &[Step] = &[
    Step::Calibration,
    Step::Initial(1),
    Step::Discard,
    Step::Restore,
    Step::Grasp(2, "mug"),
    Step::Lift(1),
    Step::Label(Outcome::Stable),
    Step::Index,
    Step::Undo,
    Step::Redo,
    Step::Label(Outcome::Slip),
    Step::Rename("cup"),
    Step::Index,
    Step::Initial(3),
    Step::Grasp(4, "bottle"),
    Step::Undo,
    Step::Grasp(5, "bottle"),
    Step::Label(Outcome::Stable),
    Step::Initial(6),
    Step::Trash,
    Step::Index,
    Step::RestoreFromTrash,
    Step::Rename("jar"),
    Step::Rename("bottle"),
    Step::Trash,
];

/// The operator's state, for undo and redo.
#[derive(Default)]
struct Operator {
    acknowledged: Acknowledged,
    pending: Option<PendingInitial>,
    discarded: Option<GraspId>,
    last: Option<GraspId>,
    undone: Option<GraspId>,
    calibration: Option<ContentKey>,
}

impl Operator {
    /// Does one step; only a step that returns `Ok` is acknowledged.
    fn step(&mut self, writer: &mut DatasetWriter, step: Step) -> Result<()> {
        let at = "2026-11-20T11:00:00Z".parse().unwrap();
        match step {
            Step::Calibration => {
                self.calibration = Some(writer.put_calibration("unit = 1\n")?);
                writer.put_model("{}\n")?;
            }
            Step::Initial(number) => {
                self.pending = Some(writer.save_initial(&capture(number), Vec::new())?);
            }
            Step::Discard => {
                writer.discard_initial(self.pending.as_ref().unwrap())?;
                self.discarded = self.pending.take().map(|pending| pending.id);
            }
            Step::Restore => {
                self.pending = Some(writer.restore_initial(self.discarded.as_ref().unwrap())?);
            }
            Step::Grasp(number, object) => {
                let mut meta = meta(object);
                meta.calibration.insert(
                    gripcast_imaging::Role::Left,
                    self.calibration.clone().unwrap(),
                );
                let record =
                    writer.save_grasp(self.pending.as_ref().unwrap(), &capture(number), meta)?;
                self.pending = None;
                self.last = Some(record.id.clone());
                self.acknowledged.insert(record);
            }
            Step::Lift(number) => {
                let record = writer.append_lift(self.last.as_ref().unwrap(), &lift(number), 2.0)?;
                self.acknowledged.insert(record);
            }
            Step::Label(outcome) => {
                let record = writer.set_outcome(self.last.as_ref().unwrap(), outcome, at, None)?;
                self.acknowledged.insert(record);
            }
            Step::Rename(object) => {
                let names = NameChange {
                    object: Some(object.parse().unwrap()),
                    scene: Some("table 2".parse().unwrap()),
                    ..NameChange::default()
                };
                let (record, _) = writer.set_names(self.last.as_ref().unwrap(), &names)?;
                self.acknowledged.insert(record);
            }
            Step::Undo => {
                let id = self.last.clone().unwrap();
                self.pending = Some(writer.undo_grasp(&id)?);
                self.acknowledged.grasps.remove(&id);
                self.acknowledged.undone.insert(id.clone());
                self.undone = Some(id);
            }
            Step::Redo => {
                let id = self.undone.clone().unwrap();
                let record = writer.redo_grasp(&id, self.pending.as_ref())?;
                self.pending = None;
                self.acknowledged.undone.remove(&id);
                self.acknowledged.insert(record);
            }
            Step::Trash => {
                let record = writer.trash_grasp(self.last.as_ref().unwrap())?;
                self.acknowledged.grasps.remove(&record.id);
                self.acknowledged.undone.insert(record.id);
            }
            Step::RestoreFromTrash => {
                let record = writer.redo_grasp(self.last.as_ref().unwrap(), None)?;
                self.acknowledged.undone.remove(&record.id);
                self.acknowledged.insert(record);
            }
            Step::Index => writer.flush_index()?,
        }
        self.acknowledged.pending = self.pending.as_ref().map(|pending| pending.id.clone());
        Ok(())
    }
}

fn open(disk: &FailingDisk, root: &Path) -> Result<(DatasetWriter, super::OpenReport)> {
    DatasetWriter::open_on(
        Box::new(disk.clone()),
        GraspIndex::new(root),
        &new_dataset(),
    )
}

/// Runs the session until it fails; returns the state after each acknowledged step.
fn run_session(disk: &FailingDisk, root: &Path) -> Vec<Acknowledged> {
    let mut history = vec![Acknowledged::default()];
    let Ok((mut writer, _)) = open(disk, root) else {
        return history;
    };
    let mut operator = Operator::default();
    for &step in SESSION {
        if operator.step(&mut writer, step).is_err() {
            break;
        }
        history.push(operator.acknowledged.clone());
    }
    history
}

/// State after a restart; also checks every file against its digest.
fn found(disk: &FailingDisk, root: &Path, context: &str) -> Acknowledged {
    let (writer, report) =
        open(disk, root).unwrap_or_else(|e| panic!("{context}: cannot open again: {e}"));
    let layout = Layout::new(root);
    let dataset = Dataset::open(root).unwrap();
    let grasps: BTreeMap<GraspId, Labelled> = dataset
        .grasps()
        .unwrap()
        .map(|record| {
            let record = record.unwrap_or_else(|e| panic!("{context}: incomplete grasp: {e}"));
            (record.id.clone(), labelled(record))
        })
        .collect();
    assert_eq!(report.counts.total(), grasps.len(), "{context}");
    if let Some(pending) = &report.pending {
        let frames = writer
            .pending_frames(pending)
            .unwrap_or_else(|e| panic!("{context}: {e}"));
        assert_eq!(
            frames.len(),
            3,
            "{context}: both gels and the colour camera"
        );
    }
    drop(writer);
    let verified = verify(root, &|_, _| {}).unwrap();
    assert_eq!(verified.problems, [], "{context}");
    let undone = super::reader::subdirectories(&layout.trash())
        .unwrap()
        .into_iter()
        .filter_map(|name| GraspId::parse(&name).ok())
        .filter(|id| super::record_file::read_grasp(&layout.trashed(id)).is_ok())
        .collect();
    Acknowledged {
        grasps,
        pending: report.pending.map(|pending| pending.id),
        undone,
    }
}

fn whole_session(disk: &FailingDisk) -> (usize, Vec<Acknowledged>) {
    let dir = memory_folder();
    let history = run_session(disk, &dir.path().join("d"));
    assert_eq!(history.len(), SESSION.len() + 1);
    (disk.count(), history)
}

/// Asserts that the state is the last acknowledged one, or the one after the step in progress.
fn assert_nothing_lost(
    known: &Acknowledged,
    acknowledged: usize,
    history: &[Acknowledged],
    undone_may_grow: bool,
    context: &str,
) {
    let next = (acknowledged + 1).min(history.len() - 1);
    let matches = [acknowledged, next].into_iter().any(|index| {
        let expected = &history[index];
        let undone_agrees = expected.undone.is_subset(&known.undone)
            && (undone_may_grow || expected.undone == known.undone);
        expected.grasps == known.grasps && expected.pending == known.pending && undone_agrees
    });
    assert!(
        matches,
        "{context}: after {acknowledged} acknowledged steps found\n{known:#?}\nexpected\n{:#?}\nor\n{:#?}",
        history[acknowledged], history[next]
    );
}

#[test]
fn crash_keeps_acknowledged_steps_and_no_partial_grasp() {
    let (operations, history) = whole_session(&FailingDisk::new(0, None));
    assert!(operations > 150, "only {operations} operations");
    for fault in [
        Fault::Kill,
        Fault::PowerLoss { all: true },
        Fault::PowerLoss { all: false },
        Fault::Unplugged,
    ] {
        for at in 0..operations {
            let context = format!("{fault:?} at operation {at}");
            let dir = memory_folder();
            let root = dir.path().join("d");
            let disk = FailingDisk::new(at, Some(fault));
            let acknowledged = run_session(&disk, &root).len() - 1;
            assert!(disk.state().struck, "{context}");
            if let Fault::PowerLoss { all } = fault {
                disk.lose_power(all);
            }
            let known = found(&FailingDisk::new(0, None), &root, &context);
            assert_nothing_lost(&known, acknowledged, &history, false, &context);
        }
    }
}

#[test]
fn crash_during_recovery_loses_nothing() {
    let (operations, history) = whole_session(&FailingDisk::new(0, None));
    for at in 0..operations {
        for second in 0.. {
            let context = format!("killed at operation {at}, then at {second} of opening again");
            let dir = memory_folder();
            let root = dir.path().join("d");
            let first = FailingDisk::new(
                at,
                Some(Fault::PowerLoss {
                    all: second % 2 == 0,
                }),
            );
            let acknowledged = run_session(&first, &root).len() - 1;
            first.lose_power(second % 2 == 0);
            let opening = FailingDisk::new(second, Some(Fault::PowerLoss { all: true }));
            drop(open(&opening, &root));
            let struck = opening.state().struck;
            opening.lose_power(true);
            let known = found(&FailingDisk::new(0, None), &root, &context);
            assert_nothing_lost(&known, acknowledged, &history, false, &context);
            if !struck {
                break;
            }
        }
    }
}

#[test]
fn failed_step_changes_nothing_and_can_be_retried() {
    let (operations, history) = whole_session(&FailingDisk::new(0, None));
    for at in 0..operations {
        let context = format!("no space at operation {at}");
        let dir = memory_folder();
        let root = dir.path().join("d");
        let disk = FailingDisk::new(at, Some(Fault::FullOnce));
        let opened = open(&disk, &root).or_else(|error| {
            assert_eq!(error.kind(), ErrorKind::DiskFull, "{context}: {error}");
            open(&disk, &root)
        });
        let (mut writer, _) = opened.unwrap_or_else(|e| panic!("{context}: {e}"));
        let mut operator = Operator::default();
        for &step in SESSION {
            if let Err(error) = operator.step(&mut writer, step) {
                assert_eq!(error.kind(), ErrorKind::DiskFull, "{context}: {error}");
                assert!(error.remedy_text().is_some(), "{context}");
                operator
                    .step(&mut writer, step)
                    .unwrap_or_else(|e| panic!("{context}: {step:?} again: {e}"));
            }
        }
        drop(writer);
        let known = found(&FailingDisk::new(0, None), &root, &context);
        let last = history.last().unwrap();
        let outcomes = |known: &Acknowledged| known.grasps.values().cloned().collect::<Vec<_>>();
        assert_eq!(outcomes(&known), outcomes(last), "{context}");
        assert_eq!(known.pending.is_some(), last.pending.is_some(), "{context}");
    }
}

#[test]
fn full_disk_keeps_saved_grasps_and_can_be_opened() {
    let (operations, history) = whole_session(&FailingDisk::new(0, None));
    for at in 0..operations {
        let context = format!("disk full from operation {at}");
        let dir = memory_folder();
        let root = dir.path().join("d");
        let disk = FailingDisk::new(at, Some(Fault::Full));
        let acknowledged = run_session(&disk, &root).len() - 1;
        // A full disk cannot hold a new dataset, but one that is there can be opened.
        if root.join("dataset.toml").exists() && root.join("models").exists() {
            let full = FailingDisk::new(0, Some(Fault::Full));
            open(&full, &root).unwrap_or_else(|e| panic!("{context}: {e}"));
        }
        let known = found(&FailingDisk::new(0, None), &root, &context);
        assert_nothing_lost(&known, acknowledged, &history, true, &context);
    }
}

/// Crashes at each operation of a session with the trash on another disk.
fn crash_with_trash_on_another_disk(fault: Fault) {
    let (operations, history) = whole_session(&FailingDisk::with_two_disks(0, None));
    for at in 0..operations {
        let context = format!("two disks, {fault:?} at operation {at}");
        let dir = memory_folder();
        let root = dir.path().join("d");
        let disk = FailingDisk::with_two_disks(at, Some(fault));
        let acknowledged = run_session(&disk, &root).len() - 1;
        if let Fault::PowerLoss { all } = fault {
            disk.lose_power(all);
        }
        let known = found(&FailingDisk::with_two_disks(0, None), &root, &context);
        // A copy in the trash may remain beside the item that a crash left in its place.
        assert_nothing_lost(&known, acknowledged, &history, true, &context);
        let hidden = ["grasps", "trash"]
            .iter()
            .flat_map(|folder| fs::read_dir(root.join(folder)).unwrap())
            .filter(|e| is_partial(&e.as_ref().unwrap().file_name().to_string_lossy()));
        assert_eq!(hidden.count(), 0, "{context}");
    }
}

// One test per fault: they run in parallel.
#[test]
fn trash_on_another_disk_survives_kills() {
    crash_with_trash_on_another_disk(Fault::Kill);
}

#[test]
fn trash_on_another_disk_survives_full_power_loss() {
    crash_with_trash_on_another_disk(Fault::PowerLoss { all: true });
}

#[test]
fn trash_on_another_disk_survives_partial_power_loss() {
    crash_with_trash_on_another_disk(Fault::PowerLoss { all: false });
}

/// A dataset of version 1 with one grasp.
fn earlier_dataset(root: &Path) -> GraspId {
    let (mut writer, _) = DatasetWriter::open_or_create(root, &new_dataset()).unwrap();
    let initial = super::sample::capture(1);
    let pending = writer.save_initial(&initial, Vec::new()).unwrap();
    let closed = super::sample::capture(2);
    let record = writer.save_grasp(&pending, &closed, meta("mug")).unwrap();
    drop(writer);
    let grasp = root.join("grasps").join(&*record.id).join("grasp.json");
    for (path, new, old) in [
        (grasp, "\"schema\": 2", "\"schema\": 1"),
        (
            root.join("dataset.toml"),
            "schema = 2",
            "# by hand\nschema = 1",
        ),
    ] {
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(new), "{text}");
        fs::write(&path, text.replace(new, old)).unwrap();
    }
    record.id
}

fn schemas(root: &Path) -> (u32, u32) {
    let dataset = Dataset::open(root).unwrap();
    let record = dataset.grasps().unwrap().next().unwrap().unwrap();
    (dataset.descriptor().schema, record.schema)
}

#[test]
fn reading_and_opening_leave_an_earlier_dataset_as_it_is() {
    let dir = memory_folder();
    let root = dir.path().join("d");
    let id = earlier_dataset(&root);
    assert_eq!(verify(&root, &|_, _| {}).unwrap().problems, []);
    let (writer, report) = DatasetWriter::open(&root).unwrap();
    let notes = report.notes.join("\n");
    assert!(
        notes.contains("the first change makes it version 2"),
        "{notes}"
    );
    drop(writer);
    assert_eq!(schemas(&root), (1, 1));
    let (mut writer, _) = DatasetWriter::open(&root).unwrap();
    writer.trash_grasp(&id).unwrap();
    writer.redo_grasp(&id, None).unwrap();
    assert_eq!(schemas(&root), (1, 1), "no record was written");
    writer.append_lift(&id, &lift(1), 2.0).unwrap();
    assert_eq!(schemas(&root), (2, 2));
    drop(writer);
    let text = fs::read_to_string(root.join("dataset.toml")).unwrap();
    assert!(text.starts_with("# by hand\nschema = 2\n"), "{text}");
    assert_eq!(verify(&root, &|_, _| {}).unwrap().problems, []);
}

#[test]
fn command_migrates_once() {
    let dir = memory_folder();
    let root = dir.path().join("d");
    earlier_dataset(&root);
    let report = super::migrate(&root).unwrap();
    assert_eq!((report.from, report.to), (1, 2));
    let report = super::migrate(&root).unwrap();
    assert_eq!((report.from, report.to), (2, 2));
    assert_eq!(schemas(&root), (2, 1), "records of version 1 stay valid");
    assert_eq!(verify(&root, &|_, _| {}).unwrap().problems, []);
}

#[test]
fn crash_during_migration_leaves_one_version_or_the_other() {
    for fault in [
        Fault::Kill,
        Fault::PowerLoss { all: true },
        Fault::PowerLoss { all: false },
        Fault::Unplugged,
        Fault::FullOnce,
        Fault::Full,
    ] {
        for at in 0.. {
            let context = format!("{fault:?} at operation {at}");
            let dir = memory_folder();
            let root = dir.path().join("d");
            let id = earlier_dataset(&root);
            let disk = FailingDisk::new(at, Some(fault));
            let labelled = open(&disk, &root).and_then(|(mut writer, _)| {
                let time = "2026-11-20T11:00:00Z".parse().unwrap();
                writer.set_outcome(&id, Outcome::Slip, time, None)
            });
            if let Fault::PowerLoss { all } = fault {
                disk.lose_power(all);
            }
            let known = found(&FailingDisk::new(0, None), &root, &context);
            let outcome = known.grasps[&id].2;
            let (dataset, record) = schemas(&root);
            // A record is never newer than its dataset.
            assert!(record <= dataset, "{context}: {record} in {dataset}");
            assert_eq!(outcome == Outcome::Slip, record == 2, "{context}");
            if labelled.is_ok() {
                assert_eq!((dataset, outcome), (2, Outcome::Slip), "{context}");
            }
            if !disk.state().struck {
                break;
            }
        }
    }
}
