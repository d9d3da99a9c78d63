//! Keys of the operator's screen, as plain data.

/// A key of a terminal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// A key that types this character.
    Char(char),
    /// Enter.
    Enter,
}

impl Key {
    /// Name on the help line.
    pub fn label(self) -> String {
        match self {
            Self::Char(' ') => "space".to_owned(),
            Self::Char(character) => character.to_string(),
            Self::Enter => "enter".to_owned(),
        }
    }
}

/// What a key does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeyBinding {
    /// The key.
    pub key: Key,
    /// Text of the command.
    pub command: &'static str,
    /// A few words for the help line.
    pub help: &'static str,
}

const fn bind(character: char, command: &'static str, help: &'static str) -> KeyBinding {
    KeyBinding {
        key: Key::Char(character),
        command,
        help,
    }
}

/// Keys that give a command at once, in the order of the help line. Keys that ask for a name
/// first (object, scene, operator) belong to the screen.
pub const KEY_BINDINGS: &[KeyBinding] = &[
    bind(' ', "trigger", "capture the next step"),
    bind('i', "initial", "take the initial frame again"),
    bind('g', "grasp", "take the grasp frame"),
    bind('s', "stable", "it held"),
    bind('f', "slip", "it slipped or fell"),
    bind('u', "undo", "take back the last step"),
    bind('r', "redo", "do it again"),
    bind('!', "override", "capture although a guard refused"),
    bind('q', "quit", "end the session"),
];

/// Command of a key; capital letters count as small ones (caps lock).
pub fn command_for_key(key: Key) -> Option<&'static str> {
    let key = match key {
        Key::Char(character) => Key::Char(character.to_ascii_lowercase()),
        other => other,
    };
    KEY_BINDINGS
        .iter()
        .find(|binding| binding.key == key)
        .map(|binding| binding.command)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_give_their_commands() {
        assert_eq!(command_for_key(Key::Char(' ')), Some("trigger"));
        assert_eq!(command_for_key(Key::Char('S')), Some("stable"));
        assert_eq!(command_for_key(Key::Char('!')), Some("override"));
        assert_eq!(command_for_key(Key::Char('x')), None);
        assert_eq!(command_for_key(Key::Enter), None);
    }

    #[test]
    fn no_key_is_bound_twice() {
        for (n, binding) in KEY_BINDINGS.iter().enumerate() {
            assert!(
                KEY_BINDINGS[..n]
                    .iter()
                    .all(|other| other.key != binding.key),
                "{}",
                binding.key.label()
            );
        }
    }
}
