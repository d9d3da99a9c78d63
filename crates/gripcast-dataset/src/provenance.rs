//! What the existing grasps of a dataset were taken with.

use std::collections::BTreeMap;

use jiff::Timestamp;

use super::grasp::CameraRecord;
use super::grasp_index::GraspIndex;
use super::layout::Layout;
use super::prediction::PredictionRecord;
use super::record_file::read_grasp_of;
use gripcast_base::files::ContentKey;
use gripcast_imaging::Role;

/// What the existing grasps of a dataset were taken with.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Provenance {
    /// Complete grasps with a readable record.
    pub grasps: usize,
    /// Grasps with an unreadable record.
    pub unreadable: usize,
    /// Grasps of a virtual rig; the others come from cameras or recordings.
    pub simulated: usize,
    /// Time of the newest grasp.
    pub captured_at: Option<Timestamp>,
    /// Rig id of the newest grasp.
    pub rig: Option<String>,
    /// Cameras of the newest grasp.
    pub cameras: BTreeMap<Role, CameraRecord>,
    /// Calibration of the newest grasp's left camera.
    pub calibration: Option<ContentKey>,
    /// The newest prediction.
    pub prediction: Option<PredictionRecord>,
}

impl Provenance {
    /// Reads it from the index, and the newest record.
    pub(super) fn of(index: &GraspIndex, layout: &Layout) -> Self {
        let rows = index.newest(None, usize::MAX, |_| true);
        let newest = rows
            .first()
            .and_then(|(id, _)| read_grasp_of(layout, id).ok());
        Self {
            grasps: rows.len(),
            unreadable: index.unreadable().len(),
            simulated: rows.iter().filter(|(_, row)| row.is_simulated).count(),
            captured_at: rows.iter().filter_map(|(_, row)| row.time).max(),
            prediction: rows.iter().find_map(|(_, row)| row.prediction.clone()),
            rig: newest.as_ref().map(|record| record.rig.clone()),
            calibration: newest
                .as_ref()
                .and_then(|record| record.calibration.get(&Role::Left).cloned()),
            cameras: newest
                .map(|record| record.grasp.cameras)
                .unwrap_or_default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DatasetWriter;
    use crate::sample::{capture, meta, new_dataset};

    #[test]
    fn newest_grasp_counts_and_unreadable_ones_are_counted() {
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, opened) =
            DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
        assert_eq!(opened.provenance, Provenance::default());
        let mut ids = Vec::new();
        for (number, rig) in [(1, "bench"), (3, "other")] {
            let pending = writer.save_initial(&capture(number), Vec::new()).unwrap();
            let mut meta = meta("mug");
            meta.rig = rig.into();
            let record = writer.save_grasp(&pending, &capture(number + 1), meta);
            ids.push(record.unwrap().id);
        }
        drop(writer);
        let (writer, opened) = DatasetWriter::open(dir.path()).unwrap();
        let found = &opened.provenance;
        assert_eq!((found.grasps, found.simulated, found.unreadable), (2, 0, 0));
        assert_eq!(found.rig.as_deref(), Some("other"));
        assert_eq!(found.cameras[&Role::Left].serial, "S-left");
        assert_eq!(
            found.captured_at.unwrap().to_string(),
            "2026-11-20T10:15:04Z"
        );
        drop(writer);
        let record = dir.path().join("grasps").join(&*ids[1]).join("grasp.json");
        std::fs::write(record, "{").unwrap();
        let (_writer, opened) = DatasetWriter::open(dir.path()).unwrap();
        assert_eq!(
            (opened.provenance.grasps, opened.provenance.unreadable),
            (1, 1)
        );
        assert_eq!(opened.provenance.rig.as_deref(), Some("bench"));
    }
}
