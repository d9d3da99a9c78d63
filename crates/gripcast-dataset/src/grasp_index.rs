//! The index in memory, which the writer and the readers of one process share.
//!
//! The writer's changes are in it at once. Changes of other programs are found by scanning the
//! names in `grasps/`, at most once in [`RESCAN`], and only while the directory changes; records
//! are read once. A record that another program edits in place is not read again: gripcast's own
//! commands cannot edit one, because the writer holds the lock.

use std::collections::BTreeMap;
use std::ops::Bound;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::counts::GraspCounts;
use super::grasp::{GraspRecord, Outcome};
use super::index::{IndexRow, to_jsonl};
use super::layout::Layout;
use super::reader::grasp_ids;
use super::record_file::read_grasp_of;
use gripcast_base::error::Result;
use gripcast_base::files::GraspId;

/// Minimum time between two scans.
const RESCAN: Duration = Duration::from_secs(1);
/// A directory that has not changed for this long needs no scan. Longer than the resolution of the
/// clocks of file systems: 2 s on FAT.
const SETTLED: Duration = Duration::from_secs(4);

/// The complete grasps of a dataset, by id.
#[derive(Clone, Debug)]
pub struct GraspIndex(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    layout: Layout,
    rescan: Duration,
    state: Mutex<State>,
    /// Held during a scan, so that a record is not read twice.
    scanning: Mutex<()>,
}

#[derive(Debug, Default)]
struct State {
    rows: BTreeMap<GraspId, Arc<IndexRow>>,
    unreadable: BTreeMap<GraspId, String>,
    /// Changes with every change of the rows.
    revision: u64,
    scan: Option<Scan>,
    work: IndexWork,
}

/// The newest scan.
#[derive(Clone, Copy, Debug)]
struct Scan {
    at: Instant,
    stamp: [u64; 3],
    /// When the stamp was seen first.
    stamp_since: Instant,
}

/// Operations since the index was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IndexWork {
    /// Scans of the names in `grasps/`.
    pub scans: usize,
    /// Records that were read.
    pub records: usize,
}

impl GraspIndex {
    /// An empty index of a dataset, which need not exist yet; [`refresh`](Self::refresh) fills it.
    #[must_use]
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self::with_rescan(path, RESCAN)
    }

    pub(super) fn with_rescan(path: impl Into<PathBuf>, rescan: Duration) -> Self {
        Self(Arc::new(Shared {
            layout: Layout::new(path),
            rescan,
            state: Mutex::default(),
            scanning: Mutex::default(),
        }))
    }

    /// Directory of the dataset.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.0.layout.root()
    }

    /// Takes in changes of the directory by other programs.
    ///
    /// # Errors
    /// When `grasps/` cannot be read.
    pub fn refresh(&self) -> Result<()> {
        let _scanning = locked(&self.0.scanning);
        let stamp = self.stamp()?;
        let is_current = self.state().scan.is_some_and(|scan| {
            let unchanged = scan.at.saturating_duration_since(scan.stamp_since);
            let is_settled = scan.stamp == stamp && unchanged >= SETTLED;
            is_settled || scan.at.elapsed() < self.0.rescan
        });
        if is_current { Ok(()) } else { self.scan(stamp) }
    }

    /// Fills the index when the dataset is opened for writing.
    ///
    /// # Errors
    /// When `grasps/` cannot be read.
    pub(super) fn fill(&self) -> Result<()> {
        let _scanning = locked(&self.0.scanning);
        self.scan(self.stamp()?)
    }

    fn stamp(&self) -> Result<[u64; 3]> {
        let layout = &self.0.layout;
        let stamp = layout.grasps().change_stamp();
        stamp.map_err(|e| layout.failed("cannot read the directory", e))
    }

    /// Compares the index with the names in `grasps/`; reads the records of new ones.
    fn scan(&self, stamp: [u64; 3]) -> Result<()> {
        let layout = &self.0.layout;
        let at = Instant::now();
        let ids = grasp_ids(layout)?;
        let (new, gone) = {
            let state = self.state();
            let is_new = |id: &&GraspId| !state.rows.contains_key(*id);
            let new: Vec<GraspId> = ids.iter().filter(is_new).cloned().collect();
            let known = state.rows.keys().chain(state.unreadable.keys());
            let is_gone = |id: &&GraspId| ids.binary_search(id).is_err();
            (new, known.filter(is_gone).cloned().collect::<Vec<_>>())
        };
        let read: Vec<(GraspId, Result<GraspRecord>)> = new
            .into_par_iter()
            .map(|id| {
                let record = read_grasp_of(layout, &id);
                (id, record)
            })
            .collect();
        let mut state = self.state();
        state.work.records += read.len();
        // The writer renames a directory before it changes the index, so the directory decides.
        let exists = |id: &GraspId| layout.grasp(id).is_taken();
        for id in gone.iter().filter(|id| !exists(id)) {
            state.remove(id);
        }
        for (id, record) in read {
            if state.rows.contains_key(&id) || !exists(&id) {
                continue;
            }
            match record {
                Ok(record) => state.insert(&record),
                Err(error) => drop(state.unreadable.insert(id, error.to_string())),
            }
        }
        let same = state.scan.filter(|scan| scan.stamp == stamp);
        state.work.scans += 1;
        state.scan = Some(Scan {
            at,
            stamp,
            stamp_since: same.map_or(at, |scan| scan.stamp_since),
        });
        Ok(())
    }

    /// At most `limit` grasps that match, newest first; only ids before `before`.
    pub fn newest(
        &self,
        before: Option<&str>,
        limit: usize,
        matches: impl Fn(&IndexRow) -> bool,
    ) -> Vec<(GraspId, Arc<IndexRow>)> {
        let state = self.state();
        let end = before.map_or(Bound::Unbounded, Bound::Excluded);
        let older = state.rows.range::<str, _>((Bound::Unbounded, end)).rev();
        older
            .filter(|(_, row)| matches(row))
            .take(limit)
            .map(|(id, row)| (id.clone(), Arc::clone(row)))
            .collect()
    }

    /// A grasp.
    #[must_use]
    pub fn get(&self, id: &GraspId) -> Option<Arc<IndexRow>> {
        self.state().rows.get(id).map(Arc::clone)
    }

    /// Ids in `grasps/` without a readable record, with the reason.
    #[must_use]
    pub fn unreadable(&self) -> BTreeMap<GraspId, String> {
        self.state().unreadable.clone()
    }

    /// Operations since the index was created.
    #[must_use]
    pub fn work(&self) -> IndexWork {
        self.state().work
    }

    /// Number of grasps.
    pub(super) fn len(&self) -> usize {
        self.state().rows.len()
    }

    /// Number of grasps by outcome and object.
    #[must_use]
    pub fn counts(&self) -> GraspCounts {
        let mut counts = GraspCounts::default();
        for row in self.state().rows.values() {
            counts.add(&row.object, row.outcome);
        }
        counts
    }

    /// Number of labelled grasps of a rig: slips, stable.
    #[must_use]
    pub fn labels_of_rig(&self, rig: &str) -> [u64; 2] {
        let mut labels = [0, 0];
        for row in self.state().rows.values().filter(|row| row.rig == rig) {
            match row.outcome {
                Outcome::Slip => labels[0] += 1,
                Outcome::Stable => labels[1] += 1,
                Outcome::Unlabelled => {}
            }
        }
        labels
    }

    /// Takes in a grasp that the writer saved or changed.
    pub(super) fn insert(&self, record: &GraspRecord) {
        self.state().insert(record);
    }

    /// Drops a grasp that the writer moved away.
    pub(super) fn remove(&self, id: &GraspId) {
        self.state().remove(id);
    }

    pub(super) fn revision(&self) -> u64 {
        self.state().revision
    }

    /// Revision and text of `metadata.jsonl`.
    pub(super) fn to_jsonl(&self) -> (u64, String) {
        // Rows are shared, so that the writer of the text does not hold the lock.
        let (revision, rows) = {
            let state = self.state();
            (state.revision, state.rows.clone())
        };
        (revision, to_jsonl(&rows))
    }

    pub(super) fn ids(&self) -> Vec<GraspId> {
        self.state().rows.keys().cloned().collect()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        locked(&self.0.state)
    }
}

impl State {
    fn insert(&mut self, record: &GraspRecord) {
        let row = Arc::new(IndexRow::new(record));
        self.rows.insert(record.id.clone(), row);
        self.unreadable.remove(&record.id);
        self.revision += 1;
    }

    fn remove(&mut self, id: &GraspId) {
        self.rows.remove(id);
        self.unreadable.remove(id);
        self.revision += 1;
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::DatasetWriter;
    use crate::sample::{capture, meta, new_dataset};

    fn saved(writer: &mut DatasetWriter, number: u32, object: &str) -> GraspId {
        let pending = writer.save_initial(&capture(2 * number + 1), Vec::new());
        let record = writer.save_grasp(&pending.unwrap(), &capture(2 * number + 2), meta(object));
        record.unwrap().id
    }

    fn newest(index: &GraspIndex) -> Vec<GraspId> {
        let all = index.newest(None, usize::MAX, |_| true);
        all.into_iter().map(|(id, _)| id).collect()
    }

    #[test]
    fn writer_and_pages_share_the_index_without_reading() {
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
        let saved: Vec<GraspId> = (0..3).map(|n| saved(&mut writer, n, "mug")).collect();
        drop(writer);
        let index = GraspIndex::with_rescan(dir.path(), Duration::MAX);
        let (mut writer, _) = DatasetWriter::open_index(index.clone(), &new_dataset()).unwrap();
        let opened = IndexWork {
            scans: 1,
            records: 3,
        };
        assert_eq!(index.work(), opened);
        let at = "2026-11-20T11:00:00Z".parse().unwrap();
        writer
            .set_outcome(&saved[0], Outcome::Slip, at, None)
            .unwrap();
        writer.trash_grasp(&saved[1]).unwrap();
        for _ in 0..100 {
            index.refresh().unwrap();
            assert_eq!(newest(&index), [saved[2].clone(), saved[0].clone()]);
            assert_eq!(index.newest(Some(&saved[2]), 24, |_| true).len(), 1);
            let rig = index.get(&saved[0]).unwrap().rig.clone();
            assert_eq!(index.labels_of_rig(&rig), [1, 0]);
            assert_eq!(index.labels_of_rig("another rig"), [0, 0]);
            let slips = index.newest(None, 24, |row| row.outcome == Outcome::Slip);
            assert_eq!(slips[0].0, saved[0]);
        }
        writer.redo_grasp(&saved[1], None).unwrap();
        assert_eq!(newest(&index).len(), 3);
        let undone = writer.undo_grasp(&saved[2]).unwrap();
        assert_eq!(newest(&index).len(), 2);
        writer.redo_grasp(&saved[2], Some(&undone)).unwrap();
        assert_eq!(index.counts(), writer.counts());
        assert_eq!((index.work(), newest(&index).len()), (opened, 3));
    }

    #[test]
    fn changes_by_other_programs_are_found_and_read_once() {
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
        let saved: Vec<GraspId> = (0..3).map(|n| saved(&mut writer, n, "mug")).collect();
        let index = GraspIndex::with_rescan(dir.path(), Duration::ZERO);
        index.refresh().unwrap();
        let grasp = |id: &GraspId| dir.path().join(format!("grasps/{id}"));
        let aside = dir.path().join("aside");
        fs::rename(grasp(&saved[1]), &aside).unwrap();
        index.refresh().unwrap();
        assert_eq!(newest(&index), [saved[2].clone(), saved[0].clone()]);
        fs::rename(&aside, grasp(&saved[1])).unwrap();
        // A copy under another name is no grasp.
        let copy = GraspId::parse("2026-11-20T10-15-03Z-copy").unwrap();
        fs::create_dir(grasp(&copy)).unwrap();
        let json = grasp(&saved[0]).join("grasp.json");
        fs::copy(json, grasp(&copy).join("grasp.json")).unwrap();
        index.refresh().unwrap();
        assert_eq!(newest(&index).len(), 3);
        assert!(index.unreadable()[&copy].contains("belongs to"));
        assert_eq!(index.work().records, 3 + 1 + 1);
        fs::remove_dir_all(grasp(&copy)).unwrap();
        index.refresh().unwrap();
        assert!(index.unreadable().is_empty());
    }
}
