//! What a crash may leave in `grasps/`, and what is to become of it.

use jiff::Timestamp;

use super::layout::{Layout, pending_id};
use super::reader::subdirectories;
use super::record_file::{Pending, PendingInitial};
use gripcast_base::error::Result;
use gripcast_base::files::GraspId;

/// What is to become of a `.tmp-<id>` directory.
#[derive(Debug)]
pub(super) enum Unfinished {
    /// A whole grasp that was not renamed: rename it.
    Complete,
    /// The newest durable initial frame: keep it for its grasp.
    Waiting(PendingInitial),
    /// Never acknowledged, or no longer of use; says why.
    Unusable(String),
}

/// Looks at all `.tmp-*` directories, sorted by id. At most one is waiting.
pub(super) fn unfinished(layout: &Layout) -> Result<Vec<(GraspId, Unfinished)>> {
    let mut found = Vec::new();
    for name in subdirectories(&layout.grasps())? {
        if let Some(id) = pending_id(&name) {
            let fate = inspect(layout, &id);
            found.push((id, fate));
        }
    }
    let newest = found
        .iter()
        .filter_map(|(id, fate)| match fate {
            Unfinished::Waiting(pending) => Some((taken_at(pending), id.clone())),
            Unfinished::Complete | Unfinished::Unusable(_) => None,
        })
        .max();
    for (id, fate) in &mut found {
        let is_newest = newest.as_ref().is_some_and(|(_, newest)| newest == id);
        if matches!(fate, Unfinished::Waiting(_)) && !is_newest {
            *fate = Unfinished::Unusable("a newer initial frame took its place".into());
        }
    }
    Ok(found)
}

fn inspect(layout: &Layout, id: &GraspId) -> Unfinished {
    match Pending::inspect(&layout.pending(id), id) {
        Pending::Grasp if layout.grasp(id).is_taken() => {
            Unfinished::Unusable(format!("there is another grasp {id}"))
        }
        Pending::Grasp => Unfinished::Complete,
        Pending::Initial(pending) => match &pending.reopened_from {
            Some(grasp) if layout.grasp(grasp).is_taken() => Unfinished::Unusable(format!(
                "initial frame of {grasp}, which was not undone after all"
            )),
            _ => Unfinished::Waiting(pending),
        },
        Pending::Torn(reason) => {
            Unfinished::Unusable(format!("was not written to its end: {reason}"))
        }
    }
}

fn taken_at(pending: &PendingInitial) -> Option<Timestamp> {
    pending.stage.captured_at.parse().ok()
}
