//! The dashboard on a terminal.

use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, TryRecvError};
use std::thread;
use std::time::{Duration, Instant};

use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use tokio::sync::oneshot;

use super::super::input::is_interrupt;
use super::super::keyboard::{Keyboard, unreadable};
use super::super::palette::{ColourDepth, Palette};
use super::super::terminal::ScreenTerminal;
use super::dashboard;
use super::status::{TrainingNews, TrainingStatus};
use gripcast_base::error::{Error, Result};

/// Maximum wait for a key; bounds the delay of news.
const POLL: Duration = Duration::from_millis(50);
/// Minimum interval between two images.
const MIN_INTERVAL: Duration = Duration::from_millis(100);
/// Maximum interval between two images, for the clock.
const MAX_INTERVAL: Duration = Duration::from_secs(1);
/// Timeout of closing the screen.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// Handle of the dashboard thread.
pub(crate) struct TrainingScreen {
    messages: Sender<Message>,
    ended: Receiver<Result<()>>,
}

enum Message {
    News(TrainingNews),
    Close,
}

impl TrainingScreen {
    /// Starts the dashboard. The receiver resolves when a key requests a stop; it fails once the
    /// dashboard has closed.
    ///
    /// # Errors
    /// If the terminal cannot be used.
    pub(crate) fn start(status: TrainingStatus) -> Result<(Self, oneshot::Receiver<()>)> {
        let keyboard = Keyboard::open().map_err(unreadable)?;
        let depth = ColourDepth::from_environment(|name| std::env::var(name).ok());
        let terminal = ScreenTerminal::enter()?;
        let (messages, news) = mpsc::channel();
        let (stop, stop_requested) = oneshot::channel();
        let (sender, ended) = mpsc::channel();
        let dashboard = Dashboard {
            news,
            status,
            palette: Palette { depth },
            start: Instant::now(),
            drawn: None,
            changed: true,
        };
        thread::Builder::new()
            .name("screen".into())
            .spawn(move || {
                // The receiver is gone if the process ends without the screen.
                let _ = sender.send(dashboard.run(terminal, &keyboard, stop));
            })
            .map_err(|e| Error::io("cannot start a thread", e))?;
        Ok((Self { messages, ended }, stop_requested))
    }

    /// Returns a function that sends news to the dashboard without waiting.
    pub(crate) fn sender(&self) -> impl Fn(TrainingNews) + Send + Sync + use<> {
        let messages = self.messages.clone();
        move |news| {
            // The training continues if the terminal was closed.
            let _ = messages.send(Message::News(news));
        }
    }

    /// Closes the dashboard and waits until the terminal is restored, with a timeout for blocked
    /// terminals.
    ///
    /// # Errors
    /// The error that ended the dashboard.
    pub(crate) fn end(self) -> Result<()> {
        let _ = self.messages.send(Message::Close);
        match self.ended.recv_timeout(CLOSE_TIMEOUT) {
            Ok(result) => result,
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => Err(Error::internal("the dashboard panicked")),
        }
    }
}

struct Dashboard {
    news: Receiver<Message>,
    status: TrainingStatus,
    palette: Palette,
    start: Instant,
    drawn: Option<Instant>,
    changed: bool,
}

impl Dashboard {
    fn run(
        mut self,
        mut terminal: ScreenTerminal,
        keyboard: &Keyboard,
        stop: oneshot::Sender<()>,
    ) -> Result<()> {
        loop {
            if !self.receive() {
                return Ok(());
            }
            self.draw(&mut terminal)?;
            // A closed terminal does not stop the training.
            let Some(events) = keyboard.events(POLL)? else {
                return Ok(());
            };
            self.changed |= !events.is_empty();
            if events
                .iter()
                .any(|e| e.as_key_event().is_some_and(|key| is_stop(&key)))
            {
                drop(terminal);
                let _ = stop.send(());
                return Ok(());
            }
        }
    }

    /// Handles pending messages; false closes the dashboard.
    fn receive(&mut self) -> bool {
        loop {
            match self.news.try_recv() {
                Ok(Message::News(news)) => {
                    self.status.apply(news, self.start.elapsed());
                    self.changed = true;
                }
                Ok(Message::Close) | Err(TryRecvError::Disconnected) => return false,
                Err(TryRecvError::Empty) => return true,
            }
        }
    }

    fn draw(&mut self, terminal: &mut ScreenTerminal) -> Result<()> {
        let interval = match self.changed {
            true => MIN_INTERVAL,
            false => MAX_INTERVAL,
        };
        if self.drawn.is_some_and(|at| at.elapsed() < interval) {
            return Ok(());
        }
        self.status.set_elapsed(self.start.elapsed());
        let (status, palette) = (&self.status, self.palette);
        terminal.draw(|frame| dashboard::draw(frame, status, palette))?;
        self.drawn = Some(Instant::now());
        self.changed = false;
        Ok(())
    }
}

/// Returns whether the key stops the training.
fn is_stop(key: &KeyEvent) -> bool {
    let is_q = key.kind == KeyEventKind::Press
        && matches!(key.code, KeyCode::Char('q' | 'Q'))
        && (key.modifiers - KeyModifiers::SHIFT).is_empty();
    is_q || is_interrupt(key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn q_and_control_c_stop_the_training() {
        let key = |c, modifiers| KeyEvent::new(KeyCode::Char(c), modifiers);
        assert!(is_stop(&key('q', KeyModifiers::NONE)));
        assert!(is_stop(&key('Q', KeyModifiers::SHIFT)));
        assert!(is_stop(&key('c', KeyModifiers::CONTROL)));
        assert!(!is_stop(&key('c', KeyModifiers::NONE)));
        assert!(!is_stop(&key('q', KeyModifiers::CONTROL)));
        let mut released = key('q', KeyModifiers::NONE);
        released.kind = KeyEventKind::Release;
        assert!(!is_stop(&released));
    }
}
