//! Runs work without the interpreter's lock.

use std::mem;
use std::panic::AssertUnwindSafe;
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::failure::Outcome;
use gripcast_base::catch_panic::catch_panic;
use gripcast_base::error::{Error, ErrorKind, Result};

/// Interval at which signals are looked for.
const SIGNALS: Duration = Duration::from_millis(50);
/// Largest number of threads of a call.
const MAX_THREADS: usize = 256;

/// Turns a panic into an error.
///
/// # Errors
/// Those of the work; `Internal` for a panic.
pub(crate) fn guarded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_panic(AssertUnwindSafe(work)).unwrap_or_else(|message| {
        Err(Error::internal(format!("gripcast has a defect: {message}"))
            .remedy("report it with the call and its arguments"))
    })
}

/// Runs short work on the calling thread without the interpreter's lock.
pub(crate) fn detached<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T> + Send,
) -> Outcome<T> {
    Ok(py.detach(|| guarded(work))?)
}

/// Runs long work in a thread of its own, and looks for signals meanwhile. When one raises an
/// exception, as Ctrl-C does, the call ends with it; the work gets to know by its argument.
pub(crate) fn interruptible<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&AtomicBool) -> Result<T> + Send + 'static,
) -> Outcome<T> {
    let is_cancelled = Arc::new(AtomicBool::new(false));
    let (done, mut result) = sync_channel(1);
    let flag = Arc::clone(&is_cancelled);
    thread::Builder::new()
        .name("gripcast".to_owned())
        .spawn(move || {
            // Nobody waits for it after a signal.
            let _ = done.send(guarded(|| work(&flag)));
        })
        .map_err(|e| Error::io("cannot start a thread", e))?;
    loop {
        let waited;
        (waited, result) = py.detach(move || (result.recv_timeout(SIGNALS), result));
        match waited {
            Ok(finished) => return Ok(finished?),
            Err(RecvTimeoutError::Disconnected) => {
                return Err(Error::internal("the work ended without a result").into());
            }
            Err(RecvTimeoutError::Timeout) => {}
        }
        if let Err(raised) = py.check_signals() {
            is_cancelled.store(true, Ordering::Relaxed);
            return Err(raised.into());
        }
    }
}

/// Threads of one call: `threads` of its own, or those that all calls of this process share.
///
/// # Errors
/// `Usage` for a number out of range.
pub(crate) fn pool(threads: Option<usize>) -> Result<Arc<ThreadPool>> {
    static SHARED: ProcessPool = ProcessPool(Mutex::new(None));
    match threads {
        None => SHARED.get(None),
        Some(threads) => start(thread_count(Some(threads))?),
    }
}

/// Threads that outlive a call. A process that was forked has none of its parent's threads, so it
/// starts its own.
#[derive(Default)]
pub(crate) struct ProcessPool(Mutex<Option<(u32, Arc<ThreadPool>)>>);

impl ProcessPool {
    /// The threads, started with this number the first time.
    pub(crate) fn get(&self, threads: Option<usize>) -> Result<Arc<ThreadPool>> {
        let mut started = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let here = process::id();
        match &*started {
            Some((process, pool)) if *process == here => Ok(Arc::clone(pool)),
            _ => {
                let pool = start(thread_count(threads)?)?;
                // Ending a parent's pool would wait for locks that its threads may hold.
                mem::forget(started.replace((here, Arc::clone(&pool))));
                Ok(pool)
            }
        }
    }
}

/// Number of threads of one call, all cores unless given.
///
/// # Errors
/// `Usage` for a number out of range.
pub(crate) fn thread_count(threads: Option<usize>) -> Result<usize> {
    match threads {
        None => Ok(gripcast_base::workers::cores()),
        Some(threads) if (1..=MAX_THREADS).contains(&threads) => Ok(threads),
        Some(found) => Err(Error::usage(format!(
            "`threads` must be from 1 to {MAX_THREADS}, found {found}"
        ))),
    }
}

fn start(threads: usize) -> Result<Arc<ThreadPool>> {
    let pool = ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map(Arc::new)
        .map_err(|e| Error::new(ErrorKind::Io, "cannot start threads").because(e))
}
