//! TCP and Unix socket connections with limits on their number and on idle clients.

use std::collections::HashMap;
use std::fs;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper::{Request, Uri};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpSocket, UnixListener};
use tokio::sync::{Semaphore, watch};

use super::access::Peer;
use super::sender::Arrival;
use super::slots::Slots;
use super::stall::StallTimeout;
use crate::daemon::{TaskState, Tasks};
use gripcast_base::error::{Error, ErrorKind, Result};

/// Limits of connections.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Maximum connections per address. A browser needs six, and two per window for events.
    pub(super) per_address: usize,
    /// Timeout for the head of a request, and between requests.
    pub(super) head_timeout: Duration,
    /// Timeout of a write to a client that does not read.
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

/// Maximum connections over TCP.
const MAX_TCP: usize = 128;
/// Maximum connections over the Unix socket.
const MAX_UNIX: usize = 64;
/// Send buffer of the kernel, bytes (doubled by Linux). Small, because the write timeout starts
/// when it is full.
const SEND_BUFFER: u32 = 64 * 1024;
/// Maximum pending connections.
const BACKLOG: u32 = 1024;
/// Pause after a failed accept, for example without free file descriptors.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// Listening sockets of the daemon.
#[derive(Debug)]
pub(crate) struct Listeners {
    tcp: Option<TcpListener>,
    unix: Option<(UnixListener, SocketFile)>,
    pub(super) limits: Limits,
    pub(super) slots: Slots,
}

/// Socket file, removed with its listener.
#[derive(Debug)]
struct SocketFile(PathBuf);

impl Drop for SocketFile {
    fn drop(&mut self) {
        // A remaining file is replaced at the next start.
        let _ = fs::remove_file(&self.0);
    }
}

impl Listeners {
    /// Opens the requested sockets.
    ///
    /// # Errors
    /// `Busy` if another program is listening there, `Permission`, `Io`, ….
    pub(crate) async fn open(listen: Option<SocketAddr>, socket: Option<&Path>) -> Result<Self> {
        let mut listeners = Self {
            tcp: None,
            unix: None,
            limits: Limits::default(),
            slots: Slots::new(MAX_TCP, MAX_UNIX),
        };
        if let Some(address) = listen {
            let listener = tcp(address).map_err(|e| tcp_error(address, e))?;
            listeners.tcp = Some(listener);
        }
        if let Some(path) = socket {
            let listener = unix(path).await?;
            listeners.unix = Some((listener, SocketFile(path.to_owned())));
        }
        Ok(listeners)
    }

    /// Returns the bound TCP address, with the assigned port if 0 was requested.
    pub(crate) fn address(&self) -> Option<SocketAddr> {
        self.tcp.as_ref()?.local_addr().ok()
    }
}

/// Opens a TCP listener with small send buffers.
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

fn tcp_error(address: SocketAddr, error: io::Error) -> Error {
    let what = format!("cannot listen on {address}");
    if error.kind() == io::ErrorKind::AddrInUse {
        Error::new(ErrorKind::Busy, format!("{what}: the port is in use"))
            .remedy("stop the program using it (`ss -tlnp` lists it), or set another --listen")
    } else {
        Error::io(what, error)
            .remedy("set --listen to an address of this machine, for example 127.0.0.1:7471")
    }
}

/// Opens a Unix socket for its owner and group; a stale socket file is replaced.
async fn unix(path: &Path) -> Result<UnixListener> {
    let failed = |e| Error::io("cannot listen on the socket", e).at(path.display());
    if let Ok(found) = fs::symlink_metadata(path) {
        if !found.file_type().is_socket() {
            return Err(Error::config("expected a socket, found another file")
                .at(path.display())
                .remedy("set another --socket, or move the file"));
        }
        if tokio::net::UnixStream::connect(path).await.is_ok() {
            return Err(
                Error::new(ErrorKind::Busy, "another daemon is listening on the socket")
                    .at(path.display())
                    .remedy("stop it, or set another --socket"),
            );
        }
        fs::remove_file(path).map_err(failed)?;
    }
    let listener = UnixListener::bind(path).map_err(failed)?;
    fs::set_permissions(path, fs::Permissions::from_mode(0o660)).map_err(failed)?;
    Ok(listener)
}

/// Serves until `stop` is true, then closes all connections.
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
        slots,
    } = listeners;
    let server = Server {
        router,
        tasks,
        limits,
        slots,
        stop,
    };
    let network = async {
        if let Some(listener) = tcp {
            let accept = async || {
                let (stream, from) = listener.accept().await?;
                // Small responses are sent without delay.
                let _ = stream.set_nodelay(true);
                Ok((stream, Peer::Network(from.ip().to_canonical())))
            };
            server.accept_all("serve-tcp", accept).await;
        }
    };
    let local = async {
        if let Some((listener, _file)) = unix {
            let accept = async || Ok((listener.accept().await?.0, Peer::Local));
            server.accept_all("serve-unix", accept).await;
        }
    };
    tokio::join!(network, local);
}

/// Accepts and serves connections.
struct Server {
    router: Router,
    tasks: Tasks,
    limits: Limits,
    slots: Slots,
    stop: watch::Receiver<bool>,
}

impl Server {
    /// Accepts connections until `stop` is true.
    async fn accept_all<S>(&self, task: &str, accept: impl AsyncFn() -> io::Result<(S, Peer)>)
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        self.tasks.register(task);
        // Slots by address.
        let mut by_address: HashMap<IpAddr, Arc<Semaphore>> = HashMap::new();
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
            // Forget addresses without connections.
            by_address.retain(|_, slots| Arc::strong_count(slots) > 1);
            let address_permit = match peer {
                Peer::Network(from) => {
                    let slots = by_address
                        .entry(from)
                        .or_insert_with(|| Arc::new(Semaphore::new(self.limits.per_address)));
                    Arc::clone(slots).try_acquire_owned().map(Some)
                }
                Peer::Local => Ok(None),
            };
            // Without a free slot the connection is closed at once.
            if let (Ok(own), Some(permit)) = (address_permit, self.slots.take(peer)) {
                self.serve_connection(stream, peer, (own, permit));
            }
        }
        self.tasks.set(task, TaskState::Ended, None);
    }

    /// Serves a connection, which keeps its permit while the socket is open.
    fn serve_connection<S, P>(&self, stream: S, peer: Peer, permit: P)
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
        P: Unpin + Send + 'static,
    {
        let stream = StallTimeout::new(stream, self.limits.write_timeout, permit);
        let router = TowerToHyperService::new(self.router.clone());
        let service = service_fn(move |mut request: Request<Incoming>| {
            request.extensions_mut().insert(peer);
            request.extensions_mut().insert(Arrival::now());
            merge_leading_slashes(&mut request);
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
                // Client errors are not reported.
                _ = connection => {}
                _ = stop.wait_for(|stop| *stop) => {}
            }
        });
    }
}

/// Replaces several slashes at the start of the path by one: a proxy that maps `/rig` to `/` makes
/// `//api/state` of `/rig/api/state`. Before all checks, which depend on the path.
fn merge_leading_slashes(request: &mut Request<Incoming>) {
    let path = request
        .uri()
        .path_and_query()
        .map_or("", |path| path.as_str());
    let rest = path.trim_start_matches('/');
    if path.len() < rest.len() + 2 {
        return;
    }
    let Ok(merged) = format!("/{rest}").parse() else {
        return;
    };
    let mut parts = request.uri().clone().into_parts();
    parts.path_and_query = Some(merged);
    if let Ok(uri) = Uri::from_parts(parts) {
        *request.uri_mut() = uri;
    }
}
