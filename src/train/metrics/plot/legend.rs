//! The legend below a figure.

use std::fmt::Write as _;

use super::figure::{colour, line};
use super::text::{Anchor, NORMAL, fitted, label, width};
use crate::html::{Esc, put};

/// Room that the key of an entry takes, px.
const KEY: f64 = 30.0;
/// Room between name and figure, and between columns, px.
const GAP: f64 = 12.0;
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

/// Draws entries in as many equal columns as fit into a width, from a point downwards; returns the
/// height, px.
pub(super) fn draw(out: &mut String, [left, top]: [f64; 2], room: f64, entries: &[Entry]) -> f64 {
    let widest = |text: fn(&Entry) -> &str| {
        let widths = entries.iter().map(|entry| width(text(entry), NORMAL));
        widths.fold(0.0, f64::max)
    };
    let figures = widest(|entry| &entry.figures);
    let beside = if figures > 0.0 { GAP + figures } else { 0.0 };
    let name = widest(|entry| &entry.name).min(room - KEY - beside);
    let column = KEY + name + beside + GAP;
    let columns = (((room + GAP) / column) as usize).max(1);
    for (i, entry) in entries.iter().enumerate() {
        let x = left + (i % columns) as f64 * column;
        let y = top + (i / columns) as f64 * ROW + 0.5 * ROW;
        put!(out, "<g>");
        draw_key(out, entry.key, [x, y]);
        let short = fitted(&entry.name, NORMAL, name);
        if short != entry.name {
            put!(out, "<title>{}</title>", Esc(&entry.name));
        }
        let start = if entry.key == Key::Nothing { 0.0 } else { KEY };
        let baseline = y + 0.36 * NORMAL;
        label(out, [x + start, baseline], Anchor::Start, &short);
        if !entry.figures.is_empty() {
            let at = [x + KEY + name + GAP, baseline];
            label(out, at, Anchor::Start, &entry.figures);
        }
        put!(out, "</g>");
    }
    entries.len().div_ceil(columns) as f64 * ROW
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
