//! State shared by all handlers.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use tokio::sync::{Semaphore, broadcast, mpsc, watch};

use super::access::Access;
use super::answers::{Answer, Answers};
use super::failure::Failure;
use super::grasp_list::GraspList;
use super::previews::Previews;
use super::sender::{Arrival, RequestId, Sender};
use super::slots::Slots;
use crate::daemon::{CommandRequest, EngineStatus, ModelInfo, StoreEvent, Tasks, lock};
use gripcast_dataset::GraspIndex;
use gripcast_session::{Command, CommandResult, CommandSource, Tone};

/// Queued news for a slow reader; the oldest are dropped.
const NEWS_CAPACITY: usize = 64;
/// Maximum event connections over TCP and over the socket.
const MAX_LISTENERS: usize = 32;
/// Timeout for the body of a request, at most 16 KiB.
const BODY_TIMEOUT: Duration = Duration::from_secs(10);
/// Maximum wait of a preview image for a decoder.
const DECODE_TIMEOUT: Duration = Duration::from_secs(5);
/// Timeout of a command; a save on an ordinary disk takes 0.1 s.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(20);

/// News for all event connections.
#[derive(Clone, Debug)]
pub(crate) enum News {
    /// A sound of the session.
    Tone(Tone),
    /// A store request was executed or failed.
    Stored(Arc<StoreEvent>),
    /// The daemon is shutting down.
    Shutdown,
}

/// State shared by all handlers.
pub(crate) struct Backend {
    pub(crate) status: watch::Receiver<Arc<EngineStatus>>,
    pub(crate) commands: mpsc::Sender<CommandRequest>,
    answers: Mutex<Answers>,
    pub(crate) news: broadcast::Sender<News>,
    pub(crate) tasks: Tasks,
    pub(crate) access: Arc<Access>,
    pub(crate) model: Option<ModelInfo>,
    pub(crate) grasps: GraspList,
    pub(crate) previews: Previews,
    pub(crate) started: Instant,
    /// Slots of event connections.
    pub(crate) listeners: Slots,
    /// Slots of image decoding, one per core.
    pub(crate) decodes: Arc<Semaphore>,
    pub(crate) body_timeout: Duration,
    pub(crate) decode_timeout: Duration,
}

impl Backend {
    /// Creates a backend for the engine's channels and the index of its dataset.
    pub(crate) fn new(
        status: watch::Receiver<Arc<EngineStatus>>,
        commands: mpsc::Sender<CommandRequest>,
        tasks: Tasks,
        access: Arc<Access>,
        model: Option<ModelInfo>,
        index: GraspIndex,
    ) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            previews: Previews::new(status.clone()),
            status,
            commands,
            answers: Mutex::default(),
            news: broadcast::channel(NEWS_CAPACITY).0,
            tasks,
            access,
            model,
            grasps: GraspList::new(index),
            started: Instant::now(),
            listeners: Slots::new(MAX_LISTENERS, MAX_LISTENERS),
            decodes: Arc::new(Semaphore::new(cores)),
            body_timeout: BODY_TIMEOUT,
            decode_timeout: DECODE_TIMEOUT,
        }
    }

    /// Returns the engine's current status.
    pub(crate) fn state(&self) -> EngineStatus {
        EngineStatus::clone(&self.status.borrow())
    }

    /// Sends a command to the engine, unless one with the same request id was sent before.
    ///
    /// # Errors
    /// 422 for an impossible age or the id of another command, 503 if too many commands are queued
    /// or the engine is ending.
    pub(crate) fn submit(
        &self,
        command: Command,
        sender: Sender,
        arrival: Arrival,
    ) -> Result<Answer, Failure> {
        let given_ns = sender.given_ns(arrival)?;
        let mut answers = lock(&self.answers);
        if let Some(id) = &sender.request_id
            && let Some((answer, is_same)) = answers.find(id, &command)
        {
            return if is_same {
                Ok(answer)
            } else {
                Err(id.reused())
            };
        }
        let (request, response) =
            CommandRequest::with_response(command.clone(), CommandSource::Remote);
        let request = CommandRequest {
            given_ns,
            seen: sender.seen,
            ..request
        };
        self.commands.try_send(request).map_err(|e| match e {
            mpsc::error::TrySendError::Full(_) => Failure::busy("too many commands are queued"),
            mpsc::error::TrySendError::Closed(_) => Failure::busy("the daemon is shutting down"),
        })?;
        Ok(answers.add(sender.request_id, command, response))
    }

    /// Returns the answer to the command with a request id.
    ///
    /// # Errors
    /// 404 if no such command arrived.
    pub(crate) fn answer_to(&self, id: &RequestId) -> Result<Answer, Failure> {
        lock(&self.answers).get(id).ok_or_else(|| id.unknown())
    }
}

/// Waits until the changes of a command are durable.
///
/// # Errors
/// 503 if the engine is ending, 504 on timeout.
pub(crate) async fn wait_for(answer: Answer) -> Result<CommandResult, Failure> {
    match tokio::time::timeout(RESPONSE_TIMEOUT, answer).await {
        Ok(Ok(result)) => Ok(result),
        Ok(Err(_)) => Err(Failure::busy("the daemon is shutting down")),
        Err(_) => Err(Failure::new(
            StatusCode::GATEWAY_TIMEOUT,
            "the engine did not respond in time; the command may still be executed",
        )),
    }
}
