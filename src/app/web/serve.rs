//! Connections: TCP and a Unix socket, bounded in number and in how long they may say nothing.

use std::fs;
use std::io;
use std::net::SocketAddr;
use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use axum::{Extension, Router};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, UnixListener};
use tokio::sync::{Semaphore, watch};

use super::access::Peer;
use crate::app::daemon::{TaskState, Tasks};
use crate::error::{Error, ErrorKind, Result};

/// Connections at a time.
const MOST_CONNECTIONS: usize = 128;
/// How long a client may take for the head of a request.
const HEAD_PATIENCE: Duration = Duration::from_secs(10);
/// Pause after a connection that could not be accepted, for instance for want of file descriptors.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// The places where the daemon listens.
#[derive(Debug, Default)]
pub(crate) struct Listeners {
    tcp: Option<TcpListener>,
    unix: Option<(UnixListener, SocketFile)>,
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
        let mut listeners = Self::default();
        if let Some(address) = listen {
            let listener = TcpListener::bind(address)
                .await
                .map_err(|e| taken(address, e))?;
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
            return Err(Error::new(
                ErrorKind::Config,
                "there is something else in the socket's place",
            )
            .at(path.display())
            .remedy("give another --socket, or move it away"));
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
    let places = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    let Listeners { tcp, unix } = listeners;
    let network = async {
        if let Some(listener) = tcp {
            tasks.enter("serve-tcp");
            let router = router.clone().layer(Extension(Peer::Network));
            let mut stop = stop.clone();
            loop {
                let accepted = tokio::select! {
                    accepted = listener.accept() => accepted.map(|(stream, _)| stream),
                    _ = stop.wait_for(|stop| *stop) => break,
                };
                // Small answers must not wait for more.
                let accepted = accepted.inspect(|stream| drop(stream.set_nodelay(true)));
                welcome(accepted, "serve-tcp", &router, &tasks, &places, &stop).await;
            }
            tasks.set("serve-tcp", TaskState::Ended, None);
        }
    };
    let local = async {
        if let Some((listener, _file)) = unix {
            tasks.enter("serve-unix");
            let router = router.clone().layer(Extension(Peer::Local));
            let mut stop = stop.clone();
            loop {
                let accepted = tokio::select! {
                    accepted = listener.accept() => accepted.map(|(stream, _)| stream),
                    _ = stop.wait_for(|stop| *stop) => break,
                };
                welcome(accepted, "serve-unix", &router, &tasks, &places, &stop).await;
            }
            tasks.set("serve-unix", TaskState::Ended, None);
        }
    };
    tokio::join!(network, local);
}

/// Starts to serve a connection, if there is a place for it.
async fn welcome<S>(
    accepted: io::Result<S>,
    task: &str,
    router: &Router,
    tasks: &Tasks,
    places: &Arc<Semaphore>,
    stop: &watch::Receiver<bool>,
) where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let stream = match accepted {
        Ok(stream) => stream,
        Err(error) => {
            let text = format!("cannot accept a connection: {error}");
            tasks.set(task, TaskState::Restarting, Some(text));
            tokio::time::sleep(ACCEPT_PAUSE).await;
            tasks.set(task, TaskState::Running, None);
            return;
        }
    };
    // Without a place the connection is closed at once.
    let Ok(place) = Arc::clone(places).try_acquire_owned() else {
        return;
    };
    let (service, mut stop) = (TowerToHyperService::new(router.clone()), stop.clone());
    tokio::spawn(async move {
        let connection = hyper::server::conn::http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEAD_PATIENCE)
            .serve_connection(TokioIo::new(stream), service)
            .with_upgrades();
        tokio::select! {
            // A client that breaks off is no news.
            _ = connection => {}
            _ = stop.wait_for(|stop| *stop) => {}
        }
        drop(place);
    });
}
