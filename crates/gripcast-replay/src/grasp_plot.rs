//! The forces and heights of a grasp as a picture (SVG), like the paper's Figure 1.

use std::fmt::Write as _;

use gripcast_report::{tick_step, ticks};
use gripcast_sim::grasp::{GraspOutcome, GraspSummary, StageName, Trace, TraceStep};

const WIDTH: f64 = 880.0;
const HEIGHT: f64 = 560.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = 860.0;
const FORCE_TOP: f64 = 72.0;
const FORCE_BOTTOM: f64 = 350.0;
const RISE_TOP: f64 = 382.0;
const RISE_BOTTOM: f64 = 504.0;

/// Width of a character of the legend at most, px.
const CHARACTER: f64 = 7.2;
/// Height that the names of the stages need, px.
const NAMES: f64 = 24.0;

const LEFT_COLOUR: &str = "#1f6fb4";
const RIGHT_COLOUR: &str = "#d95f0e";
const OBJECT_COLOUR: &str = "#2b7a3d";
const GRIPPER_COLOUR: &str = "#6b6b6b";
const STAGE_COLOURS: [&str; 3] = ["#eef3f9", "#fdf6e7", "#edf6ee"];

/// The picture: the force of each gel over time with F_stop and the stages, and below it the rise
/// of the object and the gripper. `title` is what was grasped.
pub fn plot(trace: &Trace, summary: &GraspSummary, success_height_m: f64, title: &str) -> String {
    let end = trace.steps.last().map_or(1.0, |step| step.t_s);
    let most = trace
        .steps
        .iter()
        .flat_map(|step| step.force.map(|force| force.normal_n))
        .fold(summary.stop_force_n, f64::max);
    let risen = rises(trace);
    let highest = risen
        .iter()
        .map(|(_, object, gripper)| object.max(*gripper));
    let highest = highest.fold(1.2e3 * success_height_m, f64::max);
    let lowest = risen.iter().fold(0.0, |low: f64, (_, z, _)| low.min(*z));
    let force = Panel::new(end, [0.0, 1.2 * most], [FORCE_TOP, FORCE_BOTTOM]);
    let rise = Panel::new(end, [1.1 * lowest, 1.1 * highest], [RISE_TOP, RISE_BOTTOM]);
    let mut svg = Svg::new();
    svg.text(
        LEFT,
        26.0,
        "start",
        15.0,
        "#111111",
        &format!("{title}: {}", verdict(summary)),
    );
    stages(&mut svg, trace, &[&force, &rise]);
    force.axes(&mut svg, "force of each gel, N", None);
    rise.axes(&mut svg, "rise, mm", Some("time, s"));
    threshold(&mut svg, &force, summary.stop_force_n);
    threshold(&mut svg, &rise, 1e3 * success_height_m);
    let curve = |gel: usize| {
        trace
            .steps
            .iter()
            .map(move |s| (s.t_s, s.force[gel].normal_n))
    };
    force.curve(&mut svg, curve(0), LEFT_COLOUR, "");
    force.curve(&mut svg, curve(1), RIGHT_COLOUR, "7 4");
    rise.curve(
        &mut svg,
        risen.iter().map(|r| (r.0, r.2)),
        GRIPPER_COLOUR,
        "7 4",
    );
    rise.curve(
        &mut svg,
        risen.iter().map(|r| (r.0, r.1)),
        OBJECT_COLOUR,
        "",
    );
    legend(&mut svg, summary.stop_force_n, success_height_m);
    svg.finish()
}

/// Time in s, rise of the object's origin and of the gripper in mm.
fn rises(trace: &Trace) -> Vec<(f64, f64, f64)> {
    let height = |step: &TraceStep| step.t_world_object.translation_m.z;
    let start = trace.steps.first().map_or(0.0, height);
    let steps = trace.steps.iter();
    steps
        .map(|step| (step.t_s, 1e3 * (height(step) - start), 1e3 * step.lifted_m))
        .collect()
}

fn verdict(summary: &GraspSummary) -> String {
    let outcome = match summary.outcome {
        GraspOutcome::Success => "held",
        GraspOutcome::Slip => "slipped",
        GraspOutcome::Eject => "squeezed out",
        GraspOutcome::Miss => "missed",
        GraspOutcome::Closed => "the gels met",
        GraspOutcome::PenetratingStart => "collision at the start",
        GraspOutcome::NotConverged => "not converged",
    };
    match (summary.mean_force_n, summary.std_force_n) {
        (Some(mean), Some(std)) => format!(
            "{outcome}, lifted {:.1} mm, {mean:.1} ± {std:.1} N at the end of the adjustment",
            1e3 * summary.lifted_m
        ),
        _ => outcome.to_owned(),
    }
}

fn stages(svg: &mut Svg, trace: &Trace, panels: &[&Panel]) {
    let all = [
        (StageName::Closure, "closure"),
        (StageName::Adjustment, "adjustment"),
        (StageName::Lift, "lift"),
    ];
    let mut start = 0.0;
    for ((stage, name), colour) in all.into_iter().zip(STAGE_COLOURS) {
        let Some(last) = trace.stage(stage).next_back() else {
            continue;
        };
        for panel in panels {
            let (x, end) = (panel.x(start), panel.x(last.t_s));
            svg.rectangle([x, panel.top, end - x, panel.bottom - panel.top], colour);
            if last.t_s < panel.end {
                svg.line([end, panel.top, end, panel.bottom], "#b9b9b9", "");
            }
        }
        let middle = 0.5 * (panels[0].x(start) + panels[0].x(last.t_s));
        // Narrow stages have their name upright, or it would run into the next.
        if panels[0].x(last.t_s) - panels[0].x(start) < 12.0 * name.len() as f64 / 1.7 {
            svg.upright(middle + 4.0, FORCE_TOP + 8.0, "end", 12.0, "#5a5a5a", name);
        } else {
            svg.text(middle, FORCE_TOP + 17.0, "middle", 12.0, "#5a5a5a", name);
        }
        start = last.t_s;
    }
}

fn threshold(svg: &mut Svg, panel: &Panel, value: f64) {
    let y = panel.y(value);
    svg.line([LEFT, y, RIGHT, y], "#222222", "2 4");
}

fn legend(svg: &mut Svg, stop_force_n: f64, success_height_m: f64) {
    let stop = format!("F_stop {stop_force_n} N");
    let success = format!("success above {} mm", 1e3 * success_height_m);
    let force = [
        ("left gel", LEFT_COLOUR, "", 1.6),
        ("right gel", RIGHT_COLOUR, "7 4", 1.6),
        (stop.as_str(), "#222222", "2 4", 1.0),
    ];
    let rise = [
        ("object", OBJECT_COLOUR, "", 1.6),
        ("gripper", GRIPPER_COLOUR, "7 4", 1.6),
        (success.as_str(), "#222222", "2 4", 1.0),
    ];
    for (entries, y) in [(force, FORCE_TOP - 12.0), (rise, RISE_TOP - 9.0)] {
        let mut x = RIGHT;
        for (name, colour, dashes, thickness) in entries.into_iter().rev() {
            x -= CHARACTER * name.len() as f64;
            svg.text(x, y, "start", 12.0, "#333333", name);
            svg.stroke(
                [x - 32.0, y - 4.0, x - 6.0, y - 4.0],
                colour,
                dashes,
                thickness,
            );
            x -= 50.0;
        }
    }
}

/// One diagram over time.
struct Panel {
    end: f64,
    low: f64,
    high: f64,
    top: f64,
    bottom: f64,
    has_names: bool,
}

impl Panel {
    fn new(end: f64, [low, high]: [f64; 2], [top, bottom]: [f64; 2]) -> Self {
        Self {
            end: end.max(1e-9),
            low,
            high: high.max(low + 1e-9),
            top,
            bottom,
            has_names: top == FORCE_TOP,
        }
    }

    fn x(&self, t: f64) -> f64 {
        LEFT + (RIGHT - LEFT) * t / self.end
    }

    fn y(&self, value: f64) -> f64 {
        self.bottom - (self.bottom - self.top) * (value - self.low) / (self.high - self.low)
    }

    fn axes(&self, svg: &mut Svg, label: &str, time_label: Option<&str>) {
        let (step, digits) = tick_step(self.high - self.low, 6.0);
        for value in ticks(self.low, self.high, step) {
            let y = self.y(value);
            let is_free = !self.has_names || y > self.top + NAMES;
            if is_free {
                svg.line([LEFT, y, RIGHT, y], "#dcdcdc", "");
            }
            let text = format!("{value:.digits$}");
            svg.text(LEFT - 8.0, y + 4.0, "end", 12.0, "#333333", &text);
        }
        let (step, digits) = tick_step(self.end, 10.0);
        for t in ticks(0.0, self.end, step) {
            let x = self.x(t);
            svg.line([x, self.bottom, x, self.bottom + 5.0], "#333333", "");
            if time_label.is_some() {
                let text = format!("{t:.digits$}");
                svg.text(x, self.bottom + 19.0, "middle", 12.0, "#333333", &text);
            }
        }
        let (middle, center) = (0.5 * (self.top + self.bottom), 0.5 * (LEFT + RIGHT));
        svg.line([LEFT, self.top, LEFT, self.bottom], "#333333", "");
        svg.line([LEFT, self.bottom, RIGHT, self.bottom], "#333333", "");
        svg.upright(20.0, middle, "middle", 13.0, "#111111", label);
        if let Some(text) = time_label {
            svg.text(center, self.bottom + 40.0, "middle", 13.0, "#111111", text);
        }
    }

    fn curve(
        &self,
        svg: &mut Svg,
        points: impl Iterator<Item = (f64, f64)>,
        colour: &str,
        dashes: &str,
    ) {
        let mut path = String::new();
        for (t, value) in points {
            let (x, y) = (self.x(t), self.y(value));
            let _ = write!(
                path,
                "{}{x:.1} {y:.1}",
                if path.is_empty() { "M" } else { "L" }
            );
        }
        if !path.is_empty() {
            svg.path(&path, colour, dashes);
        }
    }
}

/// Text of an SVG file under way.
struct Svg(String);

impl Svg {
    fn new() -> Self {
        let mut svg = Self(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" \
             width=\"{WIDTH}\" height=\"{HEIGHT}\" font-family=\"'DejaVu Sans', Verdana, Arial, \
             sans-serif\">\n"
        ));
        svg.rectangle([0.0, 0.0, WIDTH, HEIGHT], "#ffffff");
        svg
    }

    fn rectangle(&mut self, [x, y, width, height]: [f64; 4], fill: &str) {
        let _ = writeln!(
            self.0,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
             fill=\"{fill}\"/>"
        );
    }

    fn line(&mut self, ends: [f64; 4], colour: &str, dashes: &str) {
        self.stroke(ends, colour, dashes, 1.0);
    }

    fn stroke(&mut self, [x1, y1, x2, y2]: [f64; 4], colour: &str, dashes: &str, width: f64) {
        let _ = writeln!(
            self.0,
            "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" \
             stroke=\"{colour}\" stroke-width=\"{width}\"{}/>",
            dash_attribute(dashes)
        );
    }

    fn path(&mut self, data: &str, colour: &str, dashes: &str) {
        let _ = writeln!(
            self.0,
            "<path d=\"{data}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.6\" \
             stroke-linejoin=\"round\"{}/>",
            dash_attribute(dashes)
        );
    }

    fn text(&mut self, x: f64, y: f64, anchor: &str, size: f64, colour: &str, text: &str) {
        let _ = writeln!(
            self.0,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" font-size=\"{size}\" \
             fill=\"{colour}\">{}</text>",
            escaped(text)
        );
    }

    /// Text that reads upwards.
    fn upright(&mut self, x: f64, y: f64, anchor: &str, size: f64, colour: &str, text: &str) {
        let _ = writeln!(
            self.0,
            "<text transform=\"translate({x:.1} {y:.1}) rotate(-90)\" text-anchor=\"{anchor}\" \
             font-size=\"{size}\" fill=\"{colour}\">{}</text>",
            escaped(text)
        );
    }

    fn finish(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }
}

fn dash_attribute(dashes: &str) -> String {
    if dashes.is_empty() {
        String::new()
    } else {
        format!(" stroke-dasharray=\"{dashes}\"")
    }
}

fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_sim::grasp::{GraspResult, Protocol, sample_trace};
    use gripcast_sim::solver::PhaseTimes;

    fn summary(trace: Trace) -> GraspSummary {
        let result = GraspResult {
            outcome: GraspOutcome::Success,
            detail: None,
            lifted_m: 0.05,
            unconverged_steps: 0,
            times: PhaseTimes::default(),
            trace,
        };
        GraspSummary::of(&result, &Protocol::default(), 0.01)
    }

    #[test]
    fn the_picture_has_curves_stages_axes_and_legend() {
        let trace = sample_trace();
        let svg = plot(&trace, &summary(trace.clone()), 0.02, "builtin:box");
        assert_eq!(svg.matches("<path").count(), 4);
        for word in [
            "closure",
            "adjustment",
            "lift",
            "left gel",
            "F_stop 40 N",
            "time, s",
        ] {
            assert!(svg.contains(word), "{word}");
        }
        assert!(
            svg.contains("builtin:box: held, lifted 50.0 mm, 40.0 ± 0.5 N"),
            "{svg}"
        );
        assert_eq!(svg.matches("<text").count(), svg.matches("</text>").count());
    }

    #[test]
    fn nothing_but_numbers_and_escaped_text_gets_in() {
        let empty = Trace::default();
        let svg = plot(&empty, &summary(empty.clone()), 0.02, "a<b>&\u{1}.obj");
        assert!(svg.contains("a&lt;b&gt;&amp; .obj"), "{svg}");
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }
}
