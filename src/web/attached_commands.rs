//! Commands of an attached screen: what they carry, and what became of them.

use std::collections::BTreeMap;
use std::fmt;

use serde_json::json;
use tokio_tungstenite::tungstenite::Error as WsError;

use crate::daemon::{CommandRequest, EngineStatus};
use gripcast_base::error::{Error, ErrorKind};
use gripcast_capture::camera::monotonic_ns;
use gripcast_dataset::Outcome;
use gripcast_session::{Command, CommandResult, Seen};

/// Time after which the estimate of the daemon's clock is replaced, ms: clocks drift apart.
const ESTIMATE_MS: f64 = 30_000.0;

/// `CLOCK_MONOTONIC` of this machine, ms.
pub(super) fn monotonic_ms() -> f64 {
    monotonic_ns() as f64 * 1e-6
}

/// Estimate of the daemon's clock from its states. A state that was delayed would make the clock
/// late, so the least delayed one of the last seconds counts.
#[derive(Debug, Default)]
pub(super) struct ClockEstimate {
    /// Daemon's clock minus ours, ms, and our time of the estimate, ms.
    estimate: Option<(f64, f64)>,
}

impl ClockEstimate {
    /// Takes the time of a state, ms, that arrived at `now_ms` of our clock.
    pub(super) fn note(&mut self, daemon_ms: u64, now_ms: f64) {
        let offset_ms = daemon_ms as f64 - now_ms;
        let is_better = self
            .estimate
            .is_none_or(|(best_ms, at_ms)| offset_ms >= best_ms || now_ms - at_ms > ESTIMATE_MS);
        if is_better {
            self.estimate = Some((offset_ms, now_ms));
        }
    }

    /// The daemon's time at `now_ms` of our clock, ms.
    fn daemon_ms(&self, now_ms: f64) -> Option<f64> {
        self.estimate.map(|(offset_ms, _)| now_ms + offset_ms)
    }
}

/// Commands that were sent.
#[derive(Debug, Default)]
pub(super) struct SentCommands {
    pub(super) clock: ClockEstimate,
    /// Why the newest command was not carried out, if the state does not show it.
    pub(super) refusal: Option<String>,
    newest: u64,
    unanswered: BTreeMap<u64, Command>,
}

impl SentCommands {
    /// Returns the message of a command, with its age and what the operator saw.
    pub(super) fn message(
        &mut self,
        request: CommandRequest,
        state: Option<&EngineStatus>,
    ) -> String {
        let now_ns = monotonic_ns();
        let view = state.map(|state| &state.session);
        // A label names its grasp.
        let last = view.and_then(|view| view.last.as_ref());
        let command = match (&request.command, last) {
            (Command::Label(outcome), Some(last)) => Command::Relabel(last.id.clone(), *outcome),
            (command, _) => command.clone(),
        };
        self.refusal = None;
        self.newest += 1;
        let text = json!({
            "command": command.to_string(),
            "id": self.newest,
            "sender": {
                "age_ms": request.age_ms(now_ns),
                "sent_at_ms": self.clock.daemon_ms(now_ns as f64 * 1e-6),
                "seen": view.map_or_else(Seen::default, |view| Seen::of(view, &command)),
            },
        });
        self.unanswered.insert(self.newest, command);
        text.to_string()
    }

    /// Takes the answer to a command.
    pub(super) fn answer(
        &mut self,
        id: u64,
        response: Option<CommandResult>,
        error: Option<String>,
    ) {
        let command = self.unanswered.remove(&id);
        let reason = match response {
            // All other results are in the state.
            Some(CommandResult::Refused {
                reasons,
                stale: true,
                ..
            }) => Some(reasons.join("; ")),
            _ => error,
        };
        if let Some(reason) = reason {
            let what =
                command.map_or_else(|| "the command".to_owned(), |command| key_name(&command));
            self.refusal = Some(format!("{what} NOT carried out: {reason}"));
        }
    }

    /// The error of a broken connection, which names the commands without an answer.
    pub(super) fn broken(&self, error: WsError, target: impl fmt::Display) -> Error {
        let names: Vec<String> = self.unanswered.values().map(key_name).collect();
        let mut remedy = "acknowledged changes are on disk; rerun the same command".to_owned();
        if !names.is_empty() {
            let names = names.join(", ");
            remedy = format!("no answer to {names}: check the step before you repeat it; {remedy}");
        }
        Error::new(ErrorKind::Io, "the connection to the daemon was lost")
            .because(error)
            .at(target)
            .remedy(remedy)
    }
}

/// The command as the operator gave it.
fn key_name(command: &Command) -> String {
    match command {
        Command::Relabel(_, outcome @ (Outcome::Stable | Outcome::Slip)) => format!("`{outcome}`"),
        command => format!("`{command}`"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_session::{CommandSource, Labels};
    use serde_json::Value;

    fn key(command: Command) -> CommandRequest {
        CommandRequest::new(command, CommandSource::Keyboard)
    }

    #[test]
    fn state_with_the_shortest_delay_sets_the_clock() {
        let mut clock = ClockEstimate::default();
        assert_eq!(clock.daemon_ms(5.0), None);
        clock.note(1_000, 10.0);
        assert_eq!(clock.daemon_ms(10.0), Some(1_000.0));
        // Delayed by 3 s.
        clock.note(1_100, 3_110.0);
        assert_eq!(clock.daemon_ms(3_110.0), Some(4_100.0));
        // Another boot of the daemon's machine.
        clock.note(50, 40_000.0);
        assert_eq!(clock.daemon_ms(40_000.0), Some(50.0));
    }

    #[test]
    fn command_carries_what_the_screen_shows() {
        let mut state = EngineStatus::starting("d", "r", Labels::default());
        state.session.revision = 42;
        state.session.undo = Some("initial frame".into());
        let mut sent = SentCommands::default();
        sent.clock.note(state.monotonic_ms, monotonic_ms());
        let message = sent.message(key(Command::Undo), Some(&state));
        let message: Value = serde_json::from_str(&message).unwrap();
        assert_eq!(
            (&message["command"], &message["id"]),
            (&json!("undo"), &json!(1))
        );
        let seen = json!({"revision": 42, "undo": "initial frame"});
        assert_eq!(message["sender"]["seen"], seen);
        assert!(message["sender"]["sent_at_ms"].as_f64().unwrap() > 0.0);
        assert!(message["sender"]["age_ms"].as_f64().unwrap() < 60_000.0);
    }

    #[test]
    fn refused_and_unanswered_commands_are_named() {
        let mut sent = SentCommands::default();
        sent.message(key(Command::Trigger), None);
        sent.message(key(Command::Undo), None);
        let refused = |stale| CommandResult::Refused {
            reasons: vec!["this command is 13 s old".into()],
            can_override: false,
            stale,
        };
        // The state has the reasons of guards.
        sent.answer(2, Some(refused(false)), None);
        assert_eq!(sent.refusal, None);
        sent.message(key(Command::Redo), None);
        sent.answer(3, Some(refused(true)), None);
        let text = sent.refusal.clone().unwrap();
        assert_eq!(text, "`redo` NOT carried out: this command is 13 s old");
        let error = sent.broken(WsError::ConnectionClosed, "lab");
        assert!(
            error
                .remedy_text()
                .unwrap()
                .contains("no answer to `trigger`")
        );
    }
}
