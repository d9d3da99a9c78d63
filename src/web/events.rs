//! WebSocket with the engine's state and events, and commands from the client.
//!
//! Text to the client: `{"type": "state" | "tone" | "stored" | "response" | "shutdown", …}`. Text
//! from the client: `{"command": "trigger", "id": 7, "sender": {…}}`; the response has the same id.
//! With `?previews=true` preview images are sent as binary messages: one byte, then a JPEG. The byte
//! is the index of the role in left, right, rgb, depth, external, plus 16 for the difference of a gel
//! to the initial frame.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Query, State as Shared};
use axum::response::Response;
use futures_util::StreamExt as _;
use futures_util::future::BoxFuture;
use futures_util::stream::FuturesUnordered;
use serde::{Deserialize, Serialize};
use tokio::sync::broadcast::error::RecvError;
use utoipa::{IntoParams, ToSchema};

use super::access::{Authorisation, Peer};
use super::backend::{Backend, News};
use super::commands::{CommandResponse, parse, reply};
use super::failure::Failure;
use super::sender::{Arrival, Sender};
use crate::daemon::{EngineStatus, StoreEvent};
use gripcast_imaging::Role;
use gripcast_session::Tone;

/// Minimum interval between two state messages.
const INTERVAL: Duration = Duration::from_millis(100);
/// Maximum size of a client message, bytes.
const MAX_MESSAGE_BYTES: usize = 4096;
/// Maximum commands of a client in progress.
const MAX_COMMANDS: usize = 16;

/// Added to the index of a role for a tactile difference.
pub(super) const DIFFERENCE: u8 = 16;

/// Query of an event connection.
#[derive(Clone, Copy, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(crate) struct EventQuery {
    /// Also send preview images as binary messages.
    #[serde(default)]
    #[param(default = false)]
    previews: bool,
}

/// A message to the client.
#[derive(Serialize, ToSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub(crate) enum Event {
    /// State of the engine, at most ten times per second.
    State { state: Box<EngineStatus> },
    /// A sound.
    Tone { tone: Tone },
    /// A store request was executed or failed.
    Stored {
        #[schema(value_type = serde_json::Value)]
        stored: Box<StoreEvent>,
    },
    /// Response to a command of this client.
    Response {
        id: u64,
        response: Option<Box<CommandResponse>>,
        /// Error if the command was not executed.
        error: Option<String>,
    },
    /// The daemon is shutting down.
    Shutdown,
}

/// A message from the client.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Request {
    command: String,
    id: u64,
    #[serde(default)]
    sender: Sender,
}

/// State and events (WebSocket)
///
/// Messages are described in docs/reference/api.md.
#[utoipa::path(get, path = "/api/events", tag = "session", params(EventQuery),
    responses((status = 101, description = "switched to the WebSocket protocol"),
        (status = 400, body = super::failure::ErrorResponse),
        (status = 503, body = super::failure::ErrorResponse)))]
pub(crate) async fn events(
    Shared(backend): Shared<Arc<Backend>>,
    Extension(peer): Extension<Peer>,
    Extension(authorisation): Extension<Authorisation>,
    query: Result<Query<EventQuery>, axum::extract::rejection::QueryRejection>,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Result<Response, Failure> {
    let Query(query) = query.map_err(|e| Failure::new(e.status(), e.body_text()))?;
    let upgrade = upgrade.map_err(|e| {
        Failure::new(axum::http::StatusCode::BAD_REQUEST, e.body_text()).remedy(
            "open it as a WebSocket; a proxy must pass the headers `Upgrade` and `Connection`",
        )
    })?;
    let permit = backend.listeners.take(peer).ok_or_else(|| {
        Failure::busy("too many event connections are open").remedy("close another page")
    })?;
    // Large frames are rejected by their length before they are read.
    let upgrade = upgrade
        .max_frame_size(MAX_MESSAGE_BYTES)
        .max_message_size(MAX_MESSAGE_BYTES)
        .read_buffer_size(MAX_MESSAGE_BYTES);
    Ok(upgrade.on_upgrade(move |socket| async move {
        // A client error ends its own connection only.
        let listener = Listener {
            backend,
            authorisation,
            socket,
            query,
            sent: BTreeMap::new(),
            answers: FuturesUnordered::new(),
        };
        let _ = listener.run().await;
        drop(permit);
    }))
}

/// Response to a command that was not executed.
fn failed(id: u64, error: &str) -> Event {
    Event::Response {
        id,
        response: None,
        error: Some(error.to_owned()),
    }
}

/// The client has disconnected, or its session has ended.
struct Disconnected;

struct Listener {
    backend: Arc<Backend>,
    authorisation: Authorisation,
    socket: WebSocket,
    query: EventQuery,
    /// Newest image sent, by the first byte of its message.
    sent: BTreeMap<u8, Bytes>,
    /// Responses to commands in progress.
    answers: FuturesUnordered<BoxFuture<'static, Event>>,
}

impl Listener {
    async fn run(mut self) -> Result<(), Disconnected> {
        let mut news = self.backend.news.subscribe();
        let mut ticks = tokio::time::interval(INTERVAL);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                received = news.recv() => match received {
                    Ok(News::Tone(tone)) => self.send_event(&Event::Tone { tone }).await?,
                    Ok(News::Stored(stored)) => {
                        let stored = Box::new((*stored).clone());
                        self.send_event(&Event::Stored { stored }).await?;
                    }
                    Ok(News::Shutdown) | Err(RecvError::Closed) => return self.send_event(&Event::Shutdown).await,
                    // Missed news are reflected in the next state.
                    Err(RecvError::Lagged(_)) => {}
                },
                Some(response) = self.answers.next() => self.send_event(&response).await?,
                message = self.socket.recv() => match message {
                    Some(Ok(Message::Text(text))) => self.handle(&text).await?,
                    // Pings are answered by the library.
                    Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Binary(_))) => {}
                    Some(Ok(Message::Close(_)) | Err(_)) | None => return Err(Disconnected),
                },
                _ = ticks.tick() => {
                    // The session has ended.
                    if !self.authorisation.is_valid() {
                        return Err(Disconnected);
                    }
                    let state = Box::new(self.backend.state());
                    self.send_event(&Event::State { state }).await?;
                    if self.query.previews {
                        self.send_previews().await?;
                    }
                }
            }
        }
    }

    /// Sends a command to the engine; the response follows while states go on.
    async fn handle(&mut self, text: &str) -> Result<(), Disconnected> {
        let arrival = Arrival::now();
        let Ok(Request {
            command,
            id,
            sender,
        }) = serde_json::from_str(text)
        else {
            let error = "expected {\"command\": \"…\", \"id\": 1, \"sender\": {…}}";
            return self.send_event(&failed(0, error)).await;
        };
        if !self.authorisation.is_valid() {
            return Err(Disconnected);
        }
        if self.answers.len() >= MAX_COMMANDS {
            return self
                .send_event(&failed(id, "too many commands are queued"))
                .await;
        }
        let submitted =
            parse(&command).and_then(|command| self.backend.submit(command, sender, arrival));
        let backend = Arc::clone(&self.backend);
        self.answers.push(Box::pin(async move {
            let result = match submitted {
                Ok(answer) => reply(&backend, answer).await,
                Err(failure) => Err(failure),
            };
            match result {
                Ok((_, axum::Json(response))) => Event::Response {
                    id,
                    response: Some(Box::new(response)),
                    error: None,
                },
                Err(failure) => failed(id, failure.what()),
            }
        }));
        Ok(())
    }

    async fn send_previews(&mut self) -> Result<(), Disconnected> {
        for (index, role) in (0..).zip(Role::ALL) {
            self.send_preview(index, self.backend.previews.jpeg(role))
                .await?;
            if role.is_tactile() {
                let difference = self.backend.previews.difference(role);
                self.send_preview(DIFFERENCE + index, difference).await?;
            }
        }
        Ok(())
    }

    /// Sends an image that was not sent yet.
    async fn send_preview(&mut self, first: u8, jpeg: Option<Bytes>) -> Result<(), Disconnected> {
        let Some(jpeg) = jpeg else { return Ok(()) };
        let sent = self.sent.get(&first);
        if sent.is_some_and(|sent| sent.as_ptr() == jpeg.as_ptr()) {
            return Ok(());
        }
        let message = [&[first][..], &jpeg].concat();
        self.sent.insert(first, jpeg);
        self.send(Message::Binary(message.into())).await
    }

    async fn send_event(&mut self, event: &Event) -> Result<(), Disconnected> {
        let text = serde_json::to_string(event).map_err(|_| Disconnected)?;
        self.send(Message::Text(text.into())).await
    }

    async fn send(&mut self, message: Message) -> Result<(), Disconnected> {
        self.socket.send(message).await.map_err(|_| Disconnected)
    }
}
