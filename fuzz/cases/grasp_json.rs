//! `grasp.json` as a dataset may hold it.

use gripcast_dataset::GraspRecord;

/// Panics where something is wrong.
pub(crate) fn check(input: &[u8]) {
    if let Ok(record) = GraspRecord::from_json(input) {
        let text = serde_json::to_vec(&record).expect("a record that was read can be written");
        let again = GraspRecord::from_json(&text).expect("and read again");
        assert_eq!(record, again);
        let _ = record.calibration_keys().count();
    }
}
