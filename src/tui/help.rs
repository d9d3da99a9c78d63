//! The key overview.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

use super::palette::Palette;
use super::text::{fill, row, write};

const KEYS: [(&str, &str); 17] = [
    ("space, pedal", "next step: initial frame, then grasp frame"),
    ("i", "take the initial frame (again)"),
    ("g", "take the grasp frame"),
    ("s", "label the last grasp stable"),
    ("f", "label the last grasp slip (slipped or fell)"),
    ("u", "undo the last step (again for more)"),
    ("r", "redo what was undone"),
    ("!", "override a refusal; recorded with the grasp"),
    ("o", "set the object name"),
    ("e", "correct the object of the last grasp"),
    ("n", "set the scene name"),
    ("p", "set the operator name"),
    ("v", "gels: image and difference, image, difference"),
    ("h", "sensors in detail"),
    ("Esc", "close a panel, minimise the fault screen"),
    ("q", "quit; asks if work is unfinished"),
    ("Ctrl-C", "quit at once; all saved grasps are safe"),
];

const WIDTH: u16 = 62;
const TITLE: &str = " Keys — all of them work while this is open; ? closes ";

/// Draws the overview centred in `area`.
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
    // Low screens omit the blank lines.
    let top = u16::from(usize::from(height) > KEYS.len() + 1) + 1;
    for (index, (key, meaning)) in (top..).zip(KEYS) {
        let line = Line::from(vec![
            Span::styled(format!(" {key:>12}"), palette.key()),
            Span::raw(format!("  {meaning}")),
        ]);
        write(buffer, row(panel, index), &line);
    }
}
