//! Agreement over friction and force, one map per object and engine.

use std::fmt::Write as _;

use super::grid::Grid;
use super::text::{Esc, MISSING, engine_name, fixed, force_name, trimmed};
use super::{Page, open_wide, put};
use crate::report::{CellScore, EngineFacts, ObjectFacts, Setting};

const CELL: [f64; 2] = [46.0, 32.0];
const LEFT: f64 = 30.0;
const LIGHT: [f64; 3] = [240.0, 243.0, 246.0];
const DARK: [f64; 3] = [8.0, 64.0, 116.0];

pub(super) fn section(page: &Page<'_>, out: &mut String) {
    page.open_section(out, "settings", "Agreement over friction and force");
    put!(
        out,
        "<p>Share of grasps that agree with {}, and their number, at every setting. Solid frame: \
         the paper’s choice for the object. Dashed frame: the one setting for all objects. \
         Hatched: not tried, or no case with an outcome.</p>\n",
        page.reality()
    );
    legend(out);
    open_wide(out, "Agreement over friction and force");
    out.push_str("<table class=\"maps\"><thead><tr><td></td>");
    for object in &page.report.objects {
        put!(out, "<th scope=\"col\">{}</th>", Esc(&object.name));
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    for engine in &page.report.engines {
        put!(
            out,
            "<tr><th scope=\"row\">{}<small>friction up,<br>{} in N to the right</small></th>",
            Esc(engine_name(&engine.name)),
            force_name(&engine.name)
        );
        let grid = grid(engine);
        for object in &page.report.objects {
            out.push_str("<td>");
            map(out, engine, object, &grid);
            out.push_str("</td>");
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n</section>\n");
}

fn grid(engine: &EngineFacts) -> Grid {
    let tried = engine.frictions.iter().flat_map(|&friction| {
        let forces = engine.forces_n.iter();
        forces.map(move |&force_n| Setting { friction, force_n })
    });
    Grid::of(tried.chain(engine.scores.cells.iter().map(|cell| cell.setting)))
}

fn legend(out: &mut String) {
    out.push_str("<p class=\"scale\" aria-hidden=\"true\">");
    for share in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let colour = Shade::of(share);
        put!(
            out,
            "<span style=\"background:{};color:{}\">{share:.2}</span>",
            colour.fill,
            colour.text
        );
    }
    out.push_str("</p>\n");
}

fn map(out: &mut String, engine: &EngineFacts, object: &ObjectFacts, grid: &Grid) {
    let columns = grid.forces_n.len() as f64;
    let rows = grid.frictions.len() as f64;
    let (width, height) = (LEFT + CELL[0] * columns + 3.0, CELL[1] * rows + 18.0);
    put!(
        out,
        "<svg class=\"map\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" role=\"img\" aria-label=\"{}\">",
        Esc(&in_words(engine, object, grid))
    );
    let mut frames = String::new();
    for (row, &friction) in grid.frictions.iter().rev().enumerate() {
        let y = 2.0 + CELL[1] * row as f64;
        put!(
            out,
            "<text class=\"hy\" x=\"{:.0}\" y=\"{:.0}\">{}</text>",
            LEFT - 5.0,
            y + 0.5 * CELL[1] + 4.0,
            trimmed(friction, 3)
        );
        for (column, &force_n) in grid.forces_n.iter().enumerate() {
            let x = LEFT + CELL[0] * column as f64;
            let setting = Setting { friction, force_n };
            cell(out, [x, y], find(engine, object, setting));
            frame(&mut frames, [x, y], engine, object, setting);
        }
    }
    for (column, &force_n) in grid.forces_n.iter().enumerate() {
        put!(
            out,
            "<text class=\"hx\" x=\"{:.0}\" y=\"{:.0}\">{}</text>",
            LEFT + CELL[0] * (column as f64 + 0.5),
            height - 3.0,
            trimmed(force_n, 2)
        );
    }
    out.push_str(&frames);
    out.push_str("</svg>");
}

fn find<'a>(
    engine: &'a EngineFacts,
    object: &ObjectFacts,
    setting: Setting,
) -> Option<&'a CellScore> {
    let mut cells = engine.scores.cells.iter();
    cells.find(|cell| cell.object == object.name && cell.setting == setting)
}

fn cell(out: &mut String, [x, y]: [f64; 2], score: Option<&CellScore>) {
    let (width, height) = (CELL[0] - 2.0, CELL[1] - 2.0);
    let middle = x + 0.5 * width;
    match score.filter(|score| score.n > 0) {
        Some(score) => {
            let share = score.agree as f64 / score.n as f64;
            let shade = Shade::of(share);
            put!(
                out,
                "<g class=\"cell\" fill=\"{}\"><rect x=\"{x}\" y=\"{y}\" width=\"{width}\" \
                 height=\"{height}\" fill=\"{}\"/><text x=\"{middle}\" y=\"{:.0}\">{}</text>\
                 <text class=\"of\" x=\"{middle}\" y=\"{:.0}\">{} of {}</text></g>",
                shade.text,
                shade.fill,
                y + 14.0,
                fixed(share, 2),
                y + 25.0,
                score.agree,
                score.n
            );
        }
        None => put!(
            out,
            "<g class=\"cell\"><rect class=\"empty\" x=\"{x}\" y=\"{y}\" width=\"{width}\" \
             height=\"{height}\" fill=\"url(#hatch)\"/><text class=\"gap\" x=\"{middle}\" \
             y=\"{:.0}\">{MISSING}</text></g>",
            y + 19.0
        ),
    }
}

fn frame(
    out: &mut String,
    [x, y]: [f64; 2],
    engine: &EngineFacts,
    object: &ObjectFacts,
    setting: Setting,
) {
    let scores = &engine.scores;
    let is_paper = setting.friction == scores.friction
        && scores.force_n.get(&object.name) == Some(&setting.force_n);
    let class = match (is_paper, setting == scores.one) {
        (true, _) => "chosen",
        (false, true) => "one",
        (false, false) => return,
    };
    put!(
        out,
        "<rect class=\"{class}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/>",
        x - 1.0,
        y - 1.0,
        CELL[0],
        CELL[1]
    );
}

fn in_words(engine: &EngineFacts, object: &ObjectFacts, grid: &Grid) -> String {
    let mut words = format!(
        "{}, {}, grasps that agree:",
        object.name,
        engine_name(&engine.name)
    );
    for &friction in &grid.frictions {
        for &force_n in &grid.forces_n {
            let setting = Setting { friction, force_n };
            put!(
                words,
                " friction {}, {} N:",
                trimmed(friction, 3),
                trimmed(force_n, 2)
            );
            match find(engine, object, setting) {
                Some(score) => put!(words, " {} of {}", score.agree, score.n),
                None => words.push_str(" not tried"),
            }
            if let Some(score) = find(engine, object, setting)
                && score.without_outcome > 0
            {
                put!(words, " and {} without outcome", score.without_outcome);
            }
            words.push(';');
        }
    }
    words
}

/// Colour of a cell and of the text on it; the same in light and dark.
struct Shade {
    fill: String,
    text: &'static str,
}

impl Shade {
    fn of(share: f64) -> Self {
        // Most shares are above a half: the square spreads them.
        let t = share.clamp(0.0, 1.0).powi(2);
        let mix = |i: usize| (LIGHT[i] + t * (DARK[i] - LIGHT[i])).round() as u8;
        let [r, g, b] = [mix(0), mix(1), mix(2)];
        Self {
            fill: format!("#{r:02x}{g:02x}{b:02x}"),
            text: if luminance([r, g, b]) > 0.18 {
                "#14181d"
            } else {
                "#ffffff"
            },
        }
    }
}

/// Relative luminance (WCAG 2).
fn luminance(rgb: [u8; 3]) -> f64 {
    let linear = rgb.map(|v| {
        let v = f64::from(v) / 255.0;
        if v <= 0.040_45 {
            v / 12.92
        } else {
            ((v + 0.055) / 1.055).powf(2.4)
        }
    });
    0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_can_be_read_on_every_shade() {
        for i in 0..=20 {
            let shade = Shade::of(f64::from(i) / 20.0);
            let of = |hex: &str| {
                let byte = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();
                luminance([byte(1), byte(3), byte(5)]) + 0.05
            };
            let (a, b) = (of(&shade.fill), of(shade.text));
            assert!(a.max(b) / a.min(b) >= 4.3, "{}", shade.fill);
        }
    }
}
