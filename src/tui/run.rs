//! Event loop of the screen: draws the newest status and sends commands.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crossterm::event::Event;
use tokio::sync::{mpsc, watch};

use super::collect;
use super::graphics::{Graphics, TerminalGraphics};
use super::keyboard::{Keyboard, unreadable};
use super::palette::{ColourDepth, Palette};
use super::state::{Reaction, ScreenState};
use super::terminal::ScreenTerminal;
use super::tone::{Sound, Speaker};
use crate::daemon::{CommandRequest, EngineStatus};
use gripcast_base::error::Result;
use gripcast_session::{Command, CommandSource, Tone};

/// Maximum wait for a key; bounds the delay of tones, status updates and the end of the engine.
const POLL: Duration = Duration::from_millis(50);
/// Minimum interval between two images, to save bandwidth over SSH.
const MIN_INTERVAL: Duration = Duration::from_millis(100);

/// How the screen outputs tones and images.
#[derive(Clone, Copy, Debug, Default)]
pub struct Output {
    /// Output of tones.
    pub sound: Sound,
    /// Output of images.
    pub graphics: Graphics,
}

/// Channels between screen and engine.
pub struct Wiring {
    /// Incoming status. A dropped sender means the engine has ended and closes the screen.
    pub status: watch::Receiver<Arc<EngineStatus>>,
    /// Outgoing commands. If the channel is full, the key is dropped with a notice.
    pub commands: mpsc::Sender<CommandRequest>,
    /// Incoming tones.
    pub tones: mpsc::UnboundedReceiver<Tone>,
    /// Output of tones and images.
    pub output: Output,
}

/// Runs the screen until the operator quits or the engine ends; blocks the thread.
///
/// On quit it sends [`Command::Quit`], restores the terminal and returns within 100 ms; the engine
/// finishes pending saves on its own.
///
/// # Errors
/// If the terminal cannot be used; the engine is not affected.
pub fn run(wiring: Wiring) -> Result<()> {
    let depth = ColourDepth::from_environment(|name| std::env::var(name).ok());
    let keyboard = Keyboard::open().map_err(unreadable)?;
    let mut terminal = ScreenTerminal::enter()?;
    let graphics = terminal.graphics(wiring.output.graphics, &keyboard)?;
    let mut screen = Screen {
        graphics,
        state: ScreenState::new(Palette { depth }),
        speaker: Speaker::new(wiring.output.sound),
        wiring,
        drawn: None,
        changed: true,
    };
    while screen.update(&mut terminal, &keyboard)? {}
    Ok(())
}

struct Screen {
    wiring: Wiring,
    state: ScreenState,
    speaker: Speaker,
    /// Graphics of the terminal, or `None` for half blocks.
    graphics: Option<TerminalGraphics>,
    /// Time of the last drawing.
    drawn: Option<Instant>,
    /// Whether the screen is out of date.
    changed: bool,
}

impl Screen {
    /// Runs one iteration of the loop; false ends it.
    fn update(&mut self, terminal: &mut ScreenTerminal, keyboard: &Keyboard) -> Result<bool> {
        match self.wiring.status.has_changed() {
            Ok(changed) => self.changed |= changed,
            Err(_) => return Ok(false),
        }
        self.sound(terminal)?;
        if self.changed && self.drawn.is_none_or(|at| at.elapsed() >= MIN_INTERVAL) {
            self.draw(terminal)?;
        }
        let Some(events) = keyboard.events(POLL)? else {
            return Ok(false);
        };
        let stays = self.handle(&events, Instant::now());
        terminal.report_key_kinds(self.state.prompt.is_none())?;
        Ok(stays)
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
        self.state.update(&status);
        let mut graphics = self.graphics.as_mut();
        if let Some(graphics) = &mut graphics {
            graphics.start(Instant::now());
        }
        terminal.draw(|frame| collect::draw_with(frame, &status, &self.state, graphics))?;
        self.drawn = Some(Instant::now());
        self.changed = false;
        Ok(())
    }

    /// Handles events; false closes the screen.
    fn handle(&mut self, events: &[Event], now: Instant) -> bool {
        self.changed |= !events.is_empty();
        if let Some(graphics) = &mut self.graphics
            && events.iter().any(Event::is_resize)
        {
            graphics.resize();
        }
        let status = Arc::clone(&self.wiring.status.borrow());
        let mut reactions = self.state.handle(events, now, &status);
        reactions.extend(self.state.handle_waiting(now, &status));
        for reaction in reactions {
            self.changed = true;
            match reaction {
                Reaction::None => {}
                Reaction::Send(command) => self.send(command),
                Reaction::Leave => {
                    self.send(Command::Quit);
                    return false;
                }
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
            self.state.notice = Some(format!("`{name}` not sent: the engine is busy"));
        }
    }
}
