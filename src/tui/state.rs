//! What the screen remembers between two images, and how keys change it.

use crossterm::event::KeyEvent;

use super::fault::faults;
use super::input::{self, UiAction, UiChange};
use super::palette::Palette;
use super::prompt::{Prompt, Reply};
use crate::daemon::EngineStatus;
use gripcast_imaging::Role;
use gripcast_session::{Command, Step};

/// What lies over the collect screen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Overlay {
    /// Nothing.
    #[default]
    None,
    /// The keys.
    Help,
    /// The sensors in detail.
    Sensors,
}

/// What a key leads to outside the screen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reaction {
    /// Nothing.
    None,
    /// Send this to the session.
    Send(Command),
    /// End the session and leave.
    Leave,
}

/// State of the screen that is not part of the session.
#[derive(Clone, Debug)]
pub struct ScreenState {
    /// Colours.
    pub palette: Palette,
    /// What lies on top.
    pub overlay: Overlay,
    /// The name that is being typed.
    pub prompt: Option<Prompt>,
    /// A line of the screen itself, shown instead of the session's message.
    pub notice: Option<String>,
    leaving: bool,
    shrunk_faults: Vec<Role>,
}

impl ScreenState {
    /// Nothing open.
    pub fn new(palette: Palette) -> Self {
        Self {
            palette,
            overlay: Overlay::None,
            prompt: None,
            notice: None,
            leaving: false,
            shrunk_faults: Vec::new(),
        }
    }

    /// Takes a key, as seen by an operator who looks at `status`.
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
            UiAction::Ui(change) => self.change(change, status),
        }
        Reaction::None
    }

    /// Asks first when a save runs or the last grasp has no label.
    fn quit(&mut self, confirmed: bool, status: &EngineStatus) -> Reaction {
        let unfinished = match &status.session {
            session if session.saving => "a save is running",
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

    fn change(&mut self, change: UiChange, status: &EngineStatus) {
        let toggled = |overlay, wanted| {
            if overlay == wanted {
                Overlay::None
            } else {
                wanted
            }
        };
        match change {
            UiChange::Help => self.overlay = toggled(self.overlay, Overlay::Help),
            UiChange::Sensors => self.overlay = toggled(self.overlay, Overlay::Sensors),
            UiChange::Ask(field) => self.prompt = Some(Prompt::new(field, &status.session)),
            UiChange::Close if self.overlay != Overlay::None => self.overlay = Overlay::None,
            UiChange::Close => {
                self.shrunk_faults = faults(status).map(|camera| camera.role).collect();
            }
        }
    }

    /// Forgets what the new status has settled: a camera that is back may fail loudly again.
    pub fn settle(&mut self, status: &EngineStatus) {
        self.shrunk_faults
            .retain(|role| faults(status).any(|camera| camera.role == *role));
    }

    /// Whether a camera has failed that the operator has not yet put aside.
    pub(super) fn shows_fault(&self, status: &EngineStatus) -> bool {
        faults(status).any(|camera| !self.shrunk_faults.contains(&camera.role))
    }
}
