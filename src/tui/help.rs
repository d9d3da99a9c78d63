//! The key overview.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

use super::palette::Palette;
use super::text::{fill, row, write};

const KEYS: [(&str, &str); 15] = [
    ("space, pedal", "next step: initial frame, then grasp frame"),
    ("i", "take the initial frame (again)"),
    ("g", "take the grasp frame"),
    ("s", "it held: label the last grasp stable"),
    ("f", "it slipped or fell: label it slip"),
    ("u", "undo the last step (again for more)"),
    ("r", "redo what was undone"),
    ("!", "take it anyway after a refusal; recorded"),
    ("o", "name of the object"),
    ("n", "name of the scene"),
    ("p", "name of the operator"),
    ("h", "sensors in detail"),
    ("Esc", "close a panel, shrink the fault screen"),
    ("q", "quit; asks if something is not finished"),
    ("Ctrl-C", "quit at once; all saved grasps are safe"),
];

const WIDTH: u16 = 62;
const TITLE: &str = " Keys — any of them works while this is open; ? closes ";

/// Draws the overview in the middle of `area`.
pub(super) fn draw(buffer: &mut Buffer, area: Rect, palette: Palette) {
    let width = WIDTH.min(area.width);
    let height = (KEYS.len() as u16 + 3).min(area.height);
    let panel = Rect::new(
        area.x + (area.width - width) / 2,
        area.y + (area.height - height) / 2,
        width,
        height,
    );
    fill(buffer, panel, palette.panel());
    write(buffer, panel, &Line::styled(TITLE, palette.entry()));
    // The blank lines go first when the screen is low.
    let top = u16::from(usize::from(height) > KEYS.len() + 1) + 1;
    for (index, (key, meaning)) in (top..).zip(KEYS) {
        let line = Line::from(vec![
            Span::styled(format!(" {key:>12}"), palette.key()),
            Span::raw(format!("  {meaning}")),
        ]);
        write(buffer, row(panel, index), &line);
    }
}
