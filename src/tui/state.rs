//! State of the screen and its changes by keys.

use crossterm::event::KeyEvent;

use super::fault::faults;
use super::input::{self, UiAction};
use super::palette::Palette;
use super::prompt::{Field, Prompt, Reply};
use crate::daemon::{EngineStatus, StartFinding};
use gripcast_imaging::Role;
use gripcast_session::{Command, Step};

/// Overlay of the collect screen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Overlay {
    /// No overlay.
    #[default]
    None,
    /// Key overview.
    Help,
    /// Sensor details.
    Sensors,
}

/// Effect of a key outside the screen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reaction {
    /// No effect.
    None,
    /// Send a command to the session.
    Send(Command),
    /// End the session and leave.
    Leave,
}

/// State of the screen that is not part of the session.
#[derive(Clone, Debug)]
pub struct ScreenState {
    /// Colours.
    pub palette: Palette,
    /// Current overlay.
    pub overlay: Overlay,
    /// Open prompt.
    pub prompt: Option<Prompt>,
    /// Notice of the screen, shown instead of the session's message.
    pub notice: Option<String>,
    leaving: bool,
    dismissed_faults: Vec<Role>,
    pub(super) dismissed_warnings: Vec<StartFinding>,
}

impl ScreenState {
    /// Creates the state without overlay and prompt.
    pub fn new(palette: Palette) -> Self {
        Self {
            palette,
            overlay: Overlay::None,
            prompt: None,
            notice: None,
            leaving: false,
            dismissed_faults: Vec::new(),
            dismissed_warnings: Vec::new(),
        }
    }

    /// Handles a key while `status` is shown.
    pub fn press(&mut self, key: &KeyEvent, status: &EngineStatus) -> Reaction {
        if input::is_interrupt(key) {
            return Reaction::Leave;
        }
        if let Some(prompt) = &mut self.prompt {
            if key.kind == crossterm::event::KeyEventKind::Release {
                return Reaction::None;
            }
            let reply = prompt.press(key);
            if reply != Reply::Editing {
                self.prompt = None;
            }
            return match reply {
                Reply::Accepted(command) => Reaction::Send(command),
                Reply::Editing | Reply::Cancelled => Reaction::None,
            };
        }
        let Some(action) = input::action(key) else {
            return Reaction::None;
        };
        self.notice = None;
        let confirmed = std::mem::take(&mut self.leaving);
        match action {
            UiAction::Command(command) => return Reaction::Send(command),
            UiAction::QuitNow => return Reaction::Leave,
            UiAction::Quit => return self.quit(confirmed, status),
            UiAction::Toggle(overlay) if self.overlay == overlay => self.overlay = Overlay::None,
            UiAction::Toggle(overlay) => self.overlay = overlay,
            UiAction::Prompt(Field::LastObject) if status.session.last.is_none() => {
                self.notice = Some("no grasp to correct yet".to_owned());
            }
            UiAction::Prompt(field) => self.prompt = Some(Prompt::new(field, &status.session)),
            UiAction::Close if self.overlay != Overlay::None => self.overlay = Overlay::None,
            UiAction::Close => {
                self.dismissed_faults = faults(status).map(|camera| camera.role).collect();
                self.dismissed_warnings.clone_from(&status.start_report);
            }
        }
        Reaction::None
    }

    /// Asks for confirmation if a save is running or the last grasp has no label.
    fn quit(&mut self, confirmed: bool, status: &EngineStatus) -> Reaction {
        let unfinished = match &status.session {
            session if session.saving => "a save is in progress",
            session if session.step == Step::Label => "the last grasp is not labelled",
            _ => return Reaction::Leave,
        };
        if confirmed {
            return Reaction::Leave;
        }
        self.leaving = true;
        self.notice = Some(format!("{unfinished}: q again quits, any other key stays"));
        Reaction::None
    }

    /// Forgets dismissed faults of recovered cameras.
    pub fn update(&mut self, status: &EngineStatus) {
        self.dismissed_faults
            .retain(|role| faults(status).any(|camera| camera.role == *role));
    }

    /// Returns whether there is a fault that the operator has not dismissed.
    pub(super) fn shows_fault(&self, status: &EngineStatus) -> bool {
        faults(status).any(|camera| !self.dismissed_faults.contains(&camera.role))
    }
}
