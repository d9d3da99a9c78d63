//! Connections: TCP and a Unix socket, each bounded in number, and in how long a client may neither
//! send nor take.

use std::collections::HashMap;
use std::fs;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpSocket, UnixListener};
use tokio::sync::{Semaphore, watch};

use super::access::Peer;
use super::slots::Slots;
use super::stall::StallTimeout;
use crate::daemon::{TaskState, Tasks};
use gripcast_base::error::{Error, ErrorKind, Result};

/// What connections may take.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Connections of one address. A browser needs six, and two for each window's events.
    pub(super) per_address: usize,
    /// How long a client may take for the head of a request, or say nothing after an answer.
    pub(super) head_timeout: Duration,
    /// How long a client may take nothing of an answer that waits for it.
    pub(super) write_timeout: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            per_address: 48,
            head_timeout: Duration::from_secs(10),
            write_timeout: Duration::from_secs(5),
        }
    }
}

/// Connections at a time over TCP.
const MAX_OVER_TCP: usize = 128;
/// Connections at a time over the Unix socket.
const MAX_OVER_SOCKET: usize = 64;
/// What the kernel holds for a client that does not read, bytes. Linux doubles it. Small, since the
/// timeout with a client begins when it is full.
const SEND_BUFFER: u32 = 64 * 1024;
/// Connections that wait to be accepted.
const BACKLOG: u32 = 1024;
/// Pause after a connection that could not be accepted, for instance for want of file descriptors.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// The places where the daemon listens.
#[derive(Debug)]
pub(crate) struct Listeners {
    tcp: Option<TcpListener>,
    unix: Option<(UnixListener, SocketFile)>,
    pub(super) limits: Limits,
    pub(super) places: Slots,
}

/// The file of a socket; it goes with its listener.
#[derive(Debug)]
struct SocketFile(PathBuf);

impl Drop for SocketFile {
    fn drop(&mut self) {
        // Left behind, it is replaced by the next start.
        let _ = fs::remove_file(&self.0);
    }
}

impl Listeners {
    /// Opens what is asked for.
    ///
    /// # Errors
    /// `Busy` when another program listens there, `Permission`, `Io`, ….
    pub(crate) async fn open(listen: Option<SocketAddr>, socket: Option<&Path>) -> Result<Self> {
        let mut listeners = Self {
            tcp: None,
            unix: None,
            limits: Limits::default(),
            places: Slots::new(MAX_OVER_TCP, MAX_OVER_SOCKET),
        };
        if let Some(address) = listen {
            let listener = tcp(address).map_err(|e| taken(address, e))?;
            listeners.tcp = Some(listener);
        }
        if let Some(path) = socket {
            let listener = unix(path).await?;
            listeners.unix = Some((listener, SocketFile(path.to_owned())));
        }
        Ok(listeners)
    }

    /// The address that was bound: the port is a free one where 0 was asked for.
    pub(crate) fn address(&self) -> Option<SocketAddr> {
        self.tcp.as_ref()?.local_addr().ok()
    }
}

/// A listener whose connections have small send buffers.
fn tcp(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = match address {
        SocketAddr::V4(_) => TcpSocket::new_v4()?,
        SocketAddr::V6(_) => TcpSocket::new_v6()?,
    };
    socket.set_reuseaddr(true)?;
    socket.set_send_buffer_size(SEND_BUFFER)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

fn taken(address: SocketAddr, error: io::Error) -> Error {
    let in_use = error.kind() == io::ErrorKind::AddrInUse;
    let what = format!("cannot listen on {address}");
    if in_use {
        Error::new(ErrorKind::Busy, format!("{what}: another program does"))
            .remedy("end it (`ss -tlnp` tells which it is), or give another --listen")
    } else {
        Error::io(what, error)
            .remedy("--listen takes an address of this machine, as 127.0.0.1:7471")
    }
}

/// A listener on a Unix socket for its owner and group; a socket that nobody listens on is replaced.
async fn unix(path: &Path) -> Result<UnixListener> {
    let failed = |e| Error::io("cannot listen on the socket", e).at(path.display());
    if let Ok(found) = fs::symlink_metadata(path) {
        if !found.file_type().is_socket() {
            return Err(
                Error::config("there is something else in the socket's place")
                    .at(path.display())
                    .remedy("give another --socket, or move it away"),
            );
        }
        if tokio::net::UnixStream::connect(path).await.is_ok() {
            return Err(
                Error::new(ErrorKind::Busy, "another daemon listens on the socket")
                    .at(path.display())
                    .remedy("end it, or give another --socket"),
            );
        }
        fs::remove_file(path).map_err(failed)?;
    }
    let listener = UnixListener::bind(path).map_err(failed)?;
    fs::set_permissions(path, fs::Permissions::from_mode(0o660)).map_err(failed)?;
    Ok(listener)
}

/// Serves until `stop` is true; connections that are open then are closed.
pub(crate) async fn serve(
    listeners: Listeners,
    router: Router,
    tasks: Tasks,
    stop: watch::Receiver<bool>,
) {
    let Listeners {
        tcp,
        unix,
        limits,
        places,
    } = listeners;
    let server = Server {
        router,
        tasks,
        limits,
        places,
        stop,
    };
    let network = async {
        if let Some(listener) = tcp {
            let accept = async || {
                let (stream, from) = listener.accept().await?;
                // Small answers must not wait for more.
                let _ = stream.set_nodelay(true);
                Ok((stream, Peer::Network(from.ip().to_canonical())))
            };
            server.admit("serve-tcp", accept).await;
        }
    };
    let local = async {
        if let Some((listener, _file)) = unix {
            let accept = async || Ok((listener.accept().await?.0, Peer::Local));
            server.admit("serve-unix", accept).await;
        }
    };
    tokio::join!(network, local);
}

/// Where connections come in.
struct Server {
    router: Router,
    tasks: Tasks,
    limits: Limits,
    places: Slots,
    stop: watch::Receiver<bool>,
}

impl Server {
    /// Serves what comes in until it stops.
    async fn admit<S>(&self, task: &str, accept: impl AsyncFn() -> io::Result<(S, Peer)>)
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        self.tasks.register(task);
        // Slots of each address that is connected.
        let mut crowd: HashMap<IpAddr, Arc<Semaphore>> = HashMap::new();
        let mut stop = self.stop.clone();
        loop {
            let accepted = tokio::select! {
                accepted = accept() => accepted,
                _ = stop.wait_for(|stop| *stop) => break,
            };
            let (stream, peer) = match accepted {
                Ok(accepted) => accepted,
                Err(error) => {
                    let text = format!("cannot accept a connection: {error}");
                    self.tasks.set(task, TaskState::Restarting, Some(text));
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                    self.tasks.set(task, TaskState::Running, None);
                    continue;
                }
            };
            // Slots are held by those who have one.
            crowd.retain(|_, places| Arc::strong_count(places) > 1);
            let own = match peer {
                Peer::Network(from) => {
                    let places = crowd
                        .entry(from)
                        .or_insert_with(|| Arc::new(Semaphore::new(self.limits.per_address)));
                    Arc::clone(places).try_acquire_owned().map(Some)
                }
                Peer::Local => Ok(None),
            };
            // Without a place the connection is closed at once.
            if let (Ok(own), Some(place)) = (own, self.places.take(peer)) {
                self.welcome(stream, peer, (own, place));
            }
        }
        self.tasks.set(task, TaskState::Ended, None);
    }

    /// Serves a connection, which keeps its place as long as its socket is open.
    fn welcome<S, P>(&self, stream: S, peer: Peer, place: P)
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
        P: Unpin + Send + 'static,
    {
        let stream = StallTimeout::new(stream, self.limits.write_timeout, place);
        let router = TowerToHyperService::new(self.router.clone());
        let service = service_fn(move |mut request: Request<Incoming>| {
            request.extensions_mut().insert(peer);
            router.call(request)
        });
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(self.limits.head_timeout)
            .serve_connection(TokioIo::new(stream), service)
            .with_upgrades();
        let mut stop = self.stop.clone();
        tokio::spawn(async move {
            tokio::select! {
                // A client that breaks off is no news.
                _ = connection => {}
                _ = stop.wait_for(|stop| *stop) => {}
            }
        });
    }
}
