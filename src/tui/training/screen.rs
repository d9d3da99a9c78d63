//! The dashboard on the terminal: news in, images out; a key asks for the end.

use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, TryRecvError};
use std::thread;
use std::time::{Duration, Instant};

use crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use tokio::sync::oneshot;

use super::super::input::is_interrupt;
use super::super::keyboard::Keyboard;
use super::super::palette::{ColourDepth, Palette};
use super::super::terminal::ScreenTerminal;
use super::dashboard;
use super::status::{TrainingNews, TrainingStatus};
use gripcast_base::error::{Error, Result};

/// Longest wait for a key; bounds how late news are noticed.
const POLL: Duration = Duration::from_millis(50);
/// Shortest time between two images.
const MIN_INTERVAL: Duration = Duration::from_millis(100);
/// Longest one: the clock goes on.
const MAX_INTERVAL: Duration = Duration::from_secs(1);
/// How long the screen may take to come to its end.
const PATIENCE: Duration = Duration::from_secs(2);

/// The dashboard's thread.
pub(crate) struct TrainingScreen {
    messages: Sender<Message>,
    ended: Receiver<Result<()>>,
}

enum Message {
    News(TrainingNews),
    Close,
}

impl TrainingScreen {
    /// Takes the terminal. The receiver is told when a key asks to stop; nobody asks any more
    /// where its sender is dropped.
    ///
    /// # Errors
    /// When the terminal cannot be used.
    pub(crate) fn start(status: TrainingStatus) -> Result<(Self, oneshot::Receiver<()>)> {
        let keyboard = Keyboard::open().map_err(unreadable)?;
        let depth = ColourDepth::from_environment(|name| std::env::var(name).ok());
        let terminal = ScreenTerminal::enter()?;
        let (messages, news) = mpsc::channel();
        let (stop, asked) = oneshot::channel();
        let (sender, ended) = mpsc::channel();
        let shown = Shown {
            news,
            status,
            palette: Palette { depth },
            begun: Instant::now(),
            drawn: None,
            changed: true,
        };
        thread::Builder::new()
            .name("screen".into())
            .spawn(move || {
                // Nobody asks any more where the process ends without the screen.
                let _ = sender.send(shown.run(terminal, &keyboard, stop));
            })
            .map_err(|e| Error::io("cannot start a thread", e))?;
        Ok((Self { messages, ended }, asked))
    }

    /// Tells the dashboard; never waits.
    pub(crate) fn teller(&self) -> impl Fn(TrainingNews) + Send + Sync + use<> {
        let messages = self.messages.clone();
        move |news| {
            // The screen has gone with its terminal, and the training goes on.
            let _ = messages.send(Message::News(news));
        }
    }

    /// Closes it and waits until the terminal is as it was. That does not come on a terminal that
    /// takes nothing any more: the end of the process takes the thread with it.
    ///
    /// # Errors
    /// Why the screen ended on its own.
    pub(crate) fn end(self) -> Result<()> {
        let _ = self.messages.send(Message::Close);
        match self.ended.recv_timeout(PATIENCE) {
            Ok(result) => result,
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => Err(Error::internal("the dashboard panicked")),
        }
    }
}

struct Shown {
    news: Receiver<Message>,
    status: TrainingStatus,
    palette: Palette,
    begun: Instant,
    drawn: Option<Instant>,
    changed: bool,
}

impl Shown {
    fn run(
        mut self,
        mut terminal: ScreenTerminal,
        keyboard: &Keyboard,
        stop: oneshot::Sender<()>,
    ) -> Result<()> {
        loop {
            if !self.listen() {
                return Ok(());
            }
            self.draw(&mut terminal)?;
            // A terminal that has gone is nobody's wish to stop.
            if !keyboard.wait(POLL).map_err(unreadable)? {
                return Ok(());
            }
            while event::poll(Duration::ZERO).map_err(unreadable)? {
                self.changed = true;
                if let Event::Key(key) = event::read().map_err(unreadable)?
                    && stops(&key)
                {
                    drop(terminal);
                    let _ = stop.send(());
                    return Ok(());
                }
            }
        }
    }

    /// Takes what was told; false closes.
    fn listen(&mut self) -> bool {
        loop {
            match self.news.try_recv() {
                Ok(Message::News(news)) => {
                    self.status.take(news, self.begun.elapsed());
                    self.changed = true;
                }
                Ok(Message::Close) | Err(TryRecvError::Disconnected) => return false,
                Err(TryRecvError::Empty) => return true,
            }
        }
    }

    fn draw(&mut self, terminal: &mut ScreenTerminal) -> Result<()> {
        let since = self.drawn.map(|at| at.elapsed());
        let least = if self.changed {
            MIN_INTERVAL
        } else {
            MAX_INTERVAL
        };
        if since.is_some_and(|since| since < least) {
            return Ok(());
        }
        self.status.wait(self.begun.elapsed());
        let (status, palette) = (&self.status, self.palette);
        terminal.draw(|frame| dashboard::draw(frame, status, palette))?;
        self.drawn = Some(Instant::now());
        self.changed = false;
        Ok(())
    }
}

/// Whether the key asks for the end.
fn stops(key: &KeyEvent) -> bool {
    let is_q = key.kind == KeyEventKind::Press
        && matches!(key.code, KeyCode::Char('q' | 'Q'))
        && (key.modifiers - KeyModifiers::SHIFT).is_empty();
    is_q || is_interrupt(key)
}

fn unreadable(source: std::io::Error) -> Error {
    Error::io("cannot read keys from this terminal", source)
        .remedy("run it without the screen (--headless)")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn q_and_control_c_ask_for_the_end() {
        let key = |c, modifiers| KeyEvent::new(KeyCode::Char(c), modifiers);
        assert!(stops(&key('q', KeyModifiers::NONE)));
        assert!(stops(&key('Q', KeyModifiers::SHIFT)));
        assert!(stops(&key('c', KeyModifiers::CONTROL)));
        assert!(!stops(&key('c', KeyModifiers::NONE)));
        assert!(!stops(&key('q', KeyModifiers::CONTROL)));
        let mut released = key('q', KeyModifiers::NONE);
        released.kind = KeyEventKind::Release;
        assert!(!stops(&released));
    }
}
