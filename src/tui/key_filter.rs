//! Separates presses of keys from what terminals send besides them: repeats of held keys, pasted
//! text, answers of the terminal.
//!
//! A terminal with the kitty keyboard protocol says which events are repeats. Others send the
//! character again: first after the keyboard's repeat delay, then at its repeat rate. An event is
//! a repeat if it follows an event of the same key within [`REPEAT_INTERVAL`]. An event that may
//! be the first repeat waits for [`REPEAT_INTERVAL`]: if another one follows, the key is held.

use std::time::{Duration, Instant};

use crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// Interval after an event of a key within which its next event is a repeat; keyboards repeat at
/// 10 to 40 events per second.
const REPEAT_INTERVAL: Duration = Duration::from_millis(150);
/// Maximum delay of a keyboard between a press and its first repeat (250–660 ms by default).
const MAX_REPEAT_DELAY: Duration = Duration::from_secs(1);
/// Maximum characters that arrive at once and still are keys; more are text.
const MAX_KEYS_AT_ONCE: usize = 4;

/// What an event of a key is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Judged {
    /// A press.
    Press,
    /// Not a press: a repeat, a release, text or part of a terminal's answer.
    Nothing,
    /// Part of a text that arrives at once, without bracketed paste.
    Text,
}

/// Judges the events of a terminal's keys. Times are given by the caller.
#[derive(Clone, Debug, Default)]
pub(super) struct KeyFilter {
    /// Time of the last event of each recent key.
    recent: Vec<(KeyCode, Instant)>,
    /// Last press, until its first repeat or another key.
    newest: Option<(KeyCode, Instant)>,
    /// Press that may be the first repeat of a held key, and its time.
    waiting: Option<(KeyEvent, Instant)>,
    /// Whether the terminal distinguishes presses, repeats and releases.
    has_kinds: bool,
    /// Whether the events up to the end of the answer or batch are an answer of the terminal.
    in_answer: bool,
    /// End of the text that arrives at once.
    text_until: Option<Instant>,
}

impl KeyFilter {
    /// Starts a batch: the events that were read at once.
    pub(super) fn start_batch(&mut self) {
        self.in_answer = false;
    }

    /// Returns the waiting press if it is due at `now` or if `next`, an event of another key,
    /// follows it.
    pub(super) fn take_waiting(
        &mut self,
        now: Instant,
        next: Option<&KeyEvent>,
    ) -> Option<KeyEvent> {
        let (key, since) = self.waiting?;
        let is_over = match next {
            Some(next) => next.code != key.code && next.kind != KeyEventKind::Release,
            None => now.saturating_duration_since(since) >= REPEAT_INTERVAL,
        };
        if !is_over {
            return None;
        }
        self.waiting = None;
        self.newest = Some((key.code, since));
        Some(key)
    }

    /// Judges `key`, read at `now`; `rest` are the events of the batch from `key` on.
    pub(super) fn judge(&mut self, key: &KeyEvent, rest: &[Event], now: Instant) -> Judged {
        if self.is_answer(key) {
            return Judged::Nothing;
        }
        if key.kind == KeyEventKind::Release {
            self.has_kinds = true;
            return Judged::Nothing;
        }
        if self.is_text(rest, now) {
            return Judged::Text;
        }
        self.judge_press(key, now)
    }

    /// Judges a key that is typed into a prompt, where repeats count: only answers of the terminal
    /// and releases are nothing.
    pub(super) fn judge_typed(&mut self, key: &KeyEvent, now: Instant) -> Judged {
        if self.is_answer(key) || key.kind == KeyEventKind::Release {
            return Judged::Nothing;
        }
        // Enter and Esc, held, must not be commands after the prompt has closed.
        self.judge_press(key, now);
        self.waiting = None;
        Judged::Press
    }

    fn judge_press(&mut self, key: &KeyEvent, now: Instant) -> Judged {
        let elapsed = |since: Instant| now.saturating_duration_since(since);
        let last = self.recent.iter().find(|(code, _)| *code == key.code);
        let is_repeat = last.is_some_and(|(_, at)| elapsed(*at) < REPEAT_INTERVAL);
        self.recent
            .retain(|(code, at)| *code != key.code && elapsed(*at) < REPEAT_INTERVAL);
        self.recent.push((key.code, now));
        self.has_kinds |= key.kind == KeyEventKind::Repeat;
        if is_repeat || key.kind == KeyEventKind::Repeat {
            self.waiting = None;
            self.newest = None;
            return Judged::Nothing;
        }
        let may_be_repeat = !self.has_kinds
            && self
                .newest
                .is_some_and(|(code, at)| code == key.code && elapsed(at) <= MAX_REPEAT_DELAY);
        if may_be_repeat {
            self.waiting = Some((*key, now));
            return Judged::Nothing;
        }
        self.newest = Some((key.code, now));
        Judged::Press
    }

    /// Returns whether `key` belongs to an answer of the terminal that was not recognised: a
    /// control string (APC, DCS, OSC, PM, SOS), whose characters would be commands.
    fn is_answer(&mut self, key: &KeyEvent) -> bool {
        let is_alt = key.modifiers.contains(KeyModifiers::ALT);
        let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
        match key.code {
            KeyCode::Char('\\') if is_alt => std::mem::take(&mut self.in_answer),
            KeyCode::Char('g') if is_control => std::mem::take(&mut self.in_answer),
            KeyCode::Char('_' | 'P' | ']' | '^' | 'X') if is_alt => {
                self.in_answer = true;
                true
            }
            _ => self.in_answer,
        }
    }

    /// Returns whether `events`, the rest of a batch, are text: more characters than a person
    /// types at once. Runs of one character are one key, which may be held.
    fn is_text(&mut self, events: &[Event], now: Instant) -> bool {
        let mut characters: Vec<KeyCode> = events.iter().filter_map(character).collect();
        characters.dedup();
        let continues = self.text_until.is_some_and(|until| now < until);
        if continues || characters.len() > MAX_KEYS_AT_ONCE {
            self.text_until = Some(now + REPEAT_INTERVAL);
            return true;
        }
        false
    }
}

fn character(event: &Event) -> Option<KeyCode> {
    let key = event.as_key_press_event()?;
    let chords = KeyModifiers::CONTROL | KeyModifiers::ALT;
    let is_character = matches!(key.code, KeyCode::Char(_)) && !key.modifiers.intersects(chords);
    is_character.then_some(key.code)
}
