//! Legends.

use maud::{Markup, html};

use super::px;
use super::text::{Anchor, NORMAL, text, truncated, width};

/// Width of the key of an entry, px.
const KEY: f64 = 30.0;
/// Gap between name and figures, and between entries, px.
const GAP: f64 = 14.0;
/// Height of a row, px.
const ROW: f64 = 18.0;

/// Symbol of a legend entry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Key {
    /// A line of a CSS class.
    Line(String),
    /// A bar of a CSS class.
    Bar(String),
    /// A pale bar of a colour with a point on it.
    PointedBar(String),
    /// A dot of a CSS class.
    Dot(String),
    /// A vertical interval.
    Whisker,
    /// No symbol.
    None,
}

impl Key {
    /// Width in front of the name, px.
    fn width(&self) -> f64 {
        if *self == Self::None { 0.0 } else { KEY }
    }

    /// Draws the key with the centre of its left edge at the origin.
    fn draw(&self) -> Markup {
        let bar = |class: &str| html! { rect class=(class) y="-5" width="23" height="10" {} };
        let dot = |class: &str| html! { circle class=(class) cx="11.5" r="3" {} };
        match self {
            Self::Line(class) => html! { path class=(class) d="M0 0h23" {} },
            Self::Bar(class) => bar(class),
            Self::PointedBar(colour) => html! {
                (bar(&format!("pale {colour}")))
                (dot(&format!("point {colour}")))
            },
            Self::Dot(class) => dot(class),
            Self::Whisker => html! { path.whisker d="M11.5-6v12m-4 0h8m-8-12h8" {} },
            Self::None => html! {},
        }
    }
}

/// An entry of a legend.
pub struct Entry {
    /// Symbol before the name.
    pub key: Key,
    /// Name.
    pub name: String,
    /// Figures after the name; may be empty.
    pub figures: String,
}

impl Entry {
    /// Creates an entry without figures.
    pub fn new(key: Key, name: impl Into<String>) -> Self {
        Self {
            key,
            name: name.into(),
            figures: String::new(),
        }
    }
}

/// A rendered legend.
pub struct Legend {
    /// SVG content.
    pub body: Markup,
    /// Height, px.
    pub height: f64,
}

impl Legend {
    /// Lays out entries from a point downwards within a width. Entries with figures are the rows of
    /// a table, others flow like words. Names that do not fit are truncated and complete in
    /// tooltips.
    pub fn new([left, top]: [f64; 2], max_width: f64, entries: &[Entry]) -> Self {
        let has_figures = entries.iter().any(|entry| !entry.figures.is_empty());
        let layout = if has_figures {
            table(entries, max_width)
        } else {
            flow(entries, max_width)
        };
        let body = html! {
            @for (entry, position) in entries.iter().zip(&layout) {
                @let y = top + (position.row as f64 + 0.5) * ROW;
                (draw(entry, [left + position.x, y], position.name_width))
            }
        };
        let rows = layout.last().map_or(0, |last| last.row + 1);
        Self {
            body,
            height: rows as f64 * ROW,
        }
    }
}

/// Position of an entry.
struct EntryPosition {
    x: f64,
    row: usize,
    name_width: f64,
}

fn table(entries: &[Entry], max_width: f64) -> Vec<EntryPosition> {
    let widest = |text: fn(&Entry) -> &str| {
        let widths = entries.iter().map(|entry| width(text(entry), NORMAL));
        widths.fold(0.0, f64::max)
    };
    let beside = KEY + GAP + widest(|entry| &entry.figures);
    let name_width = widest(|entry| &entry.name).min(max_width - beside);
    let position = |row| EntryPosition {
        x: 0.0,
        row,
        name_width,
    };
    (0..entries.len()).map(position).collect()
}

fn flow(entries: &[Entry], max_width: f64) -> Vec<EntryPosition> {
    let (mut x, mut row) = (0.0, 0);
    let position = |entry: &Entry| {
        let name_width = width(&entry.name, NORMAL).min(max_width - entry.key.width());
        let taken = entry.key.width() + name_width;
        if x > 0.0 && x + taken > max_width {
            (x, row) = (0.0, row + 1);
        }
        let position = EntryPosition { x, row, name_width };
        x += taken + GAP;
        position
    };
    entries.iter().map(position).collect()
}

/// Draws an entry with the centre of its left edge at a point.
fn draw(entry: &Entry, [x, y]: [f64; 2], name_width: f64) -> Markup {
    let short = truncated(&entry.name, NORMAL, name_width);
    let (start, baseline) = (x + entry.key.width(), y + 0.36 * NORMAL);
    let figures = [start + name_width + GAP, baseline];
    html! {
        g {
            @if short != entry.name {
                title { (entry.name) }
            }
            @if entry.key != Key::None {
                g transform={ "translate(" (px(x)) " " (px(y)) ")" } { (entry.key.draw()) }
            }
            (text("", [start, baseline], Anchor::Start, &short))
            (text("", figures, Anchor::Start, &entry.figures))
        }
    }
}
