//! Scripted commands and their results.

use tokio::sync::oneshot;

use super::Engine;
use crate::daemon::command_request::CommandRequest;
use crate::daemon::report::EndReason;
use gripcast_base::error::{Error, Result};
use gripcast_capture::camera::monotonic_ns;
use gripcast_capture::trigger::{self, Answer, ScriptAction};
use gripcast_session::{Command, CommandResult, CommandSource};

/// The script's newest command and its result.
#[derive(Debug, Default)]
pub(super) struct ScriptCommand {
    /// Receiver of a result that has not arrived yet.
    pending: Option<oneshot::Receiver<CommandResult>>,
    answer: Option<Answer>,
}

impl ScriptCommand {
    /// Returns the result once it has arrived.
    fn answer(&mut self) -> Option<Answer> {
        let pending = self.pending.as_mut();
        if let Some(result) = pending.and_then(|pending| pending.try_recv().ok()) {
            self.pending = None;
            self.answer = Some(match result.error_message() {
                Some(complaint) => Answer::Refused(complaint),
                None => Answer::Saved,
            });
        }
        self.answer.clone()
    }
}

impl Engine {
    pub(super) fn advance_script(&mut self) -> Result<()> {
        let conditions = trigger::Conditions {
            all_live: self.all_live(),
            contact: self.is_in_contact(),
            fresh: self.has_fresh_frames(),
            saving: self.session.is_storing(),
            last_answer: self.script_command.answer(),
        };
        let Some(script) = &mut self.script else {
            return Ok(());
        };
        match script.next(monotonic_ns(), &conditions) {
            ScriptAction::Wait => {}
            ScriptAction::Done => self.ended = Some(EndReason::ScriptDone),
            ScriptAction::Failed(error) => return Err(error),
            ScriptAction::Command(text) => {
                let command: Command = text
                    .parse()
                    .map_err(|e| Error::internal("the script has an invalid command").because(e))?;
                let (request, response) =
                    CommandRequest::with_response(command, CommandSource::Script);
                self.script_command = ScriptCommand {
                    pending: Some(response),
                    answer: None,
                };
                self.queued.push_back(request);
            }
        }
        Ok(())
    }
}
