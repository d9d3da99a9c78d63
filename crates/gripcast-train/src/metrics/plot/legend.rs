//! The legend below a figure.

use std::fmt::Write as _;

use super::figure::{colour, line};
use super::text::{Anchor, NORMAL, fitted, label, width};
use gripcast_report::{Esc, put};

/// Room that the key of an entry takes, px.
const KEY: f64 = 30.0;
/// Room between name and figures, and between entries, px.
const GAP: f64 = 14.0;
/// Height of a row, px.
const ROW: f64 = 18.0;

/// What stands before a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Key {
    /// The line of a series.
    Line(usize),
    /// The bar of a series.
    Bar(usize),
    /// A pale bar of a series with a point.
    PointedBar(usize),
    /// A dashed line.
    Guide,
    /// An error bar.
    Whisker,
    /// The dot of a seed.
    Seed,
    /// Nothing.
    Nothing,
}

impl Key {
    /// Room that it takes before the name, px.
    fn room(self) -> f64 {
        if self == Self::Nothing { 0.0 } else { KEY }
    }
}

/// A line of the legend.
pub(super) struct Entry {
    pub(super) key: Key,
    pub(super) name: String,
    /// Figures; empty if there are none.
    pub(super) figures: String,
}

impl Entry {
    pub(super) fn new(key: Key, name: impl Into<String>) -> Self {
        Self {
            key,
            name: name.into(),
            figures: String::new(),
        }
    }
}

/// Draws entries from a point downwards within a width; returns the height, px. Entries with figures
/// are the rows of a table, others follow each other like words.
pub(super) fn draw(out: &mut String, [left, top]: [f64; 2], room: f64, entries: &[Entry]) -> f64 {
    let has_figures = entries.iter().any(|entry| !entry.figures.is_empty());
    let places = if has_figures {
        table(entries, room)
    } else {
        flow(entries, room)
    };
    for (entry, place) in entries.iter().zip(&places) {
        let [x, y] = [left + place.x, top + (place.row as f64 + 0.5) * ROW];
        draw_entry(out, entry, [x, y], place.name_room);
    }
    places
        .last()
        .map_or(0.0, |last| (last.row + 1) as f64 * ROW)
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
fn draw_entry(out: &mut String, entry: &Entry, [x, y]: [f64; 2], name_room: f64) {
    put!(out, "<g>");
    let short = fitted(&entry.name, NORMAL, name_room);
    if short != entry.name {
        put!(out, "<title>{}</title>", Esc(&entry.name));
    }
    draw_key(out, entry.key, [x, y]);
    let (start, baseline) = (x + entry.key.room(), y + 0.36 * NORMAL);
    label(out, [start, baseline], Anchor::Start, &short);
    if !entry.figures.is_empty() {
        let at = [start + name_room + GAP, baseline];
        label(out, at, Anchor::Start, &entry.figures);
    }
    put!(out, "</g>");
}

/// A key with the middle of its left edge at a point.
fn draw_key(out: &mut String, key: Key, [x, y]: [f64; 2]) {
    match key {
        Key::Line(series) => {
            put!(
                out,
                "<path class=\"{}\" d=\"M{x:.1} {y:.1}h23\"/>",
                line(series)
            );
        }
        Key::Guide => put!(out, "<path class=\"guide\" d=\"M{x:.1} {y:.1}h23\"/>"),
        Key::Bar(series) => put!(
            out,
            "<rect class=\"bar {}\" x=\"{x:.1}\" y=\"{:.1}\" width=\"23\" height=\"10\"/>",
            colour(series),
            y - 5.0
        ),
        Key::PointedBar(series) => put!(
            out,
            "<g class=\"{}\"><rect class=\"pale\" x=\"{x:.1}\" y=\"{:.1}\" width=\"23\" \
             height=\"10\"/><circle class=\"point\" cx=\"{:.1}\" cy=\"{y:.1}\" r=\"4\"/></g>",
            colour(series),
            y - 5.0,
            x + 11.5
        ),
        Key::Whisker => put!(
            out,
            "<path class=\"whisker\" d=\"M{:.1} {:.1}v12m-4 0h8m-8-12h8\"/>",
            x + 11.5,
            y - 6.0
        ),
        Key::Seed => put!(
            out,
            "<circle class=\"seed\" cx=\"{:.1}\" cy=\"{y:.1}\" r=\"2.6\"/>",
            x + 11.5
        ),
        Key::Nothing => {}
    }
}
