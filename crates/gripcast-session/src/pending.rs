//! The pending initial frame.

use std::collections::BTreeMap;

use serde::Serialize;

use gripcast_base::files::FileName;
use gripcast_dataset::GraspId;
use gripcast_imaging::Role;

/// An initial frame whose grasp is not taken yet.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PendingFrame {
    /// Id of the future grasp.
    pub id: GraspId,
    /// Time of the trigger, RFC 3339 UTC.
    pub captured_at: String,
    /// `CLOCK_MONOTONIC` of the trigger, ns; 0 if taken before this process started.
    pub trigger_time_ns: u64,
    /// Control values of each camera at the trigger.
    pub controls: BTreeMap<Role, BTreeMap<String, i64>>,
    /// Driver time, ns, and file of the external camera's frame.
    pub external: Option<(u64, FileName)>,
}
