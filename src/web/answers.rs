//! Answers to the newest commands by their request id, so that a repeated command is executed once.

use std::collections::VecDeque;

use futures_util::FutureExt as _;
use futures_util::future::Shared;
use tokio::sync::oneshot;

use super::sender::RequestId;
use gripcast_session::{Command, CommandResult};

/// Maximum number of commands that are remembered.
const CAPACITY: usize = 512;

/// The answer to a command, once it is there; any number of requests may wait for it.
pub(super) type Answer = Shared<oneshot::Receiver<CommandResult>>;

/// Commands with a request id, oldest first.
#[derive(Debug, Default)]
pub(super) struct Answers(VecDeque<Answered>);

#[derive(Debug)]
struct Answered {
    id: RequestId,
    command: Command,
    answer: Answer,
}

impl Answers {
    /// Returns the answer to the command with an id, and whether it was this command.
    pub(super) fn find(&self, id: &RequestId, command: &Command) -> Option<(Answer, bool)> {
        let found = self.0.iter().find(|answered| answered.id == *id)?;
        Some((found.answer.clone(), found.command == *command))
    }

    /// Returns the answer to the command with an id.
    pub(super) fn get(&self, id: &RequestId) -> Option<Answer> {
        let found = self.0.iter().find(|answered| answered.id == *id);
        found.map(|answered| answered.answer.clone())
    }

    /// Remembers a command that was sent to the engine and returns its answer.
    pub(super) fn add(
        &mut self,
        id: Option<RequestId>,
        command: Command,
        response: oneshot::Receiver<CommandResult>,
    ) -> Answer {
        let answer = response.shared();
        if let Some(id) = id {
            if self.0.len() == CAPACITY {
                self.0.pop_front();
            }
            self.0.push_back(Answered {
                id,
                command,
                answer: answer.clone(),
            });
        }
        answer
    }
}
