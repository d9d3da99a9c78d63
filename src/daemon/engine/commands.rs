//! Commands: from a request through the session to the store, and the result back.

use jiff::Timestamp;
use tokio::sync::oneshot;

use super::frames::Trigger;
use super::{Engine, StoreEvent};
use crate::daemon::black_box::Topic;
use crate::daemon::command_request::CommandRequest;
use crate::daemon::report::{EndReason, GraspReport};
use crate::daemon::status::LiftStatus;
use crate::daemon::store::{StoreJob, StoreMessage};
use gripcast_base::error::Result;
use gripcast_base::files::GraspId;
use gripcast_capture::camera::monotonic_ns;
use gripcast_dataset::{LiftVerdict, Outcome};
use gripcast_session::{
    Command, CommandResult, CommandSource, Effect, LastGrasp, Request, Step, StoreReply,
    StoreRequest,
};

/// The command in progress.
pub(super) struct Pending {
    /// Number of the command.
    id: u64,
    /// Source of the command.
    source: CommandSource,
    /// Where the result goes.
    response: Option<oneshot::Sender<CommandResult>>,
    /// Whether it labels a grasp.
    is_label: bool,
    /// Frames of a trigger, until they are saved.
    trigger: Option<Trigger>,
    /// The store request in progress.
    request: Option<StoreRequest>,
}

impl Engine {
    pub(super) fn handle(&mut self, request: CommandRequest) -> Result<()> {
        let now_ns = monotonic_ns();
        let age_ms = request.age_ms(now_ns);
        let CommandRequest {
            command,
            source,
            given_ns: _,
            seen,
            response,
        } = request;
        self.last_command += 1;
        let id = self.last_command;
        self.log(
            "command",
            &serde_json::json!({
                "id": id, "command": command.to_string(), "source": source.name(), "age_ms": age_ms,
            }),
        );
        let trigger = self
            .session
            .is_trigger(&command)
            .then(|| self.pair_newest());
        let now = trigger.as_ref().map(|trigger| self.conditions(trigger));
        self.pending = Some(Pending {
            id,
            source,
            response,
            is_label: matches!(command, Command::Label(_) | Command::Relabel(..)),
            trigger,
            request: None,
        });
        let request = Request {
            age_ms,
            seen,
            now_ns,
            ..Request::new(id, command, source)
        };
        let effects = self.session.handle(request, now.as_ref());
        self.apply(effects)
    }

    pub(super) fn handle_reply(&mut self, reply: StoreReply) -> Vec<Effect> {
        self.publish_stored(&reply);
        let labelled_before = self.session.step() == Step::Label;
        let effects = self.session.completed(reply);
        // Undo and redo of a label keep the current virtual object.
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

    fn publish_stored(&mut self, reply: &StoreReply) {
        let pending = self.pending.as_mut();
        let Some(request) = pending.and_then(|pending| pending.request.take()) else {
            return;
        };
        if let StoreRequest::SaveGrasp { .. } = &request {
            self.lifted = match reply {
                StoreReply::Grasp(grasp) => Some(grasp.id.clone()),
                _ => None,
            };
            self.name_lift(self.lifted.clone());
        }
        self.update_grasps(&request, reply);
        self.adapt();
        let event = StoreEvent {
            at: Timestamp::now().to_string(),
            request,
            reply: reply.clone(),
        };
        (self.links.on_stored)(&event);
        self.hub.tap.json(Topic::Stored, || &event);
        self.log("stored", &event);
    }

    /// Updates the list of this session's grasps after a change of the dataset.
    fn update_grasps(&mut self, request: &StoreRequest, reply: &StoreReply) {
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
                p_stable: predicted.as_ref().map(|prediction| prediction.p_stable),
            }),
            (StoreRequest::SetOutcome { id, outcome }, _) => {
                if let Some(grasp) = self.grasps.iter_mut().find(|g| g.id == **id) {
                    grasp.outcome = *outcome;
                }
            }
            (_, StoreReply::Renamed { grasp, .. }) => {
                if let Some(report) = self.grasps.iter_mut().find(|g| g.id == *grasp.id) {
                    report.object = grasp.object.to_string();
                }
            }
            (StoreRequest::UndoGrasp { id } | StoreRequest::TrashGrasp { id }, _) => {
                if let Some(index) = self.grasps.iter().position(|g| g.id == **id) {
                    self.undone
                        .insert(id.to_string(), self.grasps.remove(index));
                }
            }
            (StoreRequest::RedoGrasp { id, .. } | StoreRequest::RestoreGrasp { id }, _) => {
                if let Some(grasp) = self.undone.remove(id.as_str()) {
                    let index = self.grasps.partition_point(|g| g.id < grasp.id);
                    self.grasps.insert(index, grasp);
                }
            }
            _ => {}
        }
    }

    pub(super) fn apply(&mut self, effects: Vec<Effect>) -> Result<()> {
        for effect in effects {
            match effect {
                Effect::Store(request) => self.store(request)?,
                Effect::Tone(tone) => {
                    // The receiver is gone without a screen.
                    let _ = self.links.tones.send(tone);
                }
                Effect::UseInitial(id) => {
                    self.initial_revision += 1;
                    let revision = self.initial_revision;
                    self.store.send(StoreMessage::UseInitial { id, revision })?;
                }
                Effect::Result { id, result } => self.respond(id, result),
                Effect::Quit => self.ended = Some(EndReason::Quit),
            }
        }
        Ok(())
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
        if let Some(capture) = capture.as_ref().filter(|_| saves_grasp) {
            self.keep_lift(capture.trigger_time_ns)?;
        }
        let live = self.inference.state().live.clone();
        let verdict = verdict(&request, self.lifted.as_ref(), self.inference.state().lift);
        if let Some(pending) = &mut self.pending {
            pending.request = Some(request.clone());
        }
        self.store.send(StoreMessage::Execute(StoreJob {
            request,
            capture,
            boards,
            latency_ms: live.map_or(0.0, |live| live.record.latency_ms),
            verdict,
        }))
    }

    /// Sends the result of a command to its requester.
    fn respond(&mut self, id: u64, result: CommandResult) {
        if result != CommandResult::Accepted {
            self.log("result", &serde_json::json!({"id": id, "result": result}));
        }
        let pending = self.pending.take_if(|pending| pending.id == id);
        let Some(response) = pending.and_then(|pending| pending.response) else {
            return;
        };
        // The new status is sent before the response.
        self.send_status();
        // The requester may have disconnected.
        let _ = response.send(result);
    }
}

/// Verdict in the lift of the grasp that a request labels; none unless it is the one that is lifted.
fn verdict(
    request: &StoreRequest,
    lifted: Option<&GraspId>,
    lift: Option<LiftStatus>,
) -> Option<LiftVerdict> {
    let StoreRequest::SetOutcome { id, outcome } = request else {
        return None;
    };
    let is_labelled = lifted == Some(id) && *outcome != Outcome::Unlabelled;
    let lift = lift.filter(|_| is_labelled)?;
    Some(LiftVerdict {
        p_stable: lift.p_stable,
        threshold: lift.threshold,
        frame_time_ns: lift.frame_time_ns,
        alarm_time_ns: lift.alarm_time_ns,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdict_is_of_the_grasp_that_is_lifted() {
        let id = |text: &str| GraspId::parse(text).unwrap();
        let [lifted, earlier] = ["2026-11-23T10-00-01Z-0002", "2026-11-23T10-00-00Z-0001"].map(id);
        let status = LiftStatus {
            p_stable: 0.25,
            p_before: 0.75,
            threshold: 0.5,
            is_stable: false,
            is_slipping: true,
            object: None,
            alarm_time_ns: Some(6),
            frame_time_ns: 7,
        };
        let of = |labelled: &GraspId, outcome, lifted: Option<&GraspId>, lift| {
            let id = labelled.clone();
            verdict(&StoreRequest::SetOutcome { id, outcome }, lifted, lift)
        };
        let found = of(&lifted, Outcome::Slip, Some(&lifted), Some(status)).unwrap();
        assert_eq!((found.p_stable, found.alarm_time_ns), (0.25, Some(6)));
        // Also after the newer grasp was undone, an earlier one has no verdict.
        assert_eq!(
            of(&earlier, Outcome::Slip, Some(&lifted), Some(status)),
            None
        );
        assert_eq!(
            of(&lifted, Outcome::Unlabelled, Some(&lifted), Some(status)),
            None
        );
        assert_eq!(of(&lifted, Outcome::Stable, Some(&lifted), None), None);
        assert_eq!(of(&lifted, Outcome::Stable, None, Some(status)), None);
    }
}
