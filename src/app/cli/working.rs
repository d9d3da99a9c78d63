//! Long computations: progress on stderr, and an end at Ctrl-C.

use std::io::{self, IsTerminal as _};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::time::{MissedTickBehavior, interval};

use super::Context;
use crate::error::{Error, ErrorKind, Result};

/// Between lines that say that it still works, where there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// How a computation tells people where it is.
pub(super) struct Progress(UnboundedSender<Event>);

enum Event {
    Line(String),
    At { done: u64, all: u64 },
}

impl Progress {
    /// A line on stderr.
    pub(super) fn line(&self, text: impl Into<String>) {
        // Nobody listens any more after Ctrl-C.
        let _ = self.0.send(Event::Line(text.into()));
    }

    /// How much is done.
    pub(super) fn at(&self, done: u64, all: u64) {
        let _ = self.0.send(Event::At { done, all });
    }
}

/// Runs `work` in a thread of its own while people see that it goes on.
///
/// # Errors
/// `Interrupted` at Ctrl-C: the thread is left behind for the process to end. `Internal` where
/// the work panicked.
pub(super) fn interruptible<T: Send + 'static>(
    context: &Context,
    label: &'static str,
    work: impl FnOnce(&Progress) -> T + Send + 'static,
) -> Result<T> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|e| Error::io("cannot listen for Ctrl-C", e))?;
    runtime.block_on(async {
        let mut interrupt = signal(SignalKind::interrupt())
            .map_err(|e| Error::io("cannot listen for Ctrl-C", e))?;
        let (events, listening) = unbounded_channel();
        let (done, result) = tokio::sync::oneshot::channel();
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
            _ = interrupt.recv() => Err(Error::new(ErrorKind::Interrupted, "interrupted")),
        };
        display.bar.finish_and_clear();
        outcome
    })
}

async fn watch<T>(
    display: &Display,
    mut listening: UnboundedReceiver<Event>,
    result: tokio::sync::oneshot::Receiver<T>,
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
        .map_err(|_| Error::new(ErrorKind::Internal, "the computation ended early"))
}

/// A bar on a terminal, lines elsewhere, nothing with `--quiet`.
struct Display {
    bar: ProgressBar,
    label: &'static str,
    started: Instant,
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
            eprintln!("{label}");
        }
        Self {
            bar,
            label,
            started: Instant::now(),
            has_lines,
        }
    }

    fn show(&self, event: Event) {
        match event {
            Event::Line(text) if self.has_lines => eprintln!("{text}"),
            Event::Line(text) => self.bar.println(text),
            Event::At { done, all } => {
                if self.bar.length() != Some(all) {
                    self.bar.set_length(all);
                    let template = "{msg} [{bar:30}] {pos}/{len} {elapsed}";
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
            eprintln!("{} for {seconds} s", self.label);
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
