//! Terminal in raw mode on the alternate screen, restored in every case.

use std::io::{self, BufWriter, Stdout, Write};
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossterm::cursor::{Hide, Show};
use crossterm::event::{
    DisableBracketedPaste, EnableBracketedPaste, KeyboardEnhancementFlags,
    PopKeyboardEnhancementFlags, PushKeyboardEnhancementFlags,
};
use crossterm::terminal::{
    BeginSynchronizedUpdate, EndSynchronizedUpdate, EnterAlternateScreen, LeaveAlternateScreen,
    disable_raw_mode, enable_raw_mode,
};
use crossterm::{execute, queue};
use ratatui::backend::CrosstermBackend;
use ratatui::layout::{Position, Rect};
use ratatui::{Frame, Terminal};

use super::graphics::{self, Answer, Graphics, GraphicsProtocol, TerminalGraphics};
use super::keyboard::Keyboard;
use super::palette::ColourDepth;
use gripcast_base::error::{Error, Result};

/// Write buffer: holds a 200×60 screen of half blocks in 24-bit colour, bytes.
const WRITE_BUFFER_BYTES: usize = 512 * 1024;

/// Maximum wait for each part of the terminal's answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);
const DELETE_KITTY_IMAGES: &[u8] = b"\x1b_Ga=d,d=A,q=2\x1b\\";

/// Whether the screen owns the terminal; see [`restore`].
static ENTERED: AtomicBool = AtomicBool::new(false);
/// Whether the terminal was asked for the kinds of key events; see
/// [`ScreenTerminal::report_key_kinds`].
static REPORTS_KEY_KINDS: AtomicBool = AtomicBool::new(false);
/// Whether the terminal may hold kitty images, which are to be deleted.
static HAS_KITTY_IMAGES: AtomicBool = AtomicBool::new(false);
static PANIC_HOOK: Once = Once::new();

/// The terminal while the screen is shown. It is restored on drop, and on a panic before the
/// message is printed.
pub(super) struct ScreenTerminal {
    terminal: Terminal<CrosstermBackend<BufWriter<Stdout>>>,
}

impl ScreenTerminal {
    /// Enters the alternate screen.
    ///
    /// # Errors
    /// If standard output is not a usable terminal.
    pub(super) fn enter() -> Result<Self> {
        PANIC_HOOK.call_once(|| {
            let earlier = std::panic::take_hook();
            std::panic::set_hook(Box::new(move |panic| {
                restore();
                earlier(panic);
            }));
        });
        let writer = BufWriter::with_capacity(WRITE_BUFFER_BYTES, io::stdout());
        let mut screen = Self {
            terminal: Terminal::new(CrosstermBackend::new(writer)).map_err(failed)?,
        };
        screen.take()?;
        Ok(screen)
    }

    fn take(&mut self) -> Result<()> {
        ENTERED.store(true, Ordering::SeqCst);
        enable_raw_mode().map_err(failed)?;
        execute!(
            self.terminal.backend_mut(),
            EnterAlternateScreen,
            Hide,
            EnableBracketedPaste
        )
        .map_err(failed)?;
        self.clear()
    }

    fn clear(&mut self) -> Result<()> {
        // Clears like `Terminal::clear`, but without querying the cursor, which may take seconds or
        // fail.
        let size = self.terminal.size().map_err(failed)?;
        self.terminal
            .resize(Rect::from((Position::ORIGIN, size)))
            .map_err(failed)
    }

    /// Draws one image, atomically on terminals with synchronized output.
    ///
    /// # Errors
    /// If the terminal is closed.
    pub(super) fn draw(&mut self, draw: impl FnOnce(&mut Frame<'_>)) -> Result<()> {
        if !ENTERED.load(Ordering::SeqCst) {
            // A panic of another thread has restored the terminal.
            self.take()?;
        }
        queue!(self.terminal.backend_mut(), BeginSynchronizedUpdate).map_err(failed)?;
        self.terminal.draw(draw).map_err(failed)?;
        execute!(self.terminal.backend_mut(), EndSynchronizedUpdate).map_err(failed)
    }

    /// Returns the graphics of the terminal, or `None` for half blocks. Waits at most
    /// [`ANSWER_TIMEOUT`] for a terminal that does not answer.
    ///
    /// # Errors
    /// If the terminal is closed.
    pub(super) fn graphics(
        &mut self,
        choice: Graphics,
        keyboard: &Keyboard,
    ) -> Result<Option<TerminalGraphics>> {
        let variable = |name: &str| std::env::var(name).ok();
        let is_mono = ColourDepth::from_environment(variable) == ColourDepth::Mono;
        if choice == Graphics::Blocks || choice == Graphics::Auto && is_mono {
            return Ok(None);
        }
        let mut answer = Answer::default();
        if graphics::can_be_asked(variable) {
            let backend = self.terminal.backend_mut();
            backend
                .write_all(graphics::QUESTION.as_bytes())
                .map_err(failed)?;
            io::Write::flush(backend).map_err(failed)?;
            let is_complete = |bytes: &[u8]| Answer::parse(bytes).is_complete;
            let bytes = keyboard.answer(ANSWER_TIMEOUT, is_complete);
            answer = Answer::parse(&bytes.map_err(failed)?);
            // Terminals may print what they do not know.
            self.clear()?;
        }
        let is_remote = variable("SSH_CONNECTION").is_some();
        let graphics = TerminalGraphics::new(choice, &answer, is_remote);
        let is_kitty = |g: &TerminalGraphics| g.protocol() == GraphicsProtocol::Kitty;
        HAS_KITTY_IMAGES.store(graphics.as_ref().is_some_and(is_kitty), Ordering::SeqCst);
        Ok(graphics)
    }

    /// Asks the terminal to say which key events are presses, repeats and releases (kitty keyboard
    /// protocol; other terminals ignore it). Off while text is typed: input methods need the
    /// terminal's own text.
    ///
    /// # Errors
    /// If the terminal is closed.
    pub(super) fn report_key_kinds(&mut self, on: bool) -> Result<()> {
        if REPORTS_KEY_KINDS.swap(on, Ordering::SeqCst) == on {
            return Ok(());
        }
        let backend = self.terminal.backend_mut();
        if on {
            let flags = KeyboardEnhancementFlags::DISAMBIGUATE_ESCAPE_CODES
                | KeyboardEnhancementFlags::REPORT_EVENT_TYPES
                | KeyboardEnhancementFlags::REPORT_ALTERNATE_KEYS
                | KeyboardEnhancementFlags::REPORT_ALL_KEYS_AS_ESCAPE_CODES;
            execute!(backend, PushKeyboardEnhancementFlags(flags))
        } else {
            execute!(backend, PopKeyboardEnhancementFlags)
        }
        .map_err(failed)
    }

    /// Rings the bell, between images only, so that it never splits an escape sequence.
    pub(super) fn ring(&mut self) -> Result<()> {
        let backend = self.terminal.backend_mut();
        backend.write_all(b"\x07").map_err(failed)?;
        io::Write::flush(backend).map_err(failed)
    }
}

impl Drop for ScreenTerminal {
    fn drop(&mut self) {
        restore();
    }
}

/// Restores the terminal if the screen owns it. Can be called repeatedly and from any thread.
///
/// Call it before the process ends without returning from [`super::run()`].
pub fn restore() {
    if ENTERED.swap(false, Ordering::SeqCst) {
        // Errors of a closing terminal are ignored.
        if HAS_KITTY_IMAGES.swap(false, Ordering::SeqCst) {
            let _ = io::stdout().write_all(DELETE_KITTY_IMAGES);
        }
        if REPORTS_KEY_KINDS.swap(false, Ordering::SeqCst) {
            let _ = execute!(io::stdout(), PopKeyboardEnhancementFlags);
        }
        let _ = execute!(
            io::stdout(),
            EndSynchronizedUpdate,
            DisableBracketedPaste,
            LeaveAlternateScreen,
            Show
        );
        let _ = disable_raw_mode();
    }
}

fn failed(source: io::Error) -> Error {
    Error::io("cannot show the screen in this terminal", source)
        .remedy("run in a terminal, or without a screen (--headless)")
}
