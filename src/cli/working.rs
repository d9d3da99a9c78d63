//! Long computations: progress on stderr, and an end at Ctrl-C.

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

/// Between lines that say that it still works, where there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);
/// What helps after a stop.
const AGAIN: &str = "run the same command again: it goes on where it was";

/// How a computation tells people where it is.
pub struct Progress(UnboundedSender<Event>);

enum Event {
    Line(String),
    Stage(&'static str),
    At { done: u64, all: u64 },
}

impl Progress {
    /// A line on stderr.
    pub fn line(&self, text: impl Into<String>) {
        // Nobody listens any more after Ctrl-C.
        let _ = self.0.send(Event::Line(text.into()));
    }

    /// What is being done now.
    pub fn stage(&self, label: &'static str) {
        let _ = self.0.send(Event::Stage(label));
    }

    /// How much is done.
    pub fn at(&self, done: u64, all: u64) {
        let _ = self.0.send(Event::At { done, all });
    }
}

/// Runs `work` in a thread of its own while people see that it goes on.
///
/// # Errors
/// `Interrupted` at Ctrl-C: the thread is left behind for the process to end. `Internal` where
/// the work panicked.
pub fn interruptible<T: Send + 'static>(
    context: &Context,
    label: &'static str,
    work: impl FnOnce(&Progress) -> T + Send + 'static,
) -> Result<T> {
    watched(context, label, false, std::future::pending(), work)
}

/// The same for work whose finished parts are on the disk: `SIGTERM` ends it with `Stopped`, and
/// the same command goes on where it was.
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

/// The same under a screen that shows the progress itself: nothing is printed, and what arrives at
/// `asked` ends the work as Ctrl-C does.
///
/// # Errors
/// As [`resumable`].
pub(super) fn resumable_under_screen<T: Send + 'static>(
    asked: oneshot::Receiver<()>,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T> {
    let silent = Context {
        verbose: 0,
        quiet: true,
    };
    let asked = async {
        if asked.await.is_err() {
            // The screen has gone and cannot ask any more.
            std::future::pending().await
        }
    };
    watched(&silent, "", true, asked, |_| work())
}

fn watched<T: Send + 'static>(
    context: &Context,
    label: &'static str,
    is_resumable: bool,
    asked: impl Future<Output = ()>,
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
                // Nobody waits for the result any more after Ctrl-C.
                let _ = done.send(work(&progress));
            })
            .map_err(|e| Error::io("cannot start a thread", e))?;
        let display = Display::new(context, label);
        let outcome = tokio::select! {
            result = watch(&display, listening, result) => result,
            _ = interrupt.recv() => Err(interrupted(is_resumable)),
            () = asked => Err(interrupted(is_resumable)),
            _ = stopped => Err(Error::new(ErrorKind::Stopped, "stopped; what is finished is kept")
                .remedy(AGAIN)),
        };
        display.bar.finish_and_clear();
        outcome
    })
}

fn interrupted(is_resumable: bool) -> Error {
    let error = Error::new(ErrorKind::Interrupted, "interrupted");
    if is_resumable {
        error.remedy(AGAIN)
    } else {
        error
    }
}

async fn watch<T>(
    display: &Display,
    mut listening: UnboundedReceiver<Event>,
    result: oneshot::Receiver<T>,
) -> Result<T> {
    let mut still = interval(LINE_EVERY);
    still.set_missed_tick_behavior(MissedTickBehavior::Delay);
    still.tick().await;
    loop {
        tokio::select! {
            event = listening.recv() => match event {
                Some(event) => display.show(event),
                // The worker has ended and told all.
                None => break,
            },
            _ = still.tick() => display.still(),
        }
    }
    result
        .await
        .map_err(|_| Error::internal("the computation ended early"))
}

/// How much is done, and how fast.
#[derive(Clone, Copy)]
struct Position {
    /// Where it was when it was first told, and when: what an earlier run has done takes no time.
    first: (u64, Instant),
    done: u64,
    all: u64,
}

impl Position {
    fn moved(before: Option<Self>, done: u64, all: u64) -> Self {
        let same = before.filter(|before| before.all == all && before.done <= done);
        let first = same.map_or_else(|| (done, Instant::now()), |before| before.first);
        Self { first, done, all }
    }

    fn text(&self) -> String {
        let (from, when) = self.first;
        let rest = (self.all - self.done) as f64 * when.elapsed().as_secs_f64();
        let left = match self.done.saturating_sub(from) {
            0 => String::new(),
            moved => format!(", about {:.0} s left", rest / moved as f64),
        };
        format!(", {} of {}{left}", self.done, self.all)
    }
}

/// A bar on a terminal, lines elsewhere, nothing with `--quiet`.
struct Display {
    bar: ProgressBar,
    label: Cell<&'static str>,
    started: Instant,
    at: Cell<Option<Position>>,
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
            at: Cell::new(None),
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
                self.at.set(None);
                self.bar.set_message(label);
                if self.has_lines {
                    note!("{label}");
                }
            }
            Event::At { done, all } => {
                self.at.set(Some(Position::moved(self.at.get(), done, all)));
                if self.bar.length() != Some(all) {
                    self.bar.set_length(all);
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

    fn still(&self) {
        if self.has_lines {
            let seconds = self.started.elapsed().as_secs();
            let at = self.at.get().map_or(String::new(), |at| at.text());
            note!("{} for {seconds} s{at}", self.label.get());
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
    fn the_result_comes_back_with_its_progress() {
        let found = interruptible(&QUIET, "adding", |progress| {
            progress.line("first");
            progress.at(1, 2);
            40 + 2
        });
        assert_eq!(found.unwrap(), 42);
    }

    #[test]
    #[allow(clippy::panic)]
    fn a_panic_is_a_defect_and_no_hang() {
        let found: Result<()> = interruptible(&QUIET, "failing", |_| panic!("on purpose"));
        assert_eq!(found.unwrap_err().kind(), ErrorKind::Internal);
    }
}
