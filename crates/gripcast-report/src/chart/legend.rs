//! Legends.

use maud::{Markup, html};

use super::px;
use super::text::{Anchor, NORMAL, fitted, text, width};

/// Room that the key of an entry takes, px.
const KEY: f64 = 30.0;
/// Room between name and figures, and between entries, px.
const GAP: f64 = 14.0;
/// Height of a row, px.
const ROW: f64 = 18.0;

/// What stands before a name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Key {
    /// A line of a class.
    Line(String),
    /// A bar of a class.
    Bar(String),
    /// A pale bar of a colour with a point on it.
    PointedBar(String),
    /// A dot of a class.
    Dot(String),
    /// An upright interval.
    Whisker,
    /// Nothing.
    Nothing,
}

impl Key {
    /// Room that it takes before the name, px.
    fn room(&self) -> f64 {
        if *self == Self::Nothing { 0.0 } else { KEY }
    }

    /// The key with the middle of its left edge at the origin.
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
            Self::Nothing => html! {},
        }
    }
}

/// A line of the legend.
pub struct Entry {
    /// What stands before the name.
    pub key: Key,
    /// The name.
    pub name: String,
    /// Figures; empty if there are none.
    pub figures: String,
}

impl Entry {
    /// A name without figures.
    pub fn new(key: Key, name: impl Into<String>) -> Self {
        Self {
            key,
            name: name.into(),
            figures: String::new(),
        }
    }
}

/// A legend that is drawn.
pub struct Legend {
    /// The drawing.
    pub body: Markup,
    /// Its height, px.
    pub height: f64,
}

impl Legend {
    /// Places entries from a point downwards within a width. Entries with figures are the rows of a
    /// table, others follow each other like words. Names are shortened where the room ends, and
    /// complete in tooltips.
    pub fn new([left, top]: [f64; 2], room: f64, entries: &[Entry]) -> Self {
        let has_figures = entries.iter().any(|entry| !entry.figures.is_empty());
        let places = if has_figures {
            table(entries, room)
        } else {
            flow(entries, room)
        };
        let body = html! {
            @for (entry, place) in entries.iter().zip(&places) {
                @let y = top + (place.row as f64 + 0.5) * ROW;
                (draw(entry, [left + place.x, y], place.name_room))
            }
        };
        let rows = places.last().map_or(0, |last| last.row + 1);
        Self {
            body,
            height: rows as f64 * ROW,
        }
    }
}

/// Where an entry stands.
struct Place {
    x: f64,
    row: usize,
    name_room: f64,
}

fn table(entries: &[Entry], room: f64) -> Vec<Place> {
    let widest = |text: fn(&Entry) -> &str| {
        let widths = entries.iter().map(|entry| width(text(entry), NORMAL));
        widths.fold(0.0, f64::max)
    };
    let beside = KEY + GAP + widest(|entry| &entry.figures);
    let name_room = widest(|entry| &entry.name).min(room - beside);
    let place = |row| Place {
        x: 0.0,
        row,
        name_room,
    };
    (0..entries.len()).map(place).collect()
}

fn flow(entries: &[Entry], room: f64) -> Vec<Place> {
    let (mut x, mut row) = (0.0, 0);
    let place = |entry: &Entry| {
        let name_room = width(&entry.name, NORMAL).min(room - entry.key.room());
        let taken = entry.key.room() + name_room;
        if x > 0.0 && x + taken > room {
            (x, row) = (0.0, row + 1);
        }
        let place = Place { x, row, name_room };
        x += taken + GAP;
        place
    };
    entries.iter().map(place).collect()
}

/// An entry with the middle of its left edge at a point.
fn draw(entry: &Entry, [x, y]: [f64; 2], name_room: f64) -> Markup {
    let short = fitted(&entry.name, NORMAL, name_room);
    let (start, baseline) = (x + entry.key.room(), y + 0.36 * NORMAL);
    let figures = [start + name_room + GAP, baseline];
    html! {
        g {
            @if short != entry.name {
                title { (entry.name) }
            }
            @if entry.key != Key::Nothing {
                g transform={ "translate(" (px(x)) " " (px(y)) ")" } { (entry.key.draw()) }
            }
            (text("", [start, baseline], Anchor::Start, &short))
            (text("", figures, Anchor::Start, &entry.figures))
        }
    }
}
