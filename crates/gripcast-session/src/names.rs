//! Corrections of the names of saved grasps.

use super::history::HistoryStep;
use super::machine::{Effect, InFlight, Session};
use super::store::{StoreReply, StoreRequest};
use super::view::{MessageLevel, Tone};
use gripcast_dataset::{GraspId, NameChange};

impl Session {
    pub(crate) fn edit(&mut self, id: GraspId, names: NameChange) -> Vec<Effect> {
        let after = names.clone();
        self.store(InFlight::Names(after), StoreRequest::SetNames { id, names })
    }

    pub(crate) fn names_changed(&mut self, after: NameChange, reply: &StoreReply) -> Vec<Effect> {
        let StoreReply::Renamed { grasp, before } = reply else {
            return Vec::new();
        };
        let id = grasp.id.clone();
        if before.is_empty() {
            let text = format!("grasp {} already has {after}", id.short());
            self.set_message(MessageLevel::Info, text);
            return Vec::new();
        }
        self.renamed(reply);
        self.set_message(MessageLevel::Info, format!("grasp {}: {after}", id.short()));
        let before = before.clone();
        self.record(HistoryStep::Names { id, before, after });
        vec![Effect::Tone(Tone::Undone)]
    }

    /// Updates counts and newest grasp after names were stored.
    pub(crate) fn renamed(&mut self, reply: &StoreReply) {
        let StoreReply::Renamed { grasp, before } = reply else {
            return;
        };
        if let Some(last) = self.last.as_mut().filter(|last| last.id == grasp.id) {
            last.object.clone_from(&grasp.object);
        }
        if let Some(before) = &before.object {
            self.count(before, grasp.outcome, -1);
            self.count(&grasp.object, grasp.outcome, 1);
        }
    }
}
