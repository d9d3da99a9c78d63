//! The contact sheet (the paper's Figure 11): stable grasps, then slips.

use super::words;
use crate::report::facts::{Example, SynthReport};
use gripcast_report::image::image;
use gripcast_report::page::{self, grasp_card, placeholder};
use gripcast_report::{fixed, outcome_name, trimmed};
use maud::{Markup, html};

pub(super) fn section(report: &SynthReport) -> Markup {
    let source = match report.dataset {
        Some(_) => "the dataset",
        None => "all results",
    };
    let half = |stable: bool| {
        let examples = report.examples.iter().enumerate();
        let cards = examples.filter(move |(_, one)| one.stable == stable);
        cards
            .map(|(number, one)| card(number, one))
            .collect::<Vec<_>>()
    };
    let body = html! {
        p {
            "Drawn by seed " (report.seed) " from " (source) ", one category after the other. Left: \
             the camera between the fingers before the lift. Right: left and right tactile sensor \
             (top) and their change by the contact (bottom; mid-grey means no change, amplified twice)."
        }
        div.sheets {
            @for (title, cards) in [("Stable", half(true)), ("Slip", half(false))] {
                h3 { (title) " " span { (cards.len()) } }
                @if cards.is_empty() {
                    (placeholder("None."))
                } @else {
                    ul.grasps { @for card in &cards { (card) } }
                }
            }
        }
    };
    page::section("sheet", "Contact sheet (Figure 11)", body)
}

fn card(number: usize, example: &Example) -> Markup {
    let images = &example.images;
    let views = [
        (&images.colour, "c", "camera"),
        (&images.grasp[0], "l", "left sensor"),
        (&images.grasp[1], "r", "right sensor"),
        (&images.change[0], "m", "change on the left sensor"),
        (&images.change[1], "s", "change on the right sensor"),
    ];
    let images = html! {
        @for (uri, id, alt) in views {
            (image(uri, &format!("e{number}{id}"), &format!("{}, {alt}", example.simulation)))
        }
    };
    let fault = match example.fault.as_deref() {
        None => "given grasp",
        Some("none") => "no fault",
        Some(fault) => fault,
    };
    let text = html! {
        p { b { (example.object) } " " (words(&example.material)) }
        p {
            (trimmed(example.stop_force_n, 3)) "\u{a0}N, " (fault)
            ", friction " (fixed(example.friction, 2))
            ", " (fixed(1e3 * example.mass_kg, 0)) "\u{a0}g"
        }
        p {
            (outcome_name(&example.outcome)) "; rose "
            (fixed(1e3 * example.lifted_m, 1)) "\u{a0}mm"
        }
        (placeholder(&example.appearance))
    };
    grasp_card(example.stable, images, text)
}
