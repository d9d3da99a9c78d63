//! Details of every grasp: recorded data and the result of each engine.

use super::Page;
use super::grasp_index::{Marks, disagreeing};
use super::settings::Grid;
use super::text::{Agreement, setting};
use crate::grasp_chart::inline;
use crate::report::{GraspFacts, GraspReplay, PoseSamples, Setting, TactilePair};
use gripcast_report::image::image;
use gripcast_report::page::{definitions, placeholder};
use gripcast_report::{
    MISSING, duration, engine_name, fixed, optional, outcome_label, outcome_name, trimmed,
};
use maud::{Markup, Render, html};

pub(super) fn section(page: &Page<'_>) -> Markup {
    let real = page.real();
    let body = html! {
        p {
            "Images: " (real) " and simulated. Tactile images are grasp minus initial, mid-grey is \
             no change; the third is " (real) " minus simulated. IoU: intersection over union of \
             both contact masks; FVE: fraction of variance explained by the simulation; PSNR and \
             L1: of the difference image. Curves are those of the paper’s choice; the bands behind \
             them are closure, adjustment and lift."
        }
        @for (i, grasp) in page.report.grasps.iter().enumerate() {
            (article(page, i, grasp))
        }
    };
    page.section("grasps", "Grasp by grasp", body)
}

fn article(page: &Page<'_>, i: usize, grasp: &GraspFacts) -> Markup {
    let marks = Marks::of(page, grasp);
    html! {
        article id={ "g" (i) } data-object=[marks.object] data-marks=(marks.engines) {
            h3 { (grasp.id) " " span { (grasp.object) } }
            p.outcomes {
                span { (page.real()) ": " b { (outcome_label(grasp.stable)) } }
                @for replay in &grasp.replays {
                    @let agreement = Agreement(replay.agrees);
                    span class=(agreement.class()) {
                        (engine_name(&replay.engine)) ": "
                        b { (outcome_name(&replay.case.outcome)) }
                        " " (agreement.sign()) " " (agreement.word())
                    }
                }
            }
            @if grasp.view.is_some() || !grasp.tactile.is_empty() {
                (images(page, i, grasp))
            }
            div.engines {
                @for replay in &grasp.replays { (engine(grasp, replay)) }
            }
            (pose(grasp))
        }
    }
}

fn images(page: &Page<'_>, i: usize, grasp: &GraspFacts) -> Markup {
    let real = page.real();
    let alt = |what: &str| format!("grasp {}, camera, {what}", grasp.id);
    html! {
        div.strip {
            @if let Some(view) = &grasp.view {
                figure.view {
                    div {
                        (image(&view.real, &format!("g{i}v"), &alt(real)))
                        (image(&view.sim, &format!("g{i}w"), &alt("simulated")))
                    }
                    figcaption { "camera: " (real) " | simulated" }
                }
            }
            div.gels {
                @for (k, pair) in grasp.tactile.iter().enumerate() {
                    (tactile(real, [i, k], &grasp.id, pair))
                }
            }
        }
    }
}

fn tactile(real: &str, [i, k]: [usize; 2], grasp: &str, pair: &TactilePair) -> Markup {
    let views = [
        (&pair.images.real, "r", real),
        (&pair.images.sim, "s", "simulated"),
        (&pair.difference, "d", "difference"),
    ];
    html! {
        figure {
            div {
                @for (uri, letter, name) in views {
                    @let alt = format!("grasp {grasp}, {} sensor, {name}", pair.sensor);
                    (image(uri, &format!("g{i}{letter}{k}"), &alt))
                }
            }
            figcaption {
                (pair.sensor) " sensor:" br; (real) " | simulated | difference"
                span { "IoU " (optional(pair.contact_iou, 2)) }
                span { "FVE " (optional(pair.fve, 2)) }
                span { "PSNR " (optional(pair.psnr_db, 1)) " dB" }
                span { "L1 " (optional(pair.l1, 1)) }
            }
        }
    }
}

fn engine(grasp: &GraspFacts, replay: &GraspReplay) -> Markup {
    html! {
        div.engine {
            h4 {
                (engine_name(&replay.engine)) " "
                span { (setting(&replay.engine, replay.chosen)) }
            }
            @match inline(replay, &grasp.id) {
                Some(chart) => (chart),
                None => (placeholder("No forces recorded.")),
            }
            @if let Some(detail) = &replay.case.detail {
                p.detail { (detail) }
            }
            @if let Some(samples) = &replay.pose_samples {
                p.detail { (pose_error(samples, grasp.stable, replay)) }
            }
            div.side {
                (settings(replay))
                (solver(replay))
            }
        }
    }
}

/// Explains a disagreement by the poses drawn from the covariance.
fn pose_error(samples: &PoseSamples, stable: bool, replay: &GraspReplay) -> String {
    let PoseSamples {
        n,
        stable: stable_poses,
    } = *samples;
    if n == 0 {
        return "None of the drawn poses has an outcome.".to_owned();
    }
    let agreeing = if stable {
        stable_poses
    } else {
        n.saturating_sub(stable_poses)
    };
    let meaning = match replay.agrees {
        Some(false) if 2 * agreeing >= n => "the pose error explains the disagreement",
        Some(false) if agreeing > 0 => "the pose error can explain the disagreement",
        Some(false) => "the pose error does not explain the disagreement",
        Some(true) if agreeing == n => "the agreement does not depend on the pose error",
        Some(true) => "the outcome depends on the pose error",
        None => "the annotated pose itself has no outcome",
    };
    format!("{stable_poses} of {n} drawn poses stable: {meaning}.")
}

/// Table of outcomes by setting.
fn settings(replay: &GraspReplay) -> Markup {
    let grid = Grid::new(replay.cells.iter().map(|cell| cell.setting));
    html! {
        @if !grid.forces_n.is_empty() {
            table.cells {
                caption { (disagreeing(replay)) " settings disagree" }
                thead {
                    tr {
                        th scope="col" { "friction" }
                        @for &force_n in &grid.forces_n {
                            th scope="col" { (trimmed(force_n, 2)) " N" }
                        }
                    }
                }
                tbody {
                    @for &friction in grid.frictions.iter().rev() {
                        tr {
                            th scope="row" { (trimmed(friction, 3)) }
                            @for &force_n in &grid.forces_n {
                                (cell(replay, Setting { friction, force_n }))
                            }
                        }
                    }
                }
            }
        }
    }
}

fn cell(replay: &GraspReplay, setting: Setting) -> Markup {
    let cell = replay.cells.iter().find(|cell| cell.setting == setting);
    html! {
        td class=[(setting == replay.chosen).then_some("chosen")] {
            @match cell {
                Some(cell) => (Agreement(cell.agrees).outcome(&cell.outcome)),
                None => (MISSING),
            }
        }
    }
}

fn solver(replay: &GraspReplay) -> Markup {
    let case = &replay.case;
    let mm = |metres: f64| format!("{} mm", fixed(1e3 * metres, 1));
    let (lowest, rose) = (mm(case.min_height_m), mm(case.lifted_m));
    let force = format!("{} N", optional(case.force_n, 1));
    let mut facts: Vec<(&str, &dyn Render)> = vec![
        ("lowest point at the end", &lowest),
        ("centre of mass rose", &rose),
        ("force before the lift", &force),
        ("steps", &case.steps),
    ];
    let each = case.newton_iterations as f64 / case.steps.max(1) as f64;
    let newton = format!("{} ({} per step)", case.newton_iterations, fixed(each, 1));
    if case.newton_iterations > 0 {
        facts.push(("Newton iterations", &newton));
        facts.push(("steps not converged", &case.unconverged_steps));
    }
    let cpu = duration(case.cpu_s);
    facts.push(("CPU time", &cpu));
    definitions("counts", &facts)
}

fn pose(grasp: &GraspFacts) -> Markup {
    let [x, y, z, quaternion @ ..] = grasp.t_object_gripper;
    let mm = |values: [f64; 3]| values.map(|v| fixed(1e3 * v, 2)).join(", ");
    html! {
        p.pose {
            "Gripper in the object’s frame: (" (mm([x, y, z])) ") mm, quaternion wxyz ("
            (quaternion.map(|v| fixed(v, 4)).join(", ")) ")"
            @if let Some(sd) = grasp.pose_sd_m { "; standard deviation (" (mm(sd)) ") mm" }
            @if let Some(sd) = grasp.pose_sd_rad {
                "; (" (sd.map(|v| fixed(v.to_degrees(), 2)).join(", ")) ")°"
            }
            "."
        }
    }
}
