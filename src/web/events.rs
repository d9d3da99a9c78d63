//! The engine's state and news over a WebSocket, and commands the other way.
//!
//! Text to the client: `{"type": "state" | "tone" | "stored" | "answer" | "bye", …}`. Text from
//! the client: `{"command": "trigger", "id": 7}`, answered with the same id. With `?previews=true`
//! the small images come too, as binary messages: one byte, the place of the role in
//! left, right, rgb, depth, external, then a JPEG.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Query, State as Shared};
use axum::response::Response;
use serde::{Deserialize, Serialize};
use tokio::sync::broadcast::error::RecvError;
use utoipa::{IntoParams, ToSchema};

use super::access::{Pass, Peer};
use super::backend::{Backend, News};
use super::commands::{CommandResponse, carry_out, parse};
use super::failure::Failure;
use crate::daemon::{EngineStatus, StoreEvent};
use gripcast_imaging::Role;
use gripcast_session::Tone;

/// Shortest time between two states.
const PAUSE: Duration = Duration::from_millis(100);
/// Longest message of a client, bytes.
const MAX_MESSAGE: usize = 4096;

/// What a client wants to hear.
#[derive(Clone, Copy, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(crate) struct EventQuery {
    /// Small images as binary messages too.
    #[serde(default)]
    #[param(default = false)]
    previews: bool,
}

/// A message to the client.
#[derive(Serialize, ToSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub(crate) enum Event {
    /// The engine now, ten times a second at most.
    State { state: Box<EngineStatus> },
    /// A sound.
    Tone { tone: Tone },
    /// A change of the dataset was answered.
    Stored {
        #[schema(value_type = serde_json::Value)]
        stored: Box<StoreEvent>,
    },
    /// What became of a command of this client.
    Answer {
        id: u64,
        answer: Option<Box<CommandResponse>>,
        /// Why there is no answer.
        error: Option<String>,
    },
    /// The daemon ends.
    Bye,
}

/// A message from the client.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Request {
    command: String,
    id: u64,
}

/// State and news as they come (WebSocket)
///
/// Messages are described in docs/api.md.
#[utoipa::path(get, path = "/api/events", tag = "session", params(EventQuery),
    responses((status = 101, description = "switched to the WebSocket protocol"),
        (status = 400, body = super::failure::ErrorResponse),
        (status = 503, body = super::failure::ErrorResponse)))]
pub(crate) async fn events(
    Shared(backend): Shared<Arc<Backend>>,
    Extension(peer): Extension<Peer>,
    Extension(pass): Extension<Pass>,
    query: Result<Query<EventQuery>, axum::extract::rejection::QueryRejection>,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Result<Response, Failure> {
    let Query(query) = query.map_err(|e| Failure::new(e.status(), e.body_text()))?;
    let upgrade = upgrade.map_err(|e| {
        Failure::new(axum::http::StatusCode::BAD_REQUEST, e.body_text())
            .remedy("open it as a WebSocket")
    })?;
    let place = backend.listeners.take(peer).ok_or_else(|| {
        Failure::busy("too many listen to events already").remedy("close another page")
    })?;
    // A frame is refused by its length, before any of it is kept.
    let upgrade = upgrade
        .max_frame_size(MAX_MESSAGE)
        .max_message_size(MAX_MESSAGE)
        .read_buffer_size(MAX_MESSAGE);
    Ok(upgrade.on_upgrade(move |socket| async move {
        // A client that goes, or takes nothing, ends its own connection only.
        let _ = Listener::new(backend, pass, socket, query).run().await;
        drop(place);
    }))
}

struct Disconnected;

struct Listener {
    backend: Arc<Backend>,
    pass: Pass,
    socket: WebSocket,
    query: EventQuery,
    /// The newest image sent of each role.
    sent: BTreeMap<Role, Bytes>,
}

impl Listener {
    fn new(backend: Arc<Backend>, pass: Pass, socket: WebSocket, query: EventQuery) -> Self {
        Self {
            backend,
            pass,
            socket,
            query,
            sent: BTreeMap::new(),
        }
    }

    async fn run(mut self) -> Result<(), Disconnected> {
        let mut news = self.backend.news.subscribe();
        let mut ticks = tokio::time::interval(PAUSE);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                heard = news.recv() => match heard {
                    Ok(News::Tone(tone)) => self.say(&Event::Tone { tone }).await?,
                    Ok(News::Stored(stored)) => {
                        let stored = Box::new((*stored).clone());
                        self.say(&Event::Stored { stored }).await?;
                    }
                    Ok(News::Bye) | Err(RecvError::Closed) => return self.say(&Event::Bye).await,
                    // What was missed is in the next state.
                    Err(RecvError::Lagged(_)) => {}
                },
                message = self.socket.recv() => match message {
                    Some(Ok(Message::Text(text))) => self.take(&text).await?,
                    // Pings are answered by the library.
                    Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Binary(_))) => {}
                    Some(Ok(Message::Close(_)) | Err(_)) | None => return Err(Disconnected),
                },
                _ = ticks.tick() => {
                    // Its session has ended.
                    if !self.pass.holds() {
                        return Err(Disconnected);
                    }
                    let state = Box::new(self.backend.state());
                    self.say(&Event::State { state }).await?;
                    if self.query.previews {
                        self.show().await?;
                    }
                }
            }
        }
    }

    async fn take(&mut self, text: &str) -> Result<(), Disconnected> {
        let Ok(Request { command, id }) = serde_json::from_str(text) else {
            let error = Some("expected {\"command\": \"…\", \"id\": 1}".to_owned());
            return self
                .say(&Event::Answer {
                    id: 0,
                    answer: None,
                    error,
                })
                .await;
        };
        if !self.pass.holds() {
            return Err(Disconnected);
        }
        let carried_out = match parse(&command) {
            Ok(command) => carry_out(&self.backend, command).await,
            Err(failure) => Err(failure),
        };
        let (answer, error) = match carried_out {
            Ok((_, axum::Json(answer))) => (Some(Box::new(answer)), None),
            Err(failure) => (None, Some(failure.what().to_owned())),
        };
        self.say(&Event::Answer { id, answer, error }).await
    }

    async fn show(&mut self) -> Result<(), Disconnected> {
        for (place, role) in Role::ALL.into_iter().enumerate() {
            let Some(jpeg) = self.backend.previews.jpeg(role) else {
                continue;
            };
            let known = self.sent.get(&role);
            if known.is_some_and(|known| known.as_ptr() == jpeg.as_ptr()) {
                continue;
            }
            let message = [&[place as u8][..], &jpeg].concat();
            self.sent.insert(role, jpeg);
            self.send(Message::Binary(message.into())).await?;
        }
        Ok(())
    }

    async fn say(&mut self, event: &Event) -> Result<(), Disconnected> {
        let text = serde_json::to_string(event).map_err(|_| Disconnected)?;
        self.send(Message::Text(text.into())).await
    }

    async fn send(&mut self, message: Message) -> Result<(), Disconnected> {
        self.socket.send(message).await.map_err(|_| Disconnected)
    }
}
