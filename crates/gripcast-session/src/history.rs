//! Undo and redo: steps that were taken, and the way back.

use super::Effect;
use super::machine::{InFlight, Session};
use super::pending::PendingFrame;
use super::store::{StoreReply, StoreRequest};
use super::view::{LastGrasp, MessageLevel, Tone};
use gripcast_base::files::ObjectName;
use gripcast_dataset::{GraspId, Outcome};

/// A step that can be taken back.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Done {
    Initial {
        id: GraspId,
        replaced: Option<PendingFrame>,
    },
    Grasp {
        last: LastGrasp,
        before: Option<LastGrasp>,
        /// Pending frame that an undo made from the grasp's initial frame.
        reopened: Option<GraspId>,
    },
    Label {
        id: GraspId,
        object: ObjectName,
        before: Outcome,
        after: Outcome,
    },
    Trash {
        grasp: LastGrasp,
        /// Whether it was the newest grasp of the session.
        was_last: bool,
    },
    Restore(LastGrasp),
}

impl Done {
    /// The step in a few words.
    pub(crate) fn describe(&self) -> String {
        match self {
            Self::Initial { .. } => "initial frame".into(),
            Self::Grasp { last, .. } => format!("grasp {}", last.id.short()),
            Self::Label { id, after, .. } => format!("label {after} of {}", id.short()),
            Self::Trash { grasp, .. } => format!("trash of {}", grasp.id.short()),
            Self::Restore(grasp) => format!("return of {}", grasp.id.short()),
        }
    }

    /// What takes it back.
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
            Self::Trash { grasp, .. } => StoreRequest::RestoreGrasp {
                id: grasp.id.clone(),
            },
            Self::Restore(grasp) => StoreRequest::TrashGrasp {
                id: grasp.id.clone(),
            },
        }
    }

    /// What does it again, once nothing stands in its way.
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
    /// A step was taken; what was taken back before cannot be done again any more.
    pub(crate) fn record(&mut self, done: Done) {
        self.undo.push(done);
        self.redo.clear();
    }

    pub(crate) fn undo(&mut self) -> Vec<Effect> {
        let Some(done) = self.undo.pop() else {
            return self.nothing("nothing to undo");
        };
        let request = done.undo_request();
        self.store(InFlight::Undo(done), request)
    }

    pub(crate) fn undone(&mut self, mut done: Done, reply: StoreReply) -> Vec<Effect> {
        let text = match &mut done {
            Done::Initial { replaced, .. } => {
                self.pending = None;
                if let Some(earlier) = replaced {
                    let id = earlier.id.clone();
                    self.redo.push(done);
                    return self.store(InFlight::UndoRestore, StoreRequest::RestoreInitial { id });
                }
                "initial frame taken back".to_owned()
            }
            Done::Grasp {
                last,
                before,
                reopened,
            } => {
                let StoreReply::Initial(frame) = reply else {
                    return Vec::new();
                };
                self.rename_initial(&last.id, &frame.id);
                self.count(&last.object, last.outcome, -1);
                self.last.clone_from(before);
                *reopened = Some(frame.id.clone());
                self.pending = Some(frame);
                format!("grasp {} taken back", last.id.short())
            }
            Done::Label {
                id,
                object,
                before,
                after,
            } => {
                self.relabel(id, object, *after, *before);
                format!("grasp {} is {before} again", id.short())
            }
            Done::Trash { grasp, was_last } => {
                self.count(&grasp.object, grasp.outcome, 1);
                if *was_last {
                    self.last = Some(grasp.clone());
                }
                format!("grasp {} is back from the trash", grasp.id.short())
            }
            Done::Restore(grasp) => {
                self.leave_out(grasp);
                format!("grasp {} is in the trash again", grasp.id.short())
            }
        };
        self.redo.push(done);
        self.finish_undo(&text)
    }

    /// An undone grasp's initial frame is pending under a new key: the step that took the frame
    /// has to name it, or it could not be taken back itself.
    fn rename_initial(&mut self, from: &GraspId, to: &GraspId) {
        for done in &mut self.undo {
            if let Done::Initial { id, .. } = done
                && id == from
            {
                id.clone_from(to);
            }
        }
    }

    pub(crate) fn finish_undo(&mut self, text: &str) -> Vec<Effect> {
        self.summary.undone += 1;
        self.say(MessageLevel::Info, text);
        vec![self.use_initial(), Effect::Tone(Tone::Undone)]
    }

    pub(crate) fn redo(&mut self) -> Vec<Effect> {
        let Some(done) = self.redo.pop() else {
            return self.nothing("nothing to redo");
        };
        // Of a re-taken initial the earlier one has to go first.
        if let Done::Initial {
            replaced: Some(earlier),
            ..
        } = &done
        {
            let id = earlier.id.clone();
            return self.store(
                InFlight::RedoRestore(done),
                StoreRequest::DiscardInitial { id },
            );
        }
        let request = done.redo_request();
        self.store(InFlight::Redo(done), request)
    }

    /// The earlier initial frame has gone: the re-taken one comes back.
    pub(crate) fn redo_restore(&mut self, done: Done) -> Vec<Effect> {
        let request = done.redo_request();
        self.store(InFlight::Redo(done), request)
    }

    pub(crate) fn redone(&mut self, done: Done, reply: StoreReply) -> Vec<Effect> {
        match (&done, reply) {
            (Done::Initial { .. }, StoreReply::Initial(frame)) => self.pending = Some(frame),
            (Done::Initial { .. }, _) => return Vec::new(),
            (Done::Grasp { last, reopened, .. }, _) => {
                if let Some(reopened) = reopened {
                    self.rename_initial(reopened, &last.id);
                }
                self.count(&last.object, last.outcome, 1);
                self.last = Some(last.clone());
                self.pending = None;
            }
            (
                Done::Label {
                    id,
                    object,
                    before,
                    after,
                },
                _,
            ) => self.relabel(id, object, *before, *after),
            (Done::Trash { grasp, .. }, _) => {
                self.leave_out(grasp);
            }
            (Done::Restore(grasp), _) => self.count(&grasp.object, grasp.outcome, 1),
        }
        self.summary.redone += 1;
        self.say(
            MessageLevel::Info,
            format!("done again: {}", done.describe()),
        );
        self.undo.push(done);
        vec![self.use_initial(), Effect::Tone(Tone::Undone)]
    }
}
