//! Agreement by friction and force: one heat map per object and engine.

use super::Page;
use super::text::force_name;
use crate::report::{CellScore, EngineFacts, ObjectFacts, Setting};
use gripcast_report::chart::{Chart, HeatCell, HeatMap, heat_scale};
use gripcast_report::page::{Table, text};
use gripcast_report::{engine_name, trimmed};
use maud::{Markup, html};

/// Distinct frictions and forces of a set of settings, in ascending order.
pub(super) struct Grid {
    pub(super) frictions: Vec<f64>,
    pub(super) forces_n: Vec<f64>,
}

impl Grid {
    pub(super) fn new(settings: impl Iterator<Item = Setting>) -> Self {
        let (frictions, forces_n) = settings.map(|s| (s.friction, s.force_n)).unzip();
        Self {
            frictions: ascending(frictions),
            forces_n: ascending(forces_n),
        }
    }
}

fn ascending(mut values: Vec<f64>) -> Vec<f64> {
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}

pub(super) fn section(page: &Page<'_>) -> Markup {
    let objects = page.report.objects.iter();
    let columns = objects.map(|object| text(&object.name));
    let mut table = Table::new(
        "Agreement by friction and force",
        std::iter::once(text("")).chain(columns),
    )
    .class("maps");
    for engine in &page.report.engines {
        let title = html! {
            (engine_name(&engine.name))
            small { "friction up," br; (force_name(&engine.name)) " in N to the right" }
        };
        let simulated = engine.frictions.iter().flat_map(|&friction| {
            let forces = engine.forces_n.iter();
            forces.map(move |&force_n| Setting { friction, force_n })
        });
        let grid = Grid::new(simulated.chain(engine.scores.cells.iter().map(|cell| cell.setting)));
        let maps = page.report.objects.iter();
        let maps = maps.map(|object| map(engine, object, &grid).inline());
        table.row(std::iter::once(title).chain(maps));
    }
    let body = html! {
        p {
            "Fraction and number of grasps that agree with " (page.reality()) " at every setting. Solid \
             frame: the paper’s choice for the object. Dashed frame: the one setting for all \
             objects. Crossed out: not simulated, or without outcome."
        }
        (heat_scale())
        (table)
    };
    page.section("settings", "Agreement by friction and force", body)
}

fn map(engine: &EngineFacts, object: &ObjectFacts, grid: &Grid) -> Chart {
    let find = |setting: Setting| {
        let mut cells = engine.scores.cells.iter();
        cells.find(|cell| cell.object == object.name && cell.setting == setting)
    };
    let rows: Vec<f64> = grid.frictions.iter().rev().copied().collect();
    let map = HeatMap {
        title: format!("{}, {}", object.name, engine_name(&engine.name)),
        description: description(grid, find),
        rows: &rows.iter().map(|v| trimmed(*v, 3)).collect::<Vec<_>>(),
        columns: &grid
            .forces_n
            .iter()
            .map(|v| trimmed(*v, 2))
            .collect::<Vec<_>>(),
    };
    let scores = &engine.scores;
    map.chart(|row, column| {
        let setting = Setting {
            friction: rows[row],
            force_n: grid.forces_n[column],
        };
        let is_paper = setting.friction == scores.friction
            && scores.force_n.get(&object.name) == Some(&setting.force_n);
        let score = find(setting).filter(|score| score.n > 0);
        HeatCell {
            fraction: score.map(|score| score.agree as f64 / score.n as f64),
            note: score.map_or_else(String::new, |s| format!("{} of {}", s.agree, s.n)),
            frame: match (is_paper, setting == scores.best_setting) {
                (true, _) => Some("chosen"),
                (false, true) => Some("one"),
                (false, false) => None,
            },
        }
    })
}

fn description<'a>(grid: &Grid, find: impl Fn(Setting) -> Option<&'a CellScore>) -> String {
    let mut text = "Grasps that agree:".to_owned();
    for &friction in &grid.frictions {
        for &force_n in &grid.forces_n {
            let counts = match find(Setting { friction, force_n }) {
                None => "not simulated".to_owned(),
                Some(s) if s.without_outcome > 0 => format!(
                    "{} of {} and {} without outcome",
                    s.agree, s.n, s.without_outcome
                ),
                Some(s) => format!("{} of {}", s.agree, s.n),
            };
            let [friction, force] = [trimmed(friction, 3), trimmed(force_n, 2)];
            text.push_str(&format!(" friction {friction}, {force} N: {counts};"));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_value_once_in_order() {
        let settings = [(0.4, 20.0), (0.2, 20.0), (0.4, 5.0), (f64::NAN, 5.0)];
        let grid = Grid::new(
            settings
                .into_iter()
                .map(|(friction, force_n)| Setting { friction, force_n }),
        );
        assert_eq!(grid.frictions, [0.2, 0.4]);
        assert_eq!(grid.forces_n, [5.0, 20.0]);
    }
}
