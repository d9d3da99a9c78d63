//! Actions of the terminal keys.

use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use super::prompt::Field;
use super::state::Overlay;
use gripcast_base::files::is_unsafe_char;
use gripcast_dataset::Outcome;
use gripcast_session::Command;

/// Action of a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UiAction {
    /// Send a session command.
    Command(Command),
    /// Show or hide an overlay.
    Toggle(Overlay),
    /// Show the next choice of gel images.
    NextGelImages,
    /// Prompt for a name.
    Prompt(Field),
    /// Close the overlay, or dismiss a fault.
    Close,
    /// Quit, with confirmation if work is unfinished.
    Quit,
    /// Quit at once.
    QuitNow,
}

/// Returns whether the key is Ctrl-C, also on Cyrillic, Greek, Hebrew and Arabic layouts: terminals
/// that report key events name the letter of the layout.
pub(super) fn is_interrupt(key: &KeyEvent) -> bool {
    key.kind == KeyEventKind::Press
        && key.modifiers.contains(KeyModifiers::CONTROL)
        && matches!(
            key.code,
            KeyCode::Char('c' | 'C' | 'с' | 'С' | 'ψ' | 'Ψ' | 'ב' | 'ؤ')
        )
}

/// Returns the name of a key without an action, such as `Page Down` or `Ctrl-X`; `None` for keys
/// that are pressed together with others.
pub(super) fn unbound(key: &KeyEvent) -> Option<String> {
    use KeyCode::{CapsLock, Modifier, Null, NumLock, ScrollLock};
    if matches!(
        key.code,
        Null | CapsLock | NumLock | ScrollLock | Modifier(_)
    ) {
        return None;
    }
    let chords = [
        (KeyModifiers::CONTROL, "Ctrl-"),
        (KeyModifiers::ALT, "Alt-"),
        (KeyModifiers::SUPER, "Super-"),
    ];
    let held = chords
        .iter()
        .filter(|(chord, _)| key.modifiers.contains(*chord));
    let mut name: String = held.map(|(_, name)| *name).collect();
    match key.code {
        KeyCode::Char(c) if is_unsafe_char(c) => return None,
        KeyCode::Char(c) => name.extend(c.to_uppercase()),
        code => name += &code.to_string(),
    }
    Some(name)
}

/// Returns the action of a key press without an open prompt, ignoring case.
pub fn action(key: &KeyEvent) -> Option<UiAction> {
    if key.kind != KeyEventKind::Press {
        return None;
    }
    if is_interrupt(key) {
        return Some(UiAction::QuitNow);
    }
    let modifiers = KeyModifiers::CONTROL | KeyModifiers::ALT | KeyModifiers::SUPER;
    if key.modifiers.intersects(modifiers) {
        return None;
    }
    let command = match key.code {
        KeyCode::Esc => return Some(UiAction::Close),
        KeyCode::Char(c) => match c.to_ascii_lowercase() {
            ' ' => Command::Trigger,
            'i' => Command::Initial,
            'g' => Command::Grasp,
            's' => Command::Label(Outcome::Stable),
            'f' => Command::Label(Outcome::Slip),
            'u' => Command::Undo,
            'r' => Command::Redo,
            '!' => Command::Override,
            'o' => return Some(UiAction::Prompt(Field::Object)),
            'n' => return Some(UiAction::Prompt(Field::Scene)),
            'p' => return Some(UiAction::Prompt(Field::Operator)),
            'v' => return Some(UiAction::NextGelImages),
            'e' => return Some(UiAction::Prompt(Field::LastObject)),
            'h' => return Some(UiAction::Toggle(Overlay::Sensors)),
            '?' => return Some(UiAction::Toggle(Overlay::Help)),
            'q' => return Some(UiAction::Quit),
            _ => return None,
        },
        _ => return None,
    };
    Some(UiAction::Command(command))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(c: char) -> KeyEvent {
        KeyEvent::new(KeyCode::Char(c), KeyModifiers::NONE)
    }

    #[test]
    fn all_documented_keys_have_an_action() {
        for (c, command) in [
            (' ', Command::Trigger),
            ('i', Command::Initial),
            ('g', Command::Grasp),
            ('s', Command::Label(Outcome::Stable)),
            ('f', Command::Label(Outcome::Slip)),
            ('u', Command::Undo),
            ('r', Command::Redo),
            ('!', Command::Override),
        ] {
            assert_eq!(action(&key(c)), Some(UiAction::Command(command)), "{c:?}");
        }
        for (c, expected) in [
            ('o', UiAction::Prompt(Field::Object)),
            ('n', UiAction::Prompt(Field::Scene)),
            ('p', UiAction::Prompt(Field::Operator)),
            ('v', UiAction::NextGelImages),
            ('e', UiAction::Prompt(Field::LastObject)),
            ('h', UiAction::Toggle(Overlay::Sensors)),
            ('?', UiAction::Toggle(Overlay::Help)),
            ('q', UiAction::Quit),
        ] {
            assert_eq!(action(&key(c)), Some(expected), "{c:?}");
        }
        let escape = KeyEvent::new(KeyCode::Esc, KeyModifiers::NONE);
        assert_eq!(action(&escape), Some(UiAction::Close));
    }

    #[test]
    fn keys_work_with_caps_lock() {
        let key = KeyEvent::new(KeyCode::Char('S'), KeyModifiers::SHIFT);
        let stable = UiAction::Command(Command::Label(Outcome::Stable));
        assert_eq!(action(&key), Some(stable));
    }

    #[test]
    fn releases_repeats_and_unknown_keys_are_ignored() {
        for kind in [KeyEventKind::Release, KeyEventKind::Repeat] {
            let mut key = key(' ');
            key.kind = kind;
            assert_eq!(action(&key), None);
            assert!(!is_interrupt(&key));
        }
        assert_eq!(action(&key('x')), None);
        assert_eq!(
            action(&KeyEvent::new(KeyCode::F(5), KeyModifiers::NONE)),
            None
        );
    }

    #[test]
    fn control_c_quits_and_other_chords_are_ignored() {
        let chord = |c, modifiers| KeyEvent::new(KeyCode::Char(c), modifiers);
        let interrupt = chord('c', KeyModifiers::CONTROL);
        assert_eq!(action(&interrupt), Some(UiAction::QuitNow));
        let cyrillic = chord('с', KeyModifiers::CONTROL);
        assert_eq!(action(&cyrillic), Some(UiAction::QuitNow));
        assert_eq!(action(&chord('s', KeyModifiers::CONTROL)), None);
        assert_eq!(action(&chord('f', KeyModifiers::ALT)), None);
    }
}
