//! Commands: from whoever asks through the session to the store, and their results back.

use jiff::Timestamp;
use tokio::sync::oneshot;

use super::frames::Trigger;
use super::{Engine, Stored};
use crate::daemon::asked::Asked;
use crate::daemon::black_box::Topic;
use crate::daemon::report::{Ended, GraspReport};
use crate::daemon::store::StoreMessage;
use gripcast_base::error::Result;
use gripcast_session::{
    Command, CommandResult, CommandSource, Effect, LastGrasp, Request, Step, StoreReply,
    StoreRequest,
};

/// The command that is being carried out.
pub(super) struct Pending {
    /// Its number.
    id: u64,
    /// Where it came from.
    source: CommandSource,
    /// Who waits for the result.
    answer: Option<oneshot::Sender<CommandResult>>,
    /// Whether it labels the newest grasp.
    is_label: bool,
    /// What a trigger has found, until it is saved.
    trigger: Option<Trigger>,
    /// What the store does for it.
    request: Option<StoreRequest>,
}

impl Engine {
    pub(super) fn handle(&mut self, asked: Asked) -> Result<Option<Ended>> {
        let Asked {
            command,
            source,
            answer,
        } = asked;
        self.last_command += 1;
        let id = self.last_command;
        self.log(
            "command",
            &serde_json::json!({"id": id, "command": command.to_string(), "source": source.name()}),
        );
        let trigger = self.session.is_trigger(&command).then(|| self.look());
        let now = trigger.as_ref().map(|trigger| self.conditions(trigger));
        self.pending = Some(Pending {
            id,
            source,
            answer,
            is_label: matches!(command, Command::Label(_)),
            trigger,
            request: None,
        });
        let request = Request {
            id,
            command,
            source,
        };
        let effects = self.session.handle(request, now.as_ref());
        self.carry_out(effects)
    }

    pub(super) fn take_reply(&mut self, reply: StoreReply) -> Vec<Effect> {
        self.tell_stored(&reply);
        let labelled_before = self.session.step() == Step::Label;
        let effects = self.session.completed(reply);
        // Undo and redo of a label stay with the object that is on the virtual table.
        if self
            .pending
            .as_ref()
            .is_some_and(|pending| pending.is_label)
            && labelled_before
            && self.session.step() == Step::Initial
            && let Some(hand) = &self.hand
        {
            hand.next_object();
        }
        effects
    }

    fn tell_stored(&mut self, reply: &StoreReply) {
        let pending = self.pending.as_mut();
        let Some(request) = pending.and_then(|pending| pending.request.take()) else {
            return;
        };
        self.note_grasp(&request, reply);
        let stored = Stored {
            at: Timestamp::now().to_string(),
            request,
            reply: reply.clone(),
        };
        (self.links.stored)(&stored);
        self.hub.tap().note(Topic::Stored, || &stored);
        self.log("stored", &stored);
    }

    /// Keeps the list of this session's grasps in line with the dataset.
    fn note_grasp(&mut self, request: &StoreRequest, reply: &StoreReply) {
        match (request, reply) {
            (_, StoreReply::Failed { .. }) => {}
            (
                StoreRequest::SaveGrasp { .. },
                StoreReply::Grasp(LastGrasp {
                    id,
                    object,
                    outcome,
                    predicted,
                }),
            ) => self.grasps.push(GraspReport {
                id: id.to_string(),
                object: object.to_string(),
                outcome: *outcome,
                p_stable: predicted.as_ref().map(|said| said.p_stable),
            }),
            (StoreRequest::SetOutcome { id, outcome }, _) => {
                if let Some(grasp) = self.grasps.iter_mut().find(|g| g.id == **id) {
                    grasp.outcome = *outcome;
                }
            }
            (StoreRequest::UndoGrasp { id } | StoreRequest::TrashGrasp { id }, _) => {
                if let Some(place) = self.grasps.iter().position(|g| g.id == **id) {
                    self.taken_back
                        .insert(id.to_string(), self.grasps.remove(place));
                }
            }
            (StoreRequest::RedoGrasp { id, .. } | StoreRequest::RestoreGrasp { id }, _) => {
                if let Some(grasp) = self.taken_back.remove(id.as_str()) {
                    let place = self.grasps.partition_point(|g| g.id < grasp.id);
                    self.grasps.insert(place, grasp);
                }
            }
            _ => {}
        }
    }

    pub(super) fn carry_out(&mut self, effects: Vec<Effect>) -> Result<Option<Ended>> {
        let mut ended = None;
        for effect in effects {
            match effect {
                Effect::Store(request) => self.store(request)?,
                Effect::Tone(tone) => {
                    // Without a screen nobody listens.
                    let _ = self.links.tones.send(tone);
                }
                Effect::UseInitial(id) => {
                    self.initial_change += 1;
                    let change = self.initial_change;
                    self.store.send(StoreMessage::UseInitial { id, change })?;
                }
                Effect::Result { id, result } => self.answer(id, result),
                Effect::Quit => ended = Some(Ended::Quit),
            }
        }
        Ok(ended)
    }

    fn store(&mut self, request: StoreRequest) -> Result<()> {
        let saves_grasp = matches!(request, StoreRequest::SaveGrasp { .. });
        let saves = saves_grasp || matches!(request, StoreRequest::SaveInitial { .. });
        let pending = self.pending.as_mut().filter(|_| saves);
        let trigger = pending.and_then(|pending| Some((pending.trigger.take()?, pending.source)));
        let (capture, boards) = trigger.map_or((None, None), |(trigger, source)| {
            let (capture, boards) = self.stage_capture(trigger, source, saves_grasp);
            (Some(Box::new(capture)), boards)
        });
        let live = self.inference.findings().live.clone();
        if let Some(pending) = &mut self.pending {
            pending.request = Some(request.clone());
        }
        self.store.send(StoreMessage::Carry {
            request,
            capture,
            boards,
            latency_ms: live.map_or(0.0, |live| live.said.latency_ms),
        })
    }

    /// Tells who asked what became of a command.
    fn answer(&mut self, id: u64, result: CommandResult) {
        let pending = self.pending.take_if(|pending| pending.id == id);
        let Some(answer) = pending.and_then(|pending| pending.answer) else {
            return;
        };
        // The status that follows from the command is there before its answer.
        self.send_status();
        // Who asked may have gone.
        let _ = answer.send(result);
    }
}
