//! Commands on their way to the engine.

use tokio::sync::oneshot;

use gripcast_session::{Command, CommandResult, CommandSource};

/// A command for the engine.
#[derive(Debug)]
pub struct Asked {
    /// What is asked for.
    pub command: Command,
    /// Where it came from.
    pub source: CommandSource,
    /// Who wants to know what became of it.
    pub answer: Option<oneshot::Sender<CommandResult>>,
}

impl Asked {
    /// A command whose sender reads the outcome off the status.
    #[must_use]
    pub fn new(command: Command, source: CommandSource) -> Self {
        Self {
            command,
            source,
            answer: None,
        }
    }

    /// A command and its result, which comes when all that it asked for is durable.
    #[must_use]
    pub fn with_answer(
        command: Command,
        source: CommandSource,
    ) -> (Self, oneshot::Receiver<CommandResult>) {
        let (answer, receiver) = oneshot::channel();
        let asked = Self {
            answer: Some(answer),
            ..Self::new(command, source)
        };
        (asked, receiver)
    }
}
