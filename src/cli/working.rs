//! Long computations with progress on stderr that end at Ctrl-C.

use std::cell::Cell;
use std::io::{self, IsTerminal as _};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::oneshot;
use tokio::time::{MissedTickBehavior, interval};

use super::Context;
use crate::note;
use gripcast_base::error::{Error, ErrorKind, Result};

/// Interval of the status lines without a terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(10);
/// Remedy after a stop.
const RESUME: &str = "rerun the same command to resume";

/// Reports the progress of a computation.
pub struct Progress(UnboundedSender<Event>);

enum Event {
    Line(String),
    Stage(&'static str),
    Count { done: u64, total: u64 },
}

impl Progress {
    /// Prints a line on stderr.
    pub fn line(&self, text: impl Into<String>) {
        // After Ctrl-C nobody receives any more.
        let _ = self.0.send(Event::Line(text.into()));
    }

    /// Names the current stage.
    pub fn stage(&self, label: &'static str) {
        let _ = self.0.send(Event::Stage(label));
    }

    /// Reports how many items of the stage are done.
    pub fn count(&self, done: usize, total: usize) {
        let (done, total) = (done as u64, total as u64);
        let _ = self.0.send(Event::Count { done, total });
    }
}

/// Runs `work` in its own thread and shows its progress.
///
/// # Errors
/// `Interrupted` at Ctrl-C, when the thread is left behind for the process to end. `Internal` if
/// the work panicked.
pub fn interruptible<T: Send + 'static>(
    context: &Context,
    label: &'static str,
    work: impl FnOnce(&Progress) -> T + Send + 'static,
) -> Result<T> {
    watched(context, label, false, std::future::pending(), work)
}

/// Runs work that keeps its finished items on disk and can be resumed: `SIGTERM` ends it with
/// `Stopped`.
///
/// # Errors
/// As [`interruptible`], and `Stopped`.
pub(super) fn resumable<T: Send + 'static>(
    context: &Context,
    label: &'static str,
    work: impl FnOnce(&Progress) -> T + Send + 'static,
) -> Result<T> {
    watched(context, label, true, std::future::pending(), work)
}

/// Runs resumable work under a screen that shows the progress itself: nothing is printed, and a
/// message in `cancel` ends the work like Ctrl-C.
///
/// # Errors
/// As [`resumable`].
pub(super) fn resumable_under_screen<T: Send + 'static>(
    cancel: oneshot::Receiver<()>,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T> {
    let silent = Context {
        verbose: 0,
        quiet: true,
    };
    let cancelled = async {
        if cancel.await.is_err() {
            // The screen has ended and can no longer cancel.
            std::future::pending().await
        }
    };
    watched(&silent, "", true, cancelled, |_| work())
}

fn watched<T: Send + 'static>(
    context: &Context,
    label: &'static str,
    is_resumable: bool,
    cancelled: impl Future<Output = ()>,
    work: impl FnOnce(&Progress) -> T + Send + 'static,
) -> Result<T> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|e| Error::io("cannot listen for Ctrl-C", e))?;
    runtime.block_on(async {
        let mut interrupt = signal(SignalKind::interrupt())
            .map_err(|e| Error::io("cannot listen for Ctrl-C", e))?;
        let mut stop = if is_resumable {
            let stop = signal(SignalKind::terminate());
            Some(stop.map_err(|e| Error::io("cannot listen for SIGTERM", e))?)
        } else {
            None
        };
        let stopped = async {
            match &mut stop {
                Some(stop) => stop.recv().await,
                None => std::future::pending().await,
            }
        };
        let (events, listening) = unbounded_channel();
        let (done, result) = oneshot::channel();
        let worker = thread::Builder::new().name("work".into());
        worker
            .spawn(move || {
                let progress = Progress(events);
                // After Ctrl-C nobody waits for the result.
                let _ = done.send(work(&progress));
            })
            .map_err(|e| Error::io("cannot start a thread", e))?;
        let display = Display::new(context, label);
        let outcome = tokio::select! {
            result = watch(&display, listening, result) => result,
            _ = interrupt.recv() => Err(interrupted(is_resumable)),
            () = cancelled => Err(interrupted(is_resumable)),
            _ = stopped => Err(Error::new(ErrorKind::Stopped, "stopped; finished work is kept")
                .remedy(RESUME)),
        };
        display.bar.finish_and_clear();
        outcome
    })
}

fn interrupted(is_resumable: bool) -> Error {
    let error = Error::new(ErrorKind::Interrupted, "interrupted");
    if is_resumable {
        error.remedy(RESUME)
    } else {
        error
    }
}

async fn watch<T>(
    display: &Display,
    mut listening: UnboundedReceiver<Event>,
    result: oneshot::Receiver<T>,
) -> Result<T> {
    let mut status = interval(LINE_INTERVAL);
    status.set_missed_tick_behavior(MissedTickBehavior::Delay);
    status.tick().await;
    loop {
        tokio::select! {
            event = listening.recv() => match event {
                Some(event) => display.show(event),
                // The worker has ended.
                None => break,
            },
            _ = status.tick() => display.print_status(),
        }
    }
    result
        .await
        .map_err(|_| Error::internal("the computation ended early"))
}

/// Progress of a stage and its rate.
#[derive(Clone, Copy)]
struct StageProgress {
    /// First reported count and its time: work of an earlier run takes no time.
    first: (u64, Instant),
    done: u64,
    total: u64,
}

impl StageProgress {
    fn new(before: Option<Self>, done: u64, total: u64) -> Self {
        let same = before.filter(|before| before.total == total && before.done <= done);
        let first = same.map_or_else(|| (done, Instant::now()), |before| before.first);
        Self { first, done, total }
    }

    fn text(&self) -> String {
        let (first, start) = self.first;
        let rest = (self.total - self.done) as f64 * start.elapsed().as_secs_f64();
        let left = match self.done.saturating_sub(first) {
            0 => String::new(),
            done => format!(", about {:.0} s left", rest / done as f64),
        };
        format!(", {} of {}{left}", self.done, self.total)
    }
}

/// A progress bar on a terminal, lines elsewhere, nothing with `--quiet`.
struct Display {
    bar: ProgressBar,
    label: Cell<&'static str>,
    started: Instant,
    progress: Cell<Option<StageProgress>>,
    has_lines: bool,
}

impl Display {
    fn new(context: &Context, label: &'static str) -> Self {
        let on_terminal = io::stderr().is_terminal();
        let bar = if context.quiet || !on_terminal {
            ProgressBar::hidden()
        } else {
            let bar = ProgressBar::new_spinner();
            bar.enable_steady_tick(Duration::from_millis(120));
            bar
        };
        bar.set_message(label);
        if let Ok(style) = ProgressStyle::with_template("{spinner} {msg} {elapsed}") {
            bar.set_style(style);
        }
        let has_lines = !context.quiet && !on_terminal;
        if has_lines {
            note!("{label}");
        }
        Self {
            bar,
            label: Cell::new(label),
            started: Instant::now(),
            progress: Cell::new(None),
            has_lines,
        }
    }

    fn show(&self, event: Event) {
        match event {
            Event::Line(text) if self.has_lines => note!("{text}"),
            Event::Line(text) => self.bar.println(text),
            Event::Stage(label) if self.label.get() == label => {}
            Event::Stage(label) => {
                self.label.set(label);
                self.progress.set(None);
                self.bar.set_message(label);
                if self.has_lines {
                    note!("{label}");
                }
            }
            Event::Count { done, total } => {
                let progress = StageProgress::new(self.progress.get(), done, total);
                self.progress.set(Some(progress));
                if self.bar.length() != Some(total) {
                    self.bar.set_length(total);
                    self.bar.set_position(done);
                    self.bar.reset_eta();
                    let template = "{msg} [{bar:30}] {pos}/{len} {elapsed}, {eta} left";
                    if let Ok(style) = ProgressStyle::with_template(template) {
                        self.bar.set_style(style.progress_chars("=> "));
                    }
                }
                self.bar.set_position(done);
            }
        }
    }

    fn print_status(&self) {
        if self.has_lines {
            let seconds = self.started.elapsed().as_secs();
            let progress = self.progress.get().map_or(String::new(), |p| p.text());
            note!("{} for {seconds} s{progress}", self.label.get());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const QUIET: Context = Context {
        verbose: 0,
        quiet: true,
    };

    #[test]
    fn interruptible_returns_result() {
        let result = interruptible(&QUIET, "adding", |progress| {
            progress.line("first");
            progress.count(1, 2);
            40 + 2
        });
        assert_eq!(result.unwrap(), 42);
    }

    #[test]
    #[allow(clippy::panic)]
    fn panic_becomes_internal_error() {
        let result: Result<()> = interruptible(&QUIET, "failing", |_| panic!("on purpose"));
        assert_eq!(result.unwrap_err().kind(), ErrorKind::Internal);
    }
}
