//! Requests to the engine to carry out a command.

use tokio::sync::oneshot;

use gripcast_capture::camera::monotonic_ns;
use gripcast_session::{Command, CommandResult, CommandSource, Seen};

/// A command for the engine.
#[derive(Debug)]
pub struct CommandRequest {
    /// The command.
    pub command: Command,
    /// Source of the command.
    pub source: CommandSource,
    /// Time at which the operator gave it, `CLOCK_MONOTONIC`, ns. The engine refuses a command that
    /// has become too old, wherever it waited.
    pub given_ns: u64,
    /// What its sender saw.
    pub seen: Seen,
    /// Where the result goes, if the sender waits for it.
    pub response: Option<oneshot::Sender<CommandResult>>,
}

impl CommandRequest {
    /// Creates a request that is given now, without a response; the sender reads the outcome from
    /// the status.
    pub fn new(command: Command, source: CommandSource) -> Self {
        Self {
            command,
            source,
            given_ns: monotonic_ns(),
            seen: Seen::default(),
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

    /// Time since the operator gave it, ms. The steps of a script have no age: a script waits.
    pub fn age_ms(&self, now_ns: u64) -> f64 {
        match self.source {
            CommandSource::Script => 0.0,
            _ => now_ns.saturating_sub(self.given_ns) as f64 * 1e-6,
        }
    }
}
