//! The contact sheet, as the paper's Figure 11: held grasps, then lost ones.

use std::fmt::Write as _;

use super::words;
use crate::report::facts::{Example, SynthReport};
use gripcast_report::picture::picture;
use gripcast_report::{Esc, fixed, label_name, open_section, outcome_name, put, trimmed};

pub(super) fn section(report: &SynthReport, out: &mut String) {
    open_section(out, "sheet", "Contact sheet (Figure 11)");
    put!(
        out,
        "<p>Drawn by seed {} from {}, one category after the other. Each: the camera between the \
         fingers before the lift; the left and the right tactile sensor (above), and what the \
         contact changed in them (below; grey is no change, doubled).</p>\n<div class=\"sheets\">\n",
        report.seed,
        match report.dataset {
            Some(_) => "the dataset",
            None => "all results",
        }
    );
    for held in [true, false] {
        let examples = report.examples.iter().enumerate();
        let examples: Vec<_> = examples.filter(|(_, one)| one.held == held).collect();
        put!(
            out,
            "<h3>{} <span>{}</span></h3>\n",
            if held { "Held" } else { "Lost" },
            examples.len()
        );
        if examples.is_empty() {
            out.push_str("<p class=\"nothing\">None.</p>\n");
            continue;
        }
        out.push_str("<ul class=\"grasps\">\n");
        for (number, example) in examples {
            card(number, example, out);
        }
        out.push_str("</ul>\n");
    }
    out.push_str("</div>\n</section>\n");
}

fn card(number: usize, example: &Example, out: &mut String) {
    put!(
        out,
        "<li class=\"of-{}\"><div class=\"views\">",
        label_name(example.held)
    );
    let name = &example.simulation;
    let pictures = &example.pictures;
    let mut view = |uri: &str, id: &str, alt: &str| {
        picture(
            out,
            uri,
            &format!("e{number}{id}"),
            &format!("{name}, {alt}"),
        );
    };
    view(&pictures.colour, "c", "camera");
    view(&pictures.grasp[0], "l", "left sensor");
    view(&pictures.grasp[1], "r", "right sensor");
    view(&pictures.change[0], "m", "change of the left sensor");
    view(&pictures.change[1], "s", "change of the right sensor");
    put!(
        out,
        "</div><p><b>{}</b> {}</p>\n<p>{}&nbsp;N, {}, friction {}, {}&nbsp;g</p>\n\
         <p>{}; rose {}&nbsp;mm</p>\n<p class=\"nothing\">{}</p></li>\n",
        Esc(&example.object),
        Esc(&words(&example.material)),
        trimmed(example.stop_force_n, 3),
        Esc(&fault(example)),
        fixed(example.friction, 2),
        fixed(1e3 * example.mass_kg, 0),
        Esc(outcome_name(&example.outcome)),
        fixed(1e3 * example.lifted_m, 1),
        Esc(&example.appearance)
    );
}

fn fault(example: &Example) -> String {
    match example.fault.as_deref() {
        None => "given grasp".to_owned(),
        Some("none") => "no fault".to_owned(),
        Some(fault) => fault.to_owned(),
    }
}
