//! State of the screen and its changes by keys.

use std::time::Instant;

use crossterm::event::{Event, KeyEvent};

use super::fault::faults;
use super::input::{self, UiAction};
use super::key_filter::{Judged, KeyFilter};
use super::palette::Palette;
use super::preview::GelImages;
use super::prompt::{Field, Prompt, Reply};
use crate::daemon::{EngineStatus, StartFinding};
use gripcast_dataset::GraspId;
use gripcast_imaging::Role;
use gripcast_session::{Command, Message, SessionView, Step};

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
    /// Shown images of the gels.
    pub gels: GelImages,
    /// Open prompt.
    pub prompt: Option<Prompt>,
    /// Notice of the screen, shown instead of the session's message.
    pub notice: Option<String>,
    keys: KeyFilter,
    /// Session during which a hint was shown; the next change of the session ends the hint.
    hinted_at: Option<Moment>,
    leaving: bool,
    dismissed_faults: Vec<Role>,
    pub(super) dismissed_warnings: Vec<StartFinding>,
}

/// What tells one state of the session from the next.
type Moment = (Step, bool, Option<GraspId>, Option<Message>);

fn moment(session: &SessionView) -> Moment {
    let last = session.last.as_ref().map(|last| last.id.clone());
    let message = session.message.clone();
    (session.step, session.saving, last, message)
}

impl ScreenState {
    /// Creates the state without overlay and prompt.
    pub fn new(palette: Palette) -> Self {
        Self {
            palette,
            overlay: Overlay::None,
            gels: GelImages::default(),
            prompt: None,
            notice: None,
            keys: KeyFilter::default(),
            hinted_at: None,
            leaving: false,
            dismissed_faults: Vec::new(),
            dismissed_warnings: Vec::new(),
        }
    }

    /// Handles the events that were read at once at `now` while `status` is shown. Repeats of held
    /// keys, pasted text and answers of the terminal are not commands.
    pub fn handle(
        &mut self,
        events: &[Event],
        now: Instant,
        status: &EngineStatus,
    ) -> Vec<Reaction> {
        let mut reactions = Vec::new();
        self.keys.start_batch();
        for (index, event) in events.iter().enumerate() {
            match event {
                Event::Key(key) if input::is_interrupt(key) => reactions.push(Reaction::Leave),
                Event::Key(key) => {
                    reactions.extend(self.follow_up(now, Some(key), status));
                    reactions.push(self.filtered(key, &events[index..], now, status));
                }
                Event::Paste(text) => self.paste(text, status),
                _ => {}
            }
        }
        reactions.retain(|reaction| *reaction != Reaction::None);
        reactions
    }

    /// Handles the press that waited for its repeat, if it is due at `now`.
    pub fn handle_waiting(&mut self, now: Instant, status: &EngineStatus) -> Option<Reaction> {
        self.follow_up(now, None, status)
    }

    fn follow_up(
        &mut self,
        now: Instant,
        next: Option<&KeyEvent>,
        status: &EngineStatus,
    ) -> Option<Reaction> {
        let waited = self.keys.take_waiting(now, next)?;
        Some(self.press(&waited, status))
    }

    fn filtered(
        &mut self,
        key: &KeyEvent,
        rest: &[Event],
        now: Instant,
        status: &EngineStatus,
    ) -> Reaction {
        let opens_prompt = matches!(input::action(key), Some(UiAction::Prompt(_)));
        let judged = match self.prompt {
            Some(_) => self.keys.judge_typed(key, now),
            // A name that a script types arrives with the key of its prompt.
            None if opens_prompt => self.keys.judge(key, &[], now),
            None => self.keys.judge(key, rest, now),
        };
        match judged {
            Judged::Press => return self.press(key, status),
            Judged::Text => self.hint("text that arrives at once is not commands", status),
            Judged::Nothing => {}
        }
        Reaction::None
    }

    fn paste(&mut self, text: &str, status: &EngineStatus) {
        let hint = match &mut self.prompt {
            Some(prompt) => match prompt.paste(text) {
                true => return,
                false => "the pasted text was cut to the longest name",
            },
            None => "pasted text is not commands; paste it into a name (o, n, p)",
        };
        self.hint(hint, status);
    }

    /// Shows `text` until a key is pressed or the session changes.
    fn hint(&mut self, text: &str, status: &EngineStatus) {
        self.notice = Some(text.to_owned());
        self.hinted_at = Some(moment(&status.session));
    }

    /// Handles a press of a key while `status` is shown.
    pub fn press(&mut self, key: &KeyEvent, status: &EngineStatus) -> Reaction {
        if input::is_interrupt(key) {
            return Reaction::Leave;
        }
        if let Some(prompt) = &mut self.prompt {
            self.notice = None;
            let reply = prompt.press(key);
            if reply != Reply::Editing {
                self.prompt = None;
            }
            return match reply {
                Reply::Accepted(command) => Reaction::Send(command),
                Reply::Editing | Reply::Cancelled => Reaction::None,
            };
        }
        let confirmed = std::mem::take(&mut self.leaving);
        let Some(action) = input::action(key) else {
            if let Some(name) = input::unbound(key) {
                let hint = format!("{name} is not bound: Space triggers, ? shows the keys");
                self.hint(&hint, status);
            }
            return Reaction::None;
        };
        self.notice = None;
        match action {
            UiAction::Command(command) => return Reaction::Send(command),
            UiAction::QuitNow => return Reaction::Leave,
            UiAction::Quit => return self.quit(confirmed, status),
            UiAction::Toggle(overlay) if self.overlay == overlay => self.overlay = Overlay::None,
            UiAction::Toggle(overlay) => self.overlay = overlay,
            UiAction::NextGelImages => self.gels = self.gels.next(),
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

    /// Forgets dismissed faults of recovered cameras, and a hint once the session has changed.
    pub fn update(&mut self, status: &EngineStatus) {
        let has_changed = |hinted_at: &mut Moment| *hinted_at != moment(&status.session);
        if self.hinted_at.take_if(has_changed).is_some() {
            self.notice = None;
        }
        self.dismissed_faults
            .retain(|role| faults(status).any(|camera| camera.role == *role));
    }

    /// Returns whether there is a fault that the operator has not dismissed.
    pub(super) fn shows_fault(&self, status: &EngineStatus) -> bool {
        faults(status).any(|camera| !self.dismissed_faults.contains(&camera.role))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use crossterm::event::{KeyCode, KeyEventKind, KeyModifiers};

    use super::*;
    use crate::tui::palette::ColourDepth;
    use gripcast_dataset::Outcome;
    use gripcast_session::{Labels, MessageLevel};

    fn state() -> ScreenState {
        ScreenState::new(Palette {
            depth: ColourDepth::Mono,
        })
    }

    fn status() -> EngineStatus {
        EngineStatus::starting("d", "r", Labels::default())
    }

    fn key(code: KeyCode, kind: KeyEventKind) -> Event {
        Event::Key(KeyEvent::new_with_kind(code, KeyModifiers::NONE, kind))
    }

    fn typed(text: &str) -> Vec<Event> {
        let key_of = |c| match c {
            '\n' => KeyCode::Enter,
            c => KeyCode::Char(c),
        };
        let pressed = |c| key(key_of(c), KeyEventKind::Press);
        text.chars().map(pressed).collect()
    }

    /// Handles batches of events with their times, ms, and polls in between, every 50 ms.
    fn reactions(state: &mut ScreenState, batches: &[(u64, Vec<Event>)]) -> Vec<(u64, Reaction)> {
        let (start, status) = (Instant::now(), status());
        let mut all = Vec::new();
        let end = batches.iter().map(|(at, _)| at + 1_000).max().unwrap_or(0);
        for ms in 0..=end {
            let now = start + Duration::from_millis(ms);
            for (_, events) in batches.iter().filter(|(at, _)| *at == ms) {
                let reactions = state.handle(events, now, &status);
                all.extend(reactions.into_iter().map(|reaction| (ms, reaction)));
            }
            if ms % 50 == 0 {
                all.extend(
                    state
                        .handle_waiting(now, &status)
                        .map(|reaction| (ms, reaction)),
                );
            }
        }
        all
    }

    /// Events of a key that is held from `from` on, with the delay and interval of its repeats.
    fn held(c: char, from: u64, delay: u64, interval: u64, until: u64) -> Vec<(u64, Vec<Event>)> {
        let mut batches = vec![(from, typed(&c.to_string()))];
        let mut at = from + delay;
        while at <= until {
            batches.push((at, typed(&c.to_string())));
            at += interval;
        }
        batches
    }

    const TRIGGER: Reaction = Reaction::Send(Command::Trigger);
    const UNDO: Reaction = Reaction::Send(Command::Undo);

    #[test]
    fn held_key_is_one_press() {
        for (delay, interval) in [(250, 20), (500, 33), (660, 40), (1000, 91), (100, 149)] {
            let batches = held(' ', 10, delay, interval, 3_000);
            let all = reactions(&mut state(), &batches);
            assert_eq!(all, [(10, TRIGGER)], "{delay} {interval}");
        }
    }

    #[test]
    fn bouncing_key_is_one_press() {
        let bounces = [0, 40, 120, 260, 400].map(|at| (at, typed("u")));
        assert_eq!(reactions(&mut state(), &bounces), [(0, UNDO)]);
    }

    #[test]
    fn key_pressed_twice_is_two_presses() {
        let after = |ms| reactions(&mut state(), &[(0, typed("u")), (ms, typed("u"))]);
        assert_eq!(after(300), [(0, UNDO), (450, UNDO)]);
        assert_eq!(after(1_200), [(0, UNDO), (1_200, UNDO)]);
        let mut again = held(' ', 0, 300, 30, 900);
        again.push((1_100, typed(" ")));
        assert_eq!(
            reactions(&mut state(), &again),
            [(0, TRIGGER), (1_100, TRIGGER)]
        );
    }

    #[test]
    fn key_after_another_one_does_not_wait() {
        let batches = [(0, typed(" ")), (300, typed("u")), (500, typed(" "))];
        let all = reactions(&mut state(), &batches);
        assert_eq!(all, [(0, TRIGGER), (300, UNDO), (500, TRIGGER)]);
        let batches = [(0, typed(" ")), (300, typed(" ")), (330, typed("u"))];
        let all = reactions(&mut state(), &batches);
        assert_eq!(all, [(0, TRIGGER), (330, TRIGGER), (330, UNDO)]);
    }

    #[test]
    fn kinds_of_key_events_replace_the_times() {
        let event = |kind| vec![key(KeyCode::Char('u'), kind)];
        let [press, repeat, release] = [
            KeyEventKind::Press,
            KeyEventKind::Repeat,
            KeyEventKind::Release,
        ];
        let batches = [
            (0, event(press)),
            (500, event(repeat)),
            (530, event(repeat)),
            (600, event(release)),
            (800, event(press)),
            (850, event(release)),
            (1_100, event(press)),
        ];
        let all = reactions(&mut state(), &batches);
        assert_eq!(all, [(0, UNDO), (800, UNDO), (1_100, UNDO)]);
    }

    #[test]
    fn key_that_closes_a_prompt_is_not_a_command_while_held() {
        let mut state = state();
        let mut batches = vec![(0, typed("o")), (200, typed("mug"))];
        batches.extend((0..20).map(|i| (400 + 30 * i, typed("\n"))));
        let object = Reaction::Send(Command::Object("mug".parse().unwrap()));
        assert_eq!(reactions(&mut state, &batches), [(400, object)]);
        assert_eq!(state.notice, None);
    }

    #[test]
    fn pasted_text_is_never_a_command() {
        let mut state = state();
        let paste = |text: &str| vec![Event::Paste(text.to_owned())];
        let batches = [(0, paste("suf \n!q")), (10, paste(&"sfu ".repeat(2_500)))];
        assert_eq!(reactions(&mut state, &batches), []);
        assert!(
            state
                .notice
                .as_deref()
                .unwrap()
                .contains("paste it into a name")
        );

        let name = [
            (0, typed("o")),
            (300, paste(" mug\tblue\r\n\u{1b}[31m\u{202e}2 ")),
            (600, typed("\n")),
        ];
        let object = Reaction::Send(Command::Object("mug blue [31m2".parse().unwrap()));
        assert_eq!(reactions(&mut state, &name), [(600, object)]);

        let long = [(0, typed("n")), (300, paste(&"x".repeat(10_000)))];
        assert_eq!(reactions(&mut state, &long), []);
        assert!(state.notice.as_deref().unwrap().contains("cut"));
    }

    #[test]
    fn text_without_bracketed_paste_is_not_commands() {
        let mut state = state();
        let chunks: Vec<_> = (0..10)
            .map(|i| (20 * i, typed("stable slip\nundo")))
            .chain([(200, typed("su")), (500, typed(" "))])
            .collect();
        assert_eq!(reactions(&mut state, &chunks), [(500, TRIGGER)]);
        // A script types a name at once.
        let object = Reaction::Send(Command::Object("mug-blue".parse().unwrap()));
        let name = [(2_000, typed("omug-blue\n"))];
        assert_eq!(reactions(&mut state, &name), [(2_000, object)]);
        // Keys that waited while the terminal was slow.
        let queued = [(4_000, typed("ssssssss"))];
        let stable = Reaction::Send(Command::Label(Outcome::Stable));
        assert_eq!(reactions(&mut state, &queued), [(4_000, stable)]);
    }

    #[test]
    fn answers_of_the_terminal_are_not_commands() {
        let answer = |introducer, text: &str, end: Event| {
            let mut events = vec![alt(introducer)];
            events.extend(typed(text));
            events.push(end);
            events
        };
        let bell = Event::Key(KeyEvent::new(KeyCode::Char('g'), KeyModifiers::CONTROL));
        let batches = [
            (0, answer('_', "Gi=1;", alt('\\'))),
            (300, answer(']', "0;s", bell)),
            (600, answer('P', ">|f", alt('\\'))),
            (900, typed("u")),
        ];
        assert_eq!(reactions(&mut state(), &batches), [(900, UNDO)]);
    }

    fn alt(c: char) -> Event {
        Event::Key(KeyEvent::new(KeyCode::Char(c), KeyModifiers::ALT))
    }

    #[test]
    fn unbound_keys_give_a_hint_until_the_session_changes() {
        let mut state = state();
        for (code, name) in [
            (KeyCode::PageDown, "Page Down"),
            (KeyCode::F(5), "F5"),
            (KeyCode::Char('.'), "."),
            (KeyCode::Char('x'), "X"),
        ] {
            assert_eq!(
                state.handle(&[key(code, KeyEventKind::Press)], Instant::now(), &status()),
                []
            );
            let hint = state.notice.clone().unwrap();
            assert!(
                hint.starts_with(&format!("{name} is not bound: Space triggers")),
                "{hint}"
            );
        }
        state.update(&status());
        assert!(state.notice.is_some());
        let mut saved = status();
        saved.session.message = Some(Message {
            level: MessageLevel::Info,
            text: "initial frame saved".into(),
        });
        state.update(&saved);
        assert_eq!(state.notice, None);
        let later = Instant::now() + Duration::from_secs(2);
        assert_eq!(state.handle(&[alt('x')], later, &status()), []);
        assert!(state.notice.unwrap().starts_with("Alt-X is not bound"));
    }

    #[test]
    fn held_q_does_not_confirm_itself() {
        let (mut status, mut state) = (status(), state());
        status.session.step = Step::Label;
        let start = Instant::now();
        for (ms, _) in held('q', 0, 500, 30, 2_000) {
            let now = start + Duration::from_millis(ms);
            assert_eq!(state.handle(&typed("q"), now, &status), []);
        }
        let later = start + Duration::from_secs(3);
        assert_eq!(state.handle(&typed("q"), later, &status), [Reaction::Leave]);
    }
}
