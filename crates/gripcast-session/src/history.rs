//! Undo and redo history.

use super::Effect;
use super::machine::{InFlight, Session};
use super::pending::PendingFrame;
use super::store::{StoreReply, StoreRequest};
use super::view::{LastGrasp, MessageLevel, Tone};
use gripcast_base::files::ObjectName;
use gripcast_dataset::{GraspId, NameChange, Outcome};

/// A step that can be undone.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum HistoryStep {
    Initial {
        id: GraspId,
        replaced: Option<PendingFrame>,
    },
    Grasp {
        last: LastGrasp,
        before: Option<Box<LastGrasp>>,
        /// Pending frame that an undo reopened from the grasp's initial frame.
        reopened: Option<GraspId>,
    },
    Label {
        id: GraspId,
        object: ObjectName,
        before: Outcome,
        after: Outcome,
    },
    Names {
        id: GraspId,
        before: NameChange,
        after: NameChange,
    },
    Trash {
        grasp: LastGrasp,
        /// Whether it was the newest grasp of the session.
        was_last: bool,
    },
    Restore(LastGrasp),
}

impl HistoryStep {
    /// Short description of the step.
    pub(crate) fn describe(&self) -> String {
        match self {
            Self::Initial { .. } => "initial frame".into(),
            Self::Grasp { last, .. } => format!("grasp {}", last.id.short()),
            Self::Label { id, after, .. } => format!("label {after} of {}", id.short()),
            Self::Names { id, after, .. } => format!("{after} of {}", id.short()),
            Self::Trash { grasp, .. } => format!("trash of {}", grasp.id.short()),
            Self::Restore(grasp) => format!("restore of {}", grasp.id.short()),
        }
    }

    /// What happened when the step was done.
    pub(crate) fn describe_done(&self) -> String {
        match self {
            Self::Initial { .. } => "the initial frame was saved".into(),
            Self::Grasp { last, .. } => format!("grasp {} was saved", last.id.short()),
            Self::Label { id, after, .. } => {
                format!("grasp {} was labelled {after}", id.short())
            }
            Self::Names { id, after, .. } => format!("grasp {} got {after}", id.short()),
            Self::Trash { grasp, .. } => {
                format!("grasp {} was moved to the trash", grasp.id.short())
            }
            Self::Restore(grasp) => {
                format!("grasp {} was restored from the trash", grasp.id.short())
            }
        }
    }

    /// Request that undoes the step.
    fn undo_request(&self) -> StoreRequest {
        match self {
            Self::Initial { id, .. } => StoreRequest::DiscardInitial { id: id.clone() },
            Self::Grasp { last, .. } => StoreRequest::UndoGrasp {
                id: last.id.clone(),
            },
            Self::Label { id, before, .. } => StoreRequest::SetOutcome {
                id: id.clone(),
                outcome: *before,
            },
            Self::Names { id, before, .. } => StoreRequest::SetNames {
                id: id.clone(),
                names: before.clone(),
            },
            Self::Trash { grasp, .. } => StoreRequest::RestoreGrasp {
                id: grasp.id.clone(),
            },
            Self::Restore(grasp) => StoreRequest::TrashGrasp {
                id: grasp.id.clone(),
            },
        }
    }

    /// Request that redoes the step.
    fn redo_request(&self) -> StoreRequest {
        match self {
            Self::Initial { id, .. } => StoreRequest::RestoreInitial { id: id.clone() },
            Self::Grasp { last, reopened, .. } => StoreRequest::RedoGrasp {
                id: last.id.clone(),
                reopened: reopened.clone(),
            },
            Self::Label { id, after, .. } => StoreRequest::SetOutcome {
                id: id.clone(),
                outcome: *after,
            },
            Self::Names { id, after, .. } => StoreRequest::SetNames {
                id: id.clone(),
                names: after.clone(),
            },
            Self::Trash { grasp, .. } => StoreRequest::TrashGrasp {
                id: grasp.id.clone(),
            },
            Self::Restore(grasp) => StoreRequest::RestoreGrasp {
                id: grasp.id.clone(),
            },
        }
    }
}

impl Session {
    /// Records a step; clears the redo history.
    pub(crate) fn record(&mut self, step: HistoryStep) {
        self.undo.push(step);
        self.redo.clear();
    }

    pub(crate) fn undo(&mut self) -> Vec<Effect> {
        let Some(step) = self.undo.pop() else {
            return self.refuse_with("nothing to undo");
        };
        let request = step.undo_request();
        self.store(InFlight::Undo(step), request)
    }

    pub(crate) fn undone(&mut self, mut step: HistoryStep, reply: StoreReply) -> Vec<Effect> {
        let text = match &mut step {
            HistoryStep::Initial { replaced, .. } => {
                self.pending = None;
                if let Some(previous) = replaced {
                    let id = previous.id.clone();
                    self.redo.push(step);
                    return self.store(InFlight::UndoRestore, StoreRequest::RestoreInitial { id });
                }
                "initial frame undone".to_owned()
            }
            HistoryStep::Grasp {
                last,
                before,
                reopened,
            } => {
                let StoreReply::Initial(frame) = reply else {
                    return Vec::new();
                };
                self.rename_initial(&last.id, &frame.id);
                self.count(&last.object, last.outcome, -1);
                self.last = before.as_deref().cloned();
                *reopened = Some(frame.id.clone());
                self.pending = Some(frame);
                format!("grasp {} undone", last.id.short())
            }
            HistoryStep::Label {
                id,
                object,
                before,
                after,
            } => {
                self.relabel(id, object, *after, *before);
                format!("grasp {} is {before} again", id.short())
            }
            HistoryStep::Names { id, before, .. } => {
                self.renamed(&reply);
                format!("grasp {} is {before} again", id.short())
            }
            HistoryStep::Trash { grasp, was_last } => {
                self.count(&grasp.object, grasp.outcome, 1);
                if *was_last {
                    self.last = Some(grasp.clone());
                }
                format!("grasp {} restored from the trash", grasp.id.short())
            }
            HistoryStep::Restore(grasp) => {
                self.remove_grasp(grasp);
                format!("grasp {} moved to the trash again", grasp.id.short())
            }
        };
        self.redo.push(step);
        self.finish_undo(&text)
    }

    /// Updates the id of an initial frame in the history: undoing a grasp makes its initial frame
    /// pending under a new id.
    fn rename_initial(&mut self, from: &GraspId, to: &GraspId) {
        for step in &mut self.undo {
            if let HistoryStep::Initial { id, .. } = step
                && id == from
            {
                id.clone_from(to);
            }
        }
    }

    pub(crate) fn finish_undo(&mut self, text: &str) -> Vec<Effect> {
        self.summary.undone += 1;
        self.set_message(MessageLevel::Info, text);
        vec![self.use_initial(), Effect::Tone(Tone::Undone)]
    }

    pub(crate) fn redo(&mut self) -> Vec<Effect> {
        let Some(step) = self.redo.pop() else {
            return self.refuse_with("nothing to redo");
        };
        // A retaken initial frame replaces the previous one, which is discarded first.
        if let HistoryStep::Initial {
            replaced: Some(previous),
            ..
        } = &step
        {
            let id = previous.id.clone();
            return self.store(
                InFlight::RedoRestore(step),
                StoreRequest::DiscardInitial { id },
            );
        }
        let request = step.redo_request();
        self.store(InFlight::Redo(step), request)
    }

    /// Second half of redoing a retaken initial frame: restores it.
    pub(crate) fn redo_restore(&mut self, step: HistoryStep) -> Vec<Effect> {
        let request = step.redo_request();
        self.store(InFlight::Redo(step), request)
    }

    pub(crate) fn redone(&mut self, step: HistoryStep, reply: StoreReply) -> Vec<Effect> {
        match (&step, reply) {
            (HistoryStep::Names { .. }, reply) => self.renamed(&reply),
            (HistoryStep::Initial { .. }, StoreReply::Initial(frame)) => self.pending = Some(frame),
            (HistoryStep::Initial { .. }, _) => return Vec::new(),
            (HistoryStep::Grasp { last, reopened, .. }, _) => {
                if let Some(reopened) = reopened {
                    self.rename_initial(reopened, &last.id);
                }
                self.count(&last.object, last.outcome, 1);
                self.last = Some(last.clone());
                self.pending = None;
            }
            (
                HistoryStep::Label {
                    id,
                    object,
                    before,
                    after,
                },
                _,
            ) => self.relabel(id, object, *before, *after),
            (HistoryStep::Trash { grasp, .. }, _) => {
                self.remove_grasp(grasp);
            }
            (HistoryStep::Restore(grasp), _) => self.count(&grasp.object, grasp.outcome, 1),
        }
        self.summary.redone += 1;
        self.set_message(MessageLevel::Info, format!("redone: {}", step.describe()));
        self.undo.push(step);
        vec![self.use_initial(), Effect::Tone(Tone::Undone)]
    }
}
