//! One-line prompt for the name of the object, scene or operator.

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::buffer::Buffer;
use ratatui::layout::{Position, Rect};
use ratatui::text::{Line, Span};

use super::palette::Palette;
use super::text::{clipped, columns, fill, write};
use gripcast_base::error::Result;
use gripcast_base::files::{GraspId, MAX_LABEL_CHARS, is_unsafe_char};
use gripcast_dataset::NameChange;
use gripcast_session::{Command, SessionView};

/// Field edited by a prompt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Field {
    /// Object name.
    Object,
    /// Scene name.
    Scene,
    /// Operator name.
    Operator,
    /// Object of the newest grasp.
    LastObject,
}

impl Field {
    fn name(self) -> &'static str {
        match self {
            Self::Object => "object",
            Self::Scene => "scene",
            Self::Operator => "operator",
            Self::LastObject => "object of the last grasp",
        }
    }

    fn current(self, session: &SessionView) -> &str {
        match self {
            Self::Object => &session.object,
            Self::Scene => &session.scene,
            Self::Operator => &session.operator,
            Self::LastObject => session.last.as_ref().map_or("", |last| &last.object),
        }
    }

    /// `last`: the newest grasp.
    fn command(self, name: &str, last: Option<&GraspId>) -> Result<Command> {
        Ok(match (self, last) {
            (Self::Scene, _) => Command::Scene(name.parse()?),
            (Self::Operator, _) => Command::Operator(name.parse()?),
            (Self::LastObject, Some(last)) => {
                let object = Some(name.parse()?);
                let names = NameChange {
                    object,
                    ..NameChange::default()
                };
                Command::Edit(last.clone(), names)
            }
            (Self::Object | Self::LastObject, _) => Command::Object(name.parse()?),
        })
    }
}

/// Result of a key press in a prompt.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reply {
    /// The prompt stays open.
    Editing,
    /// Closed without a change.
    Cancelled,
    /// Closed with this command.
    Accepted(Command),
}

/// An open prompt.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Prompt {
    field: Field,
    /// Current value, inserted by Tab or ↑.
    current: String,
    /// The newest grasp.
    last: Option<GraspId>,
    /// Why the text is not a name.
    error: Option<String>,
    text: String,
    /// Byte position in `text`, always between characters.
    cursor: usize,
}

impl Prompt {
    /// Opens an empty prompt.
    pub fn new(field: Field, session: &SessionView) -> Self {
        Self {
            field,
            current: field.current(session).to_owned(),
            last: session.last.as_ref().map(|last| last.id.clone()),
            error: None,
            text: String::new(),
            cursor: 0,
        }
    }

    /// Returns the typed text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Handles a key: characters, arrows, Home, End, Backspace, Delete, Ctrl-U and Ctrl-W edit; Tab
    /// and ↑ insert the current value; Enter accepts; Esc cancels.
    pub fn press(&mut self, key: &KeyEvent) -> Reply {
        self.error = None;
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        match key.code {
            KeyCode::Esc => return Reply::Cancelled,
            KeyCode::Enter => return self.accepted(),
            KeyCode::Char('u') if control => {
                self.text.drain(..self.cursor);
                self.cursor = 0;
            }
            KeyCode::Char('w') if control => self.delete_word(),
            KeyCode::Char(c) if !control && !key.modifiers.contains(KeyModifiers::ALT) => {
                self.insert(c);
            }
            KeyCode::Backspace => {
                let end = self.cursor;
                self.cursor = self.before();
                self.text.drain(self.cursor..end);
            }
            KeyCode::Delete => {
                let end = self.after();
                self.text.drain(self.cursor..end);
            }
            KeyCode::Left => self.cursor = self.before(),
            KeyCode::Right => self.cursor = self.after(),
            KeyCode::Home => self.cursor = 0,
            KeyCode::End => self.cursor = self.text.len(),
            KeyCode::Tab | KeyCode::Up => {
                self.text = self.current.chars().take(MAX_LABEL_CHARS).collect();
                self.cursor = self.text.len();
            }
            _ => {}
        }
        Reply::Editing
    }

    /// Inserts pasted text as one line: runs of blanks, line breaks and control characters become a
    /// space. Returns false if the text is longer than a name can be.
    pub fn paste(&mut self, text: &str) -> bool {
        let is_blank = |c: char| c.is_whitespace() || c.is_control();
        let words: Vec<&str> = text
            .split(is_blank)
            .filter(|word| !word.is_empty())
            .collect();
        let is_inserted = |c| is_unsafe_char(c) || self.insert(c);
        words.join(" ").chars().all(is_inserted)
    }

    fn accepted(&mut self) -> Reply {
        let name = self.text.trim();
        if name.is_empty() {
            return Reply::Cancelled;
        }
        match self.field.command(name, self.last.as_ref()) {
            Ok(command) => Reply::Accepted(command),
            Err(error) => {
                self.error = Some(error.what().to_owned());
                Reply::Editing
            }
        }
    }

    /// Returns false if the character is unsafe or the name is full.
    fn insert(&mut self, character: char) -> bool {
        let fits = !is_unsafe_char(character) && self.text.chars().count() < MAX_LABEL_CHARS;
        if fits {
            self.text.insert(self.cursor, character);
            self.cursor += character.len_utf8();
        }
        fits
    }

    fn delete_word(&mut self) {
        let head = self.text[..self.cursor].trim_end();
        let start = head
            .char_indices()
            .rfind(|(_, c)| c.is_whitespace())
            .map_or(0, |(at, c)| at + c.len_utf8());
        self.text.drain(start..self.cursor);
        self.cursor = start;
    }

    fn before(&self) -> usize {
        self.text[..self.cursor]
            .char_indices()
            .next_back()
            .map_or(0, |(at, _)| at)
    }

    fn after(&self) -> usize {
        self.text[self.cursor..]
            .chars()
            .next()
            .map_or(self.cursor, |c| self.cursor + c.len_utf8())
    }
}

/// Draws the prompt into the first row of `area`; returns the cursor position.
pub(super) fn draw(
    buffer: &mut Buffer,
    area: Rect,
    prompt: &Prompt,
    palette: Palette,
) -> Option<Position> {
    if area.is_empty() {
        return None;
    }
    let style = palette.entry();
    fill(buffer, Rect { height: 1, ..area }, style);
    let label = format!(" {}: ", prompt.field.name());
    let room = usize::from(area.width.saturating_sub(columns(&label) + 1));
    let head = tail(&prompt.text[..prompt.cursor], room);
    let line = if prompt.text.is_empty() {
        let hint = match prompt.current.as_str() {
            "" => "Enter accepts, Esc cancels".to_owned(),
            current => format!("now {} (Tab edits it); Enter, Esc", clipped(current, 24)),
        };
        vec![
            Span::styled(label.clone(), style),
            Span::styled(hint, style.patch(palette.faint())),
        ]
    } else {
        let error = prompt
            .error
            .as_ref()
            .map_or_else(String::new, |e| format!("  {e}"));
        vec![
            Span::styled(label.clone(), style),
            Span::styled(head.clone(), style),
            Span::styled(&prompt.text[prompt.cursor..], style),
            Span::styled(error, style.patch(palette.faint())),
        ]
    };
    write(buffer, area, &Line::from(line));
    let x = area.x + (columns(&label) + columns(&head)).min(area.width - 1);
    Some(Position::new(x, area.y))
}

/// Returns the end of `text` that fits into `room` columns.
fn tail(text: &str, room: usize) -> String {
    let mut starts = text.char_indices().map(|(start, _)| &text[start..]);
    let fitting = starts.find(|tail| usize::from(columns(tail)) <= room);
    fitting.unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn prompt() -> Prompt {
        Prompt {
            field: Field::Object,
            current: "mug-blue".to_owned(),
            last: None,
            error: None,
            text: String::new(),
            cursor: 0,
        }
    }

    fn press(prompt: &mut Prompt, code: KeyCode) -> Reply {
        prompt.press(&KeyEvent::new(code, KeyModifiers::NONE))
    }

    fn control(prompt: &mut Prompt, c: char) {
        prompt.press(&KeyEvent::new(KeyCode::Char(c), KeyModifiers::CONTROL));
    }

    fn type_text(prompt: &mut Prompt, text: &str) {
        for c in text.chars() {
            press(prompt, KeyCode::Char(c));
        }
    }

    #[test]
    fn wide_characters_are_edited_as_a_whole() {
        let mut prompt = prompt();
        type_text(&mut prompt, "Tasse für 茶 ☕");
        press(&mut prompt, KeyCode::Backspace);
        press(&mut prompt, KeyCode::Left);
        press(&mut prompt, KeyCode::Left);
        press(&mut prompt, KeyCode::Delete);
        type_text(&mut prompt, "é");
        press(&mut prompt, KeyCode::Home);
        press(&mut prompt, KeyCode::Right);
        press(&mut prompt, KeyCode::Backspace);
        assert_eq!(prompt.text(), "asse für é ");
        assert_eq!(
            press(&mut prompt, KeyCode::Enter),
            Reply::Accepted(Command::Object("asse für é".parse().unwrap()))
        );
    }

    #[test]
    fn words_and_lines_are_deleted() {
        let mut prompt = prompt();
        type_text(&mut prompt, "große Tasse  ");
        control(&mut prompt, 'w');
        assert_eq!(prompt.text(), "große ");
        control(&mut prompt, 'u');
        assert_eq!(prompt.text(), "");
        control(&mut prompt, 'w');
        press(&mut prompt, KeyCode::Backspace);
        press(&mut prompt, KeyCode::Delete);
        press(&mut prompt, KeyCode::Left);
        press(&mut prompt, KeyCode::Right);
        assert_eq!(prompt.text(), "");
    }

    #[test]
    fn empty_input_or_escape_cancels() {
        let mut prompt = prompt();
        type_text(&mut prompt, "  ");
        assert_eq!(press(&mut prompt, KeyCode::Enter), Reply::Cancelled);
        assert_eq!(press(&mut prompt, KeyCode::Esc), Reply::Cancelled);
    }

    #[test]
    fn invalid_name_stays_open_with_its_reason() {
        let mut prompt = prompt();
        type_text(&mut prompt, "a/b");
        assert_eq!(press(&mut prompt, KeyCode::Enter), Reply::Editing);
        let error = prompt.error.clone().unwrap();
        assert!(error.contains("invalid object name"), "{error}");
        press(&mut prompt, KeyCode::Backspace);
        assert_eq!(prompt.error, None);
    }

    #[test]
    fn object_of_the_last_grasp_is_edited() {
        let last = GraspId::parse("2026-11-20T10-15-03Z-7f3a").unwrap();
        let mut prompt = Prompt {
            field: Field::LastObject,
            last: Some(last.clone()),
            ..prompt()
        };
        type_text(&mut prompt, "jar");
        let names = NameChange::parse("object jar").unwrap();
        assert_eq!(
            press(&mut prompt, KeyCode::Enter),
            Reply::Accepted(Command::Edit(last, names))
        );
    }

    #[test]
    fn tab_inserts_the_current_name() {
        let mut prompt = prompt();
        press(&mut prompt, KeyCode::Tab);
        type_text(&mut prompt, "-2");
        assert_eq!(prompt.text(), "mug-blue-2");
    }

    #[test]
    fn control_characters_and_long_names_are_rejected() {
        let mut prompt = prompt();
        type_text(&mut prompt, "a\u{7}\u{1b}b");
        control(&mut prompt, 'x');
        assert_eq!(prompt.text(), "ab");
        type_text(&mut prompt, &"ß".repeat(200));
        assert_eq!(prompt.text().chars().count(), MAX_LABEL_CHARS);
    }

    #[test]
    fn end_of_long_text_stays_visible() {
        assert_eq!(tail("abcdef", 3), "def");
        assert_eq!(tail("茶茶茶", 3), "茶");
        assert_eq!(tail("茶", 1), "");
        assert_eq!(tail("", 0), "");
    }
}
