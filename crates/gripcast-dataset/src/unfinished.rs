//! Finds unfinished saves that a crash left in `grasps/` and decides how to handle them.

use jiff::Timestamp;

use super::layout::{Layout, pending_id};
use super::reader::subdirectories;
use super::record_file::{Pending, PendingInitial};
use gripcast_base::error::Result;
use gripcast_base::files::GraspId;

/// How to handle a `.tmp-<id>` directory.
#[derive(Debug)]
pub(super) enum Unfinished {
    /// A complete grasp that was not renamed: rename it.
    Complete,
    /// The newest durable initial frame: keep it for its grasp.
    Pending(Box<PendingInitial>),
    /// Never acknowledged, or no longer needed; holds the reason.
    Unusable(String),
}

/// Inspects all `.tmp-*` directories, sorted by id. At most one is pending.
pub(super) fn unfinished(layout: &Layout) -> Result<Vec<(GraspId, Unfinished)>> {
    let mut found = Vec::new();
    for name in subdirectories(&layout.grasps())? {
        if let Some(id) = pending_id(&name) {
            let state = inspect(layout, &id);
            found.push((id, state));
        }
    }
    let newest = found
        .iter()
        .filter_map(|(id, state)| match state {
            Unfinished::Pending(pending) => Some((captured_at(pending), id.clone())),
            Unfinished::Complete | Unfinished::Unusable(_) => None,
        })
        .max();
    for (id, state) in &mut found {
        let is_newest = newest.as_ref().is_some_and(|(_, newest)| newest == id);
        if matches!(state, Unfinished::Pending(_)) && !is_newest {
            *state = Unfinished::Unusable("superseded by a newer initial frame".into());
        }
    }
    Ok(found)
}

fn inspect(layout: &Layout, id: &GraspId) -> Unfinished {
    match Pending::inspect(&layout.pending(id), id) {
        Pending::Grasp if layout.grasp(id).is_taken() => {
            Unfinished::Unusable(format!("grasp {id} already exists"))
        }
        Pending::Grasp => Unfinished::Complete,
        Pending::Initial(pending) => match &pending.reopened_from {
            Some(grasp) if layout.grasp(grasp).is_taken() => Unfinished::Unusable(format!(
                "initial frame of {grasp}, whose undo was not completed"
            )),
            _ => Unfinished::Pending(pending),
        },
        Pending::Torn(reason) => Unfinished::Unusable(format!("incomplete save: {reason}")),
    }
}

fn captured_at(pending: &PendingInitial) -> Option<Timestamp> {
    pending.stage.captured_at.parse().ok()
}
