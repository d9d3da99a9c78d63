//! Requests to the engine to carry out a command.

use tokio::sync::oneshot;

use gripcast_session::{Command, CommandResult, CommandSource};

/// A command for the engine.
#[derive(Debug)]
pub struct CommandRequest {
    /// The command.
    pub command: Command,
    /// Source of the command.
    pub source: CommandSource,
    /// Where the result goes, if the sender waits for it.
    pub response: Option<oneshot::Sender<CommandResult>>,
}

impl CommandRequest {
    /// Creates a request without a response; the sender reads the outcome from the status.
    pub fn new(command: Command, source: CommandSource) -> Self {
        Self {
            command,
            source,
            response: None,
        }
    }

    /// Creates a request and the receiver of its result, which arrives once all changes are
    /// durable.
    pub fn with_response(
        command: Command,
        source: CommandSource,
    ) -> (Self, oneshot::Receiver<CommandResult>) {
        let (response, receiver) = oneshot::channel();
        let request = Self {
            response: Some(response),
            ..Self::new(command, source)
        };
        (request, receiver)
    }
}
