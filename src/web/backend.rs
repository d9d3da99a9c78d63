//! What all handlers fraction.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use tokio::sync::{Semaphore, broadcast, mpsc, watch};

use super::access::Access;
use super::failure::Failure;
use super::grasp_list::GraspList;
use super::previews::Previews;
use super::slots::Slots;
use crate::daemon::{CommandRequest, EngineStatus, ModelInfo, StoreEvent, Tasks};
use gripcast_session::{Command, CommandResult, CommandSource, Tone};

/// News that wait for a reader that is slow; it misses the oldest.
const NEWS_CAPACITY: usize = 64;
/// Those who listen to events at a time, over TCP and over the socket: pages, screens, programs.
const MAX_LISTENERS: usize = 32;
/// How long a client may take for the body of a request; the largest has 16 KiB.
const BODY_TIMEOUT: Duration = Duration::from_secs(10);
/// How long a small image may wait until others have been decoded.
const DECODE_TIMEOUT: Duration = Duration::from_secs(5);
/// How long an answer may take; a save on an ordinary disk takes a tenth of a second.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(20);

/// What happened, for all who listen.
#[derive(Clone, Debug)]
pub(crate) enum News {
    /// A sound of the session.
    Tone(Tone),
    /// A change of the dataset is durable, or failed.
    Stored(Arc<StoreEvent>),
    /// The daemon ends.
    Bye,
}

/// What all handlers fraction.
pub(crate) struct Backend {
    pub(crate) status: watch::Receiver<Arc<EngineStatus>>,
    pub(crate) commands: mpsc::Sender<CommandRequest>,
    pub(crate) news: broadcast::Sender<News>,
    pub(crate) tasks: Tasks,
    pub(crate) access: Arc<Access>,
    pub(crate) model: Option<ModelInfo>,
    pub(crate) grasps: GraspList,
    pub(crate) previews: Previews,
    pub(crate) started: Instant,
    /// Slots for those who listen to events.
    pub(crate) listeners: Slots,
    /// Slots for images that are decoded, one for each core.
    pub(crate) decodes: Arc<Semaphore>,
    pub(crate) body_timeout: Duration,
    pub(crate) decode_timeout: Duration,
}

impl Backend {
    /// A backend on the engine's channels and the dataset that it writes.
    pub(crate) fn new(
        status: watch::Receiver<Arc<EngineStatus>>,
        commands: mpsc::Sender<CommandRequest>,
        tasks: Tasks,
        access: Arc<Access>,
        model: Option<ModelInfo>,
        dataset: PathBuf,
    ) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            previews: Previews::new(status.clone()),
            status,
            commands,
            news: broadcast::channel(NEWS_CAPACITY).0,
            tasks,
            access,
            model,
            grasps: GraspList::new(dataset),
            started: Instant::now(),
            listeners: Slots::new(MAX_LISTENERS, MAX_LISTENERS),
            decodes: Arc::new(Semaphore::new(cores)),
            body_timeout: BODY_TIMEOUT,
            decode_timeout: DECODE_TIMEOUT,
        }
    }

    /// The engine now.
    pub(crate) fn state(&self) -> EngineStatus {
        EngineStatus::clone(&self.status.borrow())
    }

    /// Asks the engine and waits until what was asked for is durable.
    ///
    /// # Errors
    /// 503 while too many commands wait or the engine ends, 504 when it does not answer.
    pub(crate) async fn ask(&self, command: Command) -> Result<CommandResult, Failure> {
        let (asked, answer) = CommandRequest::with_response(command, CommandSource::Remote);
        self.commands.try_send(asked).map_err(|e| match e {
            mpsc::error::TrySendError::Full(_) => Failure::busy("too many commands wait already"),
            mpsc::error::TrySendError::Closed(_) => Failure::busy("the daemon is ending"),
        })?;
        match tokio::time::timeout(RESPONSE_TIMEOUT, answer).await {
            Ok(Ok(result)) => Ok(result),
            Ok(Err(_)) => Err(Failure::busy("the daemon is ending")),
            Err(_) => Err(Failure::new(
                StatusCode::GATEWAY_TIMEOUT,
                "the engine has not answered; the command may still be carried out",
            )),
        }
    }
}
