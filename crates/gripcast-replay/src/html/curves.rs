//! Force of each finger and height of the object over time.

use std::fmt::Write as _;

use super::plot::{Label, Panel, extent};
use super::put;
use super::text::{Esc, engine_name, trimmed};
use crate::report::{Curves, GraspReplay};

const FORCE: [f64; 4] = [34.0, 452.0, 16.0, 122.0];
const HEIGHT: [f64; 4] = [34.0, 452.0, 144.0, 200.0];
const STAGES: [(&str, &str); 3] = [("closure", "s0"), ("adjustment", "s1"), ("lift", "s2")];

/// The diagram of a grasp in an engine; says so where nothing was recorded.
pub(super) fn figure(out: &mut String, replay: &GraspReplay, id: &str) {
    let Some(curves) = replay.curves.as_ref() else {
        out.push_str("<p class=\"nothing\">No forces recorded.</p>");
        return;
    };
    let Some(time) = extent(curves.t_s.iter().copied()) else {
        out.push_str("<p class=\"nothing\">No forces recorded.</p>");
        return;
    };
    put!(
        out,
        "<svg class=\"curves\" viewBox=\"0 0 460 226\" role=\"img\" \
         aria-label=\"Grasp {}, {}: force of each finger and height of the object over time\">",
        Esc(id),
        Esc(engine_name(&replay.engine))
    );
    forces(out, replay, curves, time);
    heights(out, curves, time);
    out.push_str("</svg>");
}

fn forces(out: &mut String, replay: &GraspReplay, curves: &Curves, time: [f64; 2]) {
    let stop = replay.chosen.force_n;
    let values = curves.left_n.iter().chain(&curves.right_n).copied();
    let [low, high] = extent(values.chain([0.0, stop])).unwrap_or([0.0, 1.0]);
    let panel = Panel::new(FORCE, time, [low, low + 1.14 * (high - low)]);
    stages(out, curves, &panel, time, true);
    panel.ordinate(out, "force, N", 5.0);
    let name = match replay.engine.as_str() {
        "fem" => "F<tspan class=\"sub\" dy=\"2\">stop</tspan><tspan dy=\"-2\">",
        _ => "closing force<tspan>",
    };
    let name = format!("{name} {} N</tspan>", trimmed(stop, 2));
    panel.threshold(out, stop, &name, Label::RightBelow);
    panel.curve(out, &curves.t_s, &curves.left_n, "cl");
    panel.curve(out, &curves.t_s, &curves.right_n, "cr");
    out.push_str("<use href=\"#key-force\" x=\"34\" y=\"11\"/>");
}

fn heights(out: &mut String, curves: &Curves, time: [f64; 2]) {
    let mm = |metres: &[f64]| -> Vec<f64> { metres.iter().map(|z| 1e3 * z).collect() };
    let (object, gripper) = (mm(&curves.min_height_m), mm(&curves.lifted_m));
    let success = 1e3 * curves.success_height_m;
    let values = object.iter().chain(&gripper).copied();
    let [low, high] = extent(values.chain([0.0, success])).unwrap_or([0.0, 1.0]);
    let panel = Panel::new(HEIGHT, time, [low, low + 1.1 * (high - low)]);
    stages(out, curves, &panel, time, false);
    panel.ordinate(out, "height, mm", 3.0);
    panel.abscissa(out, "time, s", 8.0);
    let name = format!("success above {} mm", trimmed(success, 1));
    panel.threshold(out, success, &name, Label::LeftAbove);
    panel.curve(out, &curves.t_s, &gripper, "cg");
    panel.curve(out, &curves.t_s, &object, "co");
    out.push_str("<use href=\"#key-height\" x=\"34\" y=\"139\"/>");
}

fn stages(out: &mut String, curves: &Curves, panel: &Panel, time: [f64; 2], is_named: bool) {
    let [adjustment, lift] = curves.stages_s.map(|t| {
        if t.is_finite() {
            t.clamp(time[0], time[1])
        } else {
            time[1]
        }
    });
    let edges = [time[0], adjustment, lift.max(adjustment), time[1]];
    for (i, (name, class)) in STAGES.into_iter().enumerate() {
        panel.band(out, edges[i], edges[i + 1], class);
        let (x, end) = (panel.x(edges[i]), panel.x(edges[i + 1]));
        if is_named && end - x > 5.0 * name.len() as f64 {
            put!(
                out,
                "<text class=\"st\" x=\"{:.0}\" y=\"{:.0}\">{name}</text>",
                0.5 * (x + end),
                FORCE[3] - 4.0
            );
        }
    }
}
