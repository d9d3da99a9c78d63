//! Charts of forces and heights over time, as in the paper's Figure 1.

use gripcast_report::chart::{
    Anchor, Axis, Chart, Entry, Key, Legend, Panel, SMALL, extent, text, upright, width,
};
use gripcast_report::{engine_name, outcome_name, trimmed};
use gripcast_sim::grasp::{GraspSummary, StageName, Trace, TraceStep};
use maud::{Markup, html};

use super::report::GraspReplay;

/// Height of the legend above a panel, px.
const LEGEND: f64 = 20.0;
/// Height of the title, px.
const TITLE: f64 = 28.0;
const LEFT: &str = "curve series-0";
const RIGHT: &str = "curve series-1 dash-1";
const OBJECT: &str = "curve series-2";
const GRIPPER: &str = "curve series-5 dash-1";

/// Renders the chart of a replayed grasp; none if no forces were recorded.
pub(super) fn inline(replay: &GraspReplay, id: &str) -> Option<Markup> {
    let curves = replay.curves.as_ref()?;
    let time = extent(curves.t_s.iter().copied())?;
    let stop = replay.chosen.force_n;
    let name = match replay.engine.as_str() {
        "fem" => "F_stop",
        _ => "closing force",
    };
    let [adjustment, lift] = curves.stages_s;
    let mm = |metres: &[f64]| -> Vec<f64> { metres.iter().map(|z| 1e3 * z).collect() };
    let chart = GraspChart {
        title: format!("Grasp {id}, {}", engine_name(&replay.engine)),
        has_title: false,
        size: [560.0, 150.0, 76.0],
        time_range: time,
        time_s: curves.t_s.clone(),
        forces_n: [curves.left_n.clone(), curves.right_n.clone()],
        names: ["left", "right"],
        stop: (format!("{name} {} N", trimmed(stop, 2)), stop),
        height_label: "height, mm",
        object_mm: mm(&curves.min_height_m),
        object_name: "lowest point",
        gripper_mm: mm(&curves.lifted_m),
        success_mm: 1e3 * curves.success_height_m,
        stages: vec![
            ("closure", adjustment),
            ("adjustment", lift.max(adjustment)),
            ("lift", time[1]),
        ],
    };
    Some(chart.draw().inline())
}

/// Renders the chart of a simulated grasp as an SVG file: the force of each gel over time with
/// F_stop and the stages, and below it the rise of object and gripper. `title` names the object.
pub fn plot(trace: &Trace, summary: &GraspSummary, success_height_m: f64, title: &str) -> String {
    let steps = || trace.steps.iter();
    let height = |step: &TraceStep| step.t_world_object.translation_m.z;
    let start = trace.steps.first().map_or(0.0, height);
    let stages = [
        (StageName::Closure, "closure"),
        (StageName::Adjustment, "adjustment"),
        (StageName::Lift, "lift"),
    ];
    let stages = stages.into_iter().filter_map(|(stage, name)| {
        let last = trace.stage(stage).next_back()?;
        Some((name, last.t_s))
    });
    let chart = GraspChart {
        title: format!("{title}: {}", result_text(summary)),
        has_title: true,
        size: [880.0, 278.0, 122.0],
        time_range: [0.0, trace.steps.last().map_or(1.0, |step| step.t_s)],
        time_s: steps().map(|step| step.t_s).collect(),
        forces_n: [0, 1].map(|gel| steps().map(|step| step.force[gel].normal_n).collect()),
        names: ["left gel", "right gel"],
        stop: (
            format!("F_stop {} N", summary.stop_force_n),
            summary.stop_force_n,
        ),
        height_label: "rise, mm",
        object_mm: steps().map(|step| 1e3 * (height(step) - start)).collect(),
        object_name: "object",
        gripper_mm: steps().map(|step| 1e3 * step.lifted_m).collect(),
        success_mm: 1e3 * success_height_m,
        stages: stages.collect(),
    };
    chart.draw().to_svg()
}

fn result_text(summary: &GraspSummary) -> String {
    let outcome = outcome_name(summary.outcome.name());
    match (summary.mean_force_n, summary.std_force_n) {
        (Some(mean), Some(std)) => format!(
            "{outcome}, lifted {:.1} mm, {mean:.1} ± {std:.1} N at the end of the adjustment",
            1e3 * summary.lifted_m
        ),
        _ => outcome.to_owned(),
    }
}

/// Contents of a chart.
struct GraspChart {
    title: String,
    has_title: bool,
    /// Width of the chart, and heights of the force panel and the height panel, px.
    size: [f64; 3],
    time_range: [f64; 2],
    time_s: Vec<f64>,
    forces_n: [Vec<f64>; 2],
    /// Names of the forces.
    names: [&'static str; 2],
    /// Name and value of the stopping force.
    stop: (String, f64),
    /// Label of the height ordinate.
    height_label: &'static str,
    object_mm: Vec<f64>,
    object_name: &'static str,
    gripper_mm: Vec<f64>,
    /// Minimum height of a stable grasp.
    success_mm: f64,
    /// Name and end of each stage.
    stages: Vec<(&'static str, f64)>,
}

impl GraspChart {
    fn draw(self) -> Chart {
        let [width, force_height, rise_height] = self.size;
        let top = if self.has_title { TITLE } else { 0.0 };
        let forces = self.forces_n.iter().flatten().copied();
        let force_range = range(forces.chain([self.stop.1]), 1.2);
        let mm = || self.object_mm.iter().chain(&self.gripper_mm).copied();
        let force = Panel {
            left: 56.0,
            right: width - 14.0,
            top: top + LEGEND,
            bottom: top + LEGEND + force_height,
            x: Axis::new("time, s", self.time_range, 8.0),
            y: Axis::new("force, N", force_range, 5.0),
        };
        let rise = Panel {
            top: force.bottom + LEGEND + 6.0,
            bottom: force.bottom + LEGEND + 6.0 + rise_height,
            x: force.x.clone(),
            y: Axis::new(
                self.height_label,
                range(mm().chain([self.success_mm]), 1.1),
                3.0,
            ),
            ..force
        };
        let force = Panel {
            x: force.x.without_labels(),
            ..force
        };
        let success = format!("success above {} mm", trimmed(self.success_mm, 1));
        let [left, right] = &self.forces_n;
        let body = html! {
            @if self.has_title {
                (text("", [force.left, 20.0], Anchor::Start, &self.title))
            }
            (self.panel(&force, self.stop.1, [(RIGHT, right), (LEFT, left)]))
            (self.stage_names(&force))
            (legend(&force, [
                (LEFT, self.names[0]),
                (RIGHT, self.names[1]),
                ("guide", &self.stop.0),
            ]))
            (self.panel(&rise, self.success_mm, [
                (GRIPPER, &self.gripper_mm),
                (OBJECT, &self.object_mm),
            ]))
            (legend(&rise, [(OBJECT, self.object_name), (GRIPPER, "gripper"), ("guide", &success)]))
        };
        Chart {
            size: [width, rise.bottom + Panel::ABSCISSA],
            title: self.title,
            description: "Force of each finger and height of the object over time.".to_owned(),
            body,
        }
    }

    /// Draws a panel with the stages behind its curves.
    fn panel(&self, panel: &Panel, threshold: f64, curves: [(&str, &[f64]); 2]) -> Markup {
        let [begin, end] = self.time_range;
        let [low, high] = panel.y.range();
        html! {
            @for (i, [from, to]) in self.stage_ranges().enumerate() {
                (panel.area(&format!("band-{}", i % 3), [from, to], [low, high]))
            }
            (panel.grid())
            (panel.guide([begin, threshold], [end, threshold]))
            @for (class, values) in curves {
                @let points = self.time_s.iter().zip(values).map(|(&t, &value)| [t, value]);
                (panel.line(class, points))
            }
            (panel.edges())
        }
    }

    /// Start and end of each stage; missing stages are empty.
    fn stage_ranges(&self) -> impl Iterator<Item = [f64; 2]> {
        let [begin, end] = self.time_range;
        self.stages.iter().scan(begin, move |from, (_, to)| {
            let to = if to.is_finite() { *to } else { end };
            let to = to.clamp(*from, end.max(*from));
            Some([std::mem::replace(from, to), to])
        })
    }

    /// Draws the stage names at the top of a panel; vertically in narrow stages.
    fn stage_names(&self, panel: &Panel) -> Markup {
        html! {
            @for ((name, _), [from, to]) in self.stages.iter().zip(self.stage_ranges()) {
                @let [from, to] = [from, to].map(|t| panel.to_px([t, 0.0])[0]);
                @let middle = 0.5 * (from + to);
                @if to - from > width(name, SMALL) {
                    (text("small halo", [middle, panel.top + 13.0], Anchor::Middle, name))
                } @else if to - from > SMALL {
                    (upright("small halo", [middle + 4.0, panel.top + 4.0], Anchor::End, name))
                }
            }
        }
    }
}

/// Range from the minimum (or 0) to slightly above the maximum.
fn range(values: impl Iterator<Item = f64>, headroom: f64) -> [f64; 2] {
    let [low, high] = extent(values.chain([0.0])).unwrap_or([0.0, 1.0]);
    [low, low + headroom * (high - low)]
}

/// Draws a legend above a panel.
fn legend(panel: &Panel, entries: [(&str, &str); 3]) -> Markup {
    let entries = entries.map(|(class, name)| Entry::new(Key::Line(class.to_owned()), name));
    let at = [panel.left, panel.top - LEGEND];
    Legend::new(at, panel.right - panel.left, &entries).body
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_report::chart::layout;
    use gripcast_sim::grasp::{GraspOutcome, GraspResult, Protocol, sample_trace};
    use gripcast_sim::solver::PhaseTimes;

    fn summary(trace: Trace) -> GraspSummary {
        let result = GraspResult {
            outcome: GraspOutcome::Success,
            detail: None,
            lifted_m: 0.05,
            friction_use: None,
            unconverged_steps: 0,
            times: PhaseTimes::default(),
            trace,
        };
        GraspSummary::new(&result, &Protocol::default(), 0.01)
    }

    #[test]
    fn chart_has_curves_stages_axes_and_legend() {
        let trace = sample_trace();
        let svg = plot(&trace, &summary(trace.clone()), 0.02, "builtin:box");
        layout::check(&svg);
        // Each curve also has a legend entry.
        assert_eq!(svg.matches("class=\"curve ").count(), 2 * 4);
        assert_eq!(svg.matches("class=\"band-").count(), 2 * 3);
        for word in [
            "closure",
            "adjustment",
            "lift",
            "left gel",
            "F_stop 40 N",
            "success above 20 mm",
            "time, s",
        ] {
            assert!(svg.contains(word), "{word}");
        }
        assert!(
            svg.contains("builtin:box: stable, lifted 50.0 mm, 40.0 ± 0.5 N"),
            "{svg}"
        );
    }

    #[test]
    fn chart_escapes_text_and_omits_missing_data() {
        let empty = Trace::default();
        let svg = plot(&empty, &summary(empty.clone()), 0.02, "a<b>&\u{1}.obj");
        layout::check(&svg);
        assert!(svg.contains("a&lt;b&gt;&amp; .obj"), "{svg}");
        assert_eq!(svg.matches("class=\"band-").count(), 0);
    }
}
