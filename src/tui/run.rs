//! The loop of the screen: newest status in, image out; keys in, commands out.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crossterm::event::{self, Event};
use tokio::sync::{mpsc, watch};

use super::collect;
use super::keyboard::Keyboard;
use super::palette::{ColourDepth, Palette};
use super::state::{Reaction, ScreenState};
use super::terminal::ScreenTerminal;
use super::tone::{Sound, Speaker};
use crate::daemon::{CommandRequest, EngineStatus};
use gripcast_base::error::{Error, Result};
use gripcast_session::{Command, CommandSource, Tone};

/// Longest wait for a key; bounds how late a tone, a status or the engine's end is noticed.
const POLL: Duration = Duration::from_millis(50);
/// Shortest time between two images: 10 per second are plenty and cost little over SSH.
const MIN_INTERVAL: Duration = Duration::from_millis(100);

/// All that joins the screen to the engine.
pub struct Wiring {
    /// The newest status. When its sender is dropped the engine has ended and the screen leaves.
    pub status: watch::Receiver<Arc<EngineStatus>>,
    /// What the operator asks for. When full, the key is dropped and the screen says so.
    pub commands: mpsc::Sender<CommandRequest>,
    /// Sounds to give, in order. A dropped sender means that there are no more.
    pub tones: mpsc::UnboundedReceiver<Tone>,
    /// How sounds are given.
    pub sound: Sound,
}

/// Shows the screen until the operator quits or the engine ends; blocks its thread.
///
/// On quit it sends [`Command::Quit`], restores the terminal and returns within 100 ms; the engine
/// finishes what it is saving on its own.
///
/// # Errors
/// When the terminal cannot be used; the engine is not affected and can go on without a screen.
pub fn run(wiring: Wiring) -> Result<()> {
    let depth = ColourDepth::from_environment(|name| std::env::var(name).ok());
    let keyboard = Keyboard::open().map_err(unreadable)?;
    let mut terminal = ScreenTerminal::enter()?;
    let mut screen = Screen {
        state: ScreenState::new(Palette { depth }),
        speaker: Speaker::new(wiring.sound),
        wiring,
        drawn: None,
        changed: true,
    };
    while screen.turn(&mut terminal, &keyboard)? {}
    Ok(())
}

struct Screen {
    wiring: Wiring,
    state: ScreenState,
    speaker: Speaker,
    /// When the last image was drawn.
    drawn: Option<Instant>,
    /// Whether it is out of date.
    changed: bool,
}

impl Screen {
    /// One turn of the loop; false ends it.
    fn turn(&mut self, terminal: &mut ScreenTerminal, keyboard: &Keyboard) -> Result<bool> {
        match self.wiring.status.has_changed() {
            Ok(changed) => self.changed |= changed,
            Err(_) => return Ok(false),
        }
        self.sound(terminal)?;
        if self.changed && self.drawn.is_none_or(|at| at.elapsed() >= MIN_INTERVAL) {
            self.draw(terminal)?;
        }
        // Keys are read until none waits, so that a burst costs one image.
        if !keyboard.wait(POLL).map_err(unreadable)? {
            return Ok(false);
        }
        while event::poll(Duration::ZERO).map_err(unreadable)? {
            if !self.take(&event::read().map_err(unreadable)?) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    fn sound(&mut self, terminal: &mut ScreenTerminal) -> Result<()> {
        let now = Instant::now();
        while let Ok(tone) = self.wiring.tones.try_recv() {
            self.speaker.give(tone, now);
        }
        for _ in 0..self.speaker.bells_due(now) {
            terminal.ring()?;
        }
        Ok(())
    }

    fn draw(&mut self, terminal: &mut ScreenTerminal) -> Result<()> {
        let status = Arc::clone(&self.wiring.status.borrow_and_update());
        self.state.settle(&status);
        terminal.draw(|frame| collect::draw(frame, &status, &self.state))?;
        self.drawn = Some(Instant::now());
        self.changed = false;
        Ok(())
    }

    /// Takes an event; false leaves the screen.
    fn take(&mut self, event: &Event) -> bool {
        self.changed = true;
        let Event::Key(key) = event else {
            return true;
        };
        let status = Arc::clone(&self.wiring.status.borrow());
        match self.state.press(key, &status) {
            Reaction::None => {}
            Reaction::Send(command) => self.send(command),
            Reaction::Leave => {
                self.send(Command::Quit);
                return false;
            }
        }
        true
    }

    fn send(&mut self, command: Command) {
        let name = command.to_string();
        let sent = self
            .wiring
            .commands
            .try_send(CommandRequest::new(command, CommandSource::Keyboard));
        if sent.is_err() {
            self.state.notice = Some(format!("`{name}` was not taken: the engine is busy"));
        }
    }
}

fn unreadable(source: std::io::Error) -> Error {
    Error::io("cannot read keys from this terminal", source)
        .remedy("run it in a terminal, or without the screen (--headless)")
}
