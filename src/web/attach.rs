//! Screen attached to a running daemon: state and images arrive over the API, commands go back.

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use futures_util::{SinkExt as _, StreamExt as _};
use serde::Deserialize;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpStream, UnixStream};
use tokio::sync::{mpsc, watch};
use tokio::time::{Duration, Instant};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{Error as WsError, Message};

use super::access::Token;
use super::attached_commands::{SentCommands, monotonic_ms};
use super::events::DIFFERENCE;
use crate::daemon::{CommandRequest, EngineStatus, Preview};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_imaging::{Decoder, Role};
use gripcast_session::{Command, CommandResult, Message as SessionMessage, MessageLevel, Tone};

/// Time without a message after which the line is dead; states come ten times per second.
const SILENCE: Duration = Duration::from_secs(6);

/// Address of a daemon.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Target {
    /// A Unix socket.
    Socket(PathBuf),
    /// `HOST:PORT`.
    Address(String),
}

impl Target {
    /// Parses `http://HOST:PORT` or the path of a socket.
    ///
    /// # Errors
    /// `Usage` for an invalid address.
    pub(crate) fn parse(text: &str) -> Result<Self> {
        if let Some(rest) = text.strip_prefix("http://") {
            let address = rest.trim_end_matches('/');
            if address.contains(':') && !address.contains('/') {
                return Ok(Self::Address(address.to_owned()));
            }
        } else if !text.contains("://") && !text.is_empty() {
            return Ok(Self::Socket(PathBuf::from(text)));
        }
        Err(Error::usage(format!("invalid daemon address `{text}`"))
            .remedy("use http://127.0.0.1:7471, or the path of the daemon's socket"))
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Socket(path) => write!(f, "{}", path.display()),
            Self::Address(address) => write!(f, "http://{address}"),
        }
    }
}

/// How the attachment ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Attached {
    /// The operator left; the daemon continues.
    Left,
    /// The daemon ended.
    Ended,
}

/// Events of the daemon that a screen uses.
#[derive(Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum DaemonEvent {
    State {
        state: Box<EngineStatus>,
    },
    Tone {
        tone: Tone,
    },
    Response {
        id: u64,
        response: Option<CommandResult>,
        error: Option<String>,
    },
    Shutdown,
    #[serde(other)]
    Other,
}

/// Channels of the screen.
pub(crate) struct Screen {
    /// Outgoing status.
    pub(crate) status: watch::Sender<Arc<EngineStatus>>,
    /// Outgoing tones.
    pub(crate) tones: mpsc::UnboundedSender<Tone>,
    /// Commands of the operator; `quit` detaches.
    pub(crate) commands: mpsc::Receiver<CommandRequest>,
}

/// Shows a daemon on a screen until the operator leaves or the daemon ends.
///
/// # Errors
/// `NotFound` or `Io` if no daemon responds, `Permission` without its token, `Io` on connection
/// loss.
pub(crate) async fn attach(
    target: &Target,
    token: Option<&Token>,
    screen: Screen,
) -> Result<Attached> {
    let unreachable = |e| {
        Error::io("no daemon responds", e)
            .at(target)
            .remedy("start one with `gripcast daemon`, or `systemctl start gripcast`")
    };
    match target {
        Target::Socket(path) => {
            let stream = UnixStream::connect(path).await.map_err(unreachable)?;
            show(stream, "localhost", target, token, screen).await
        }
        Target::Address(address) => {
            let stream = TcpStream::connect(address).await.map_err(unreachable)?;
            show(stream, address, target, token, screen).await
        }
    }
}

async fn show<S: AsyncRead + AsyncWrite + Unpin>(
    stream: S,
    host: &str,
    target: &Target,
    token: Option<&Token>,
    mut screen: Screen,
) -> Result<Attached> {
    let mut socket = open(stream, host, token)
        .await
        .map_err(|e| refused(e, target))?;
    let mut received = Received {
        decoder: Decoder::new()?,
        previews: BTreeMap::new(),
        state: None,
        sent: SentCommands::default(),
    };
    let mut heard = Instant::now();
    loop {
        tokio::select! {
            message = socket.next() => {
                heard = Instant::now();
                match message {
                    Some(Ok(Message::Text(text))) => match serde_json::from_str(&text) {
                        Ok(DaemonEvent::State { state }) => received.take_state(*state),
                        // A closed screen detaches next.
                        Ok(DaemonEvent::Tone { tone }) => drop(screen.tones.send(tone)),
                        Ok(DaemonEvent::Response { id, response, error }) => {
                            received.sent.answer(id, response, error);
                        }
                        Ok(DaemonEvent::Shutdown) => return Ok(Attached::Ended),
                        Ok(DaemonEvent::Other) => continue,
                        Err(e) => return Err(version_mismatch(e, target)),
                    },
                    Some(Ok(Message::Binary(bytes))) => received.take_image(&bytes),
                    Some(Ok(Message::Close(_))) => return Ok(Attached::Ended),
                    Some(Ok(_)) => continue,
                    Some(Err(e)) => return Err(received.sent.broken(e, target)),
                    None => return Ok(Attached::Ended),
                }
            }
            request = screen.commands.recv() => match request {
                None | Some(CommandRequest { command: Command::Quit, .. }) => return Ok(Attached::Left),
                Some(request) => {
                    let text = received.sent.message(request, received.state.as_ref());
                    let sent = socket.send(Message::Text(text.into())).await;
                    sent.map_err(|e| received.sent.broken(e, target))?;
                }
            },
            // A dead line keeps its connection for minutes.
            () = tokio::time::sleep_until(heard + SILENCE) => {
                let silent = io::Error::from(io::ErrorKind::TimedOut);
                return Err(received.sent.broken(silent.into(), target));
            }
        }
        if let Some(status) = received.status() {
            let _ = screen.status.send(Arc::new(status));
        }
    }
}

/// Newest state and images received.
struct Received {
    decoder: Decoder,
    previews: BTreeMap<Role, Preview>,
    state: Option<EngineStatus>,
    sent: SentCommands,
}

impl Received {
    /// Takes an image: the index of its role, plus [`DIFFERENCE`] for a difference, then a JPEG.
    /// Invalid images are ignored.
    fn take_image(&mut self, bytes: &[u8]) {
        let Some((first, jpeg)) = bytes.split_first() else {
            return;
        };
        let role = Role::ALL.get(usize::from(first % DIFFERENCE)).copied();
        let Some((role, image)) = role.zip(self.decoder.stored_image(jpeg).ok()) else {
            return;
        };
        let image = Arc::new(image);
        if *first < DIFFERENCE {
            let difference = self.previews.remove(&role).and_then(|old| old.difference);
            let preview = Preview {
                image,
                difference,
                levels: None,
                // The event connection does not send it.
                driver_time_ns: 0,
            };
            self.previews.insert(role, preview);
        } else if let Some(preview) = self.previews.get_mut(&role) {
            preview.difference = Some(image);
        }
    }

    fn take_state(&mut self, state: EngineStatus) {
        self.sent.clock.note(state.monotonic_ms, monotonic_ms());
        self.state = Some(state);
    }

    fn status(&mut self) -> Option<EngineStatus> {
        let state = self.state.clone()?;
        if state.session.initial_at.is_none() {
            for preview in self.previews.values_mut() {
                preview.difference = None;
            }
        }
        let mut status = EngineStatus {
            previews: self.previews.clone(),
            ..state
        };
        if let Some(text) = self.sent.refusal.clone() {
            status.session.message = Some(SessionMessage {
                level: MessageLevel::Warning,
                text,
            });
        }
        Some(status)
    }
}

async fn open<S: AsyncRead + AsyncWrite + Unpin>(
    stream: S,
    host: &str,
    token: Option<&Token>,
) -> std::result::Result<WebSocketStream<S>, WsError> {
    let uri = format!("ws://{host}/api/events?previews=true");
    let mut request = uri.into_client_request()?;
    if let Some(token) = token
        && let Ok(value) = HeaderValue::from_str(&token.bearer())
    {
        request.headers_mut().insert("Authorization", value);
    }
    let (socket, _) = tokio_tungstenite::client_async(request, stream).await?;
    Ok(socket)
}

fn refused(error: WsError, target: &Target) -> Error {
    let error = match error {
        WsError::Http(response) if response.status().as_u16() == 401 => {
            Error::new(ErrorKind::Permission, "the daemon requires its token")
                .remedy("pass --token-file FILE with the token file of the daemon")
        }
        WsError::Http(response) => {
            let status = response.status();
            let what = format!("expected a gripcast daemon, found HTTP status {status}");
            Error::new(ErrorKind::Io, what)
        }
        error => Error::new(ErrorKind::Io, "cannot connect to the daemon").because(error),
    };
    error.at(target)
}

fn version_mismatch(error: serde_json::Error, target: &Target) -> Error {
    Error::input("unknown message from the daemon")
        .because(error)
        .at(target)
        .remedy("use the same gripcast version for both")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The terminal shows raw image and difference of a gel; the difference goes with its initial
    /// frame.
    #[test]
    fn image_and_difference_of_a_gel_are_kept_apart() {
        let jpeg = |level: u8| {
            let image = image::RgbImage::from_pixel(8, 8, image::Rgb([level; 3]));
            gripcast_imaging::encode_jpeg(&image, 90).unwrap()
        };
        let labels = gripcast_session::Labels::default();
        let mut state = EngineStatus::starting("d", "bench", labels);
        state.session.initial_at = Some("2026-11-20T11:00:00Z".into());
        let mut received = Received {
            decoder: Decoder::new().unwrap(),
            previews: BTreeMap::new(),
            state: Some(state),
            sent: SentCommands::default(),
        };
        for (first, level) in [(DIFFERENCE, 128), (0, 40), (DIFFERENCE, 128), (0, 50)] {
            received.take_image(&[&[first][..], &jpeg(level)].concat());
        }
        received.take_image(&[9, 0]);
        let left = |received: &mut Received| {
            received
                .status()
                .unwrap()
                .previews
                .remove(&Role::Left)
                .unwrap()
        };
        let shown = left(&mut received);
        assert_eq!(shown.image.get_pixel(0, 0).0[0], 50);
        assert_eq!(shown.difference.unwrap().get_pixel(0, 0).0[0], 128);
        received.state.as_mut().unwrap().session.initial_at = None;
        assert_eq!(left(&mut received).difference, None);
    }

    #[test]
    fn daemon_addresses_are_parsed() {
        let parse = |text| Target::parse(text).map_err(|e| e.kind());
        assert_eq!(
            parse("http://127.0.0.1:7471/"),
            Ok(Target::Address("127.0.0.1:7471".into()))
        );
        assert_eq!(
            parse("/run/gripcast/gripcast.sock"),
            Ok(Target::Socket("/run/gripcast/gripcast.sock".into()))
        );
        for invalid in ["https://lab:1", "http://lab", "http://lab:1/page", ""] {
            assert_eq!(parse(invalid), Err(ErrorKind::Usage), "{invalid}");
        }
    }
}
