//! The initial frame between its trigger and its grasp.

use std::collections::BTreeMap;

use serde::Serialize;

use gripcast_base::files::FileName;
use gripcast_dataset::GraspId;
use gripcast_imaging::Role;

/// An initial frame that waits for its grasp.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PendingFrame {
    /// Key of the grasp that it begins.
    pub id: GraspId,
    /// Wall clock, RFC 3339 UTC.
    pub captured_at: String,
    /// `CLOCK_MONOTONIC` of the trigger, ns; 0 when it was taken before this process started.
    pub trigger_time_ns: u64,
    /// Control values of each camera at that time.
    pub controls: BTreeMap<Role, BTreeMap<String, i64>>,
    /// The external camera's frame: its driver time, ns, and file.
    pub external: Option<(u64, FileName)>,
}
