//! Timed commands and their answers.

use tokio::sync::oneshot;

use super::Engine;
use crate::daemon::asked::Asked;
use crate::daemon::report::Ended;
use gripcast_base::error::{Error, Result};
use gripcast_capture::camera::monotonic_ns;
use gripcast_capture::trigger::{self, Answer, ScriptAction};
use gripcast_session::{Command, CommandResult, CommandSource};

/// The script's newest command and its answer.
#[derive(Debug, Default)]
pub(super) struct ScriptCommand {
    /// Given and not answered yet.
    open: Option<oneshot::Receiver<CommandResult>>,
    answer: Option<Answer>,
}

impl ScriptCommand {
    /// The answer, once it has come.
    fn answer(&mut self) -> Option<Answer> {
        let result = self.open.as_mut().and_then(|open| open.try_recv().ok());
        if let Some(result) = result {
            self.open = None;
            self.answer = Some(match result.error_message() {
                Some(complaint) => Answer::Refused(complaint),
                None => Answer::Saved,
            });
        }
        self.answer.clone()
    }
}

impl Engine {
    pub(super) fn advance_script(&mut self) -> Result<Option<Ended>> {
        let conditions = trigger::Conditions {
            all_live: self.all_live(),
            contact: self.touched(),
            fresh: self.fresh(),
            saving: self.session.is_storing(),
            last_answer: self.script_command.answer(),
        };
        let Some(script) = &mut self.script else {
            return Ok(None);
        };
        match script.next(monotonic_ns(), &conditions) {
            ScriptAction::Wait => Ok(None),
            ScriptAction::Done => Ok(Some(Ended::ScriptDone)),
            ScriptAction::Failed(error) => Err(error),
            ScriptAction::Command(text) => {
                let command: Command = text
                    .parse()
                    .map_err(|e| Error::internal("the script was not checked").because(e))?;
                let (asked, answer) = Asked::with_answer(command, CommandSource::Script);
                self.script_command = ScriptCommand {
                    open: Some(answer),
                    answer: None,
                };
                self.waiting.push_back(asked);
                Ok(None)
            }
        }
    }
}
