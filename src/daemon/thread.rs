//! Named threads.

use std::thread::JoinHandle;

use gripcast_base::error::{Error, ErrorKind, Result};

/// Starts a named thread.
pub(super) fn spawn<T: Send + 'static>(
    name: String,
    body: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>> {
    std::thread::Builder::new()
        .name(name.clone())
        .spawn(body)
        .map_err(|e| {
            Error::new(ErrorKind::Io, format!("cannot start the thread `{name}`")).because(e)
        })
}
