//! The contact sheet, as the paper's Figure 11: held grasps, then lost ones.

use super::words;
use crate::report::facts::{Example, SynthReport};
use gripcast_report::image::image;
use gripcast_report::page::{self, grasp_card, nothing};
use gripcast_report::{fixed, outcome_name, trimmed};
use maud::{Markup, html};

pub(super) fn section(report: &SynthReport) -> Markup {
    let source = match report.dataset {
        Some(_) => "the dataset",
        None => "all results",
    };
    let half = |held: bool| {
        let examples = report.examples.iter().enumerate();
        let cards = examples.filter(move |(_, one)| one.held == held);
        cards
            .map(|(number, one)| card(number, one))
            .collect::<Vec<_>>()
    };
    let body = html! {
        p {
            "Drawn by seed " (report.seed) " from " (source) ", one category after the other. \
             Each: the camera between the fingers before the lift; the left and the right tactile \
             sensor (above), and what the contact changed in them (below; grey is no change, \
             doubled)."
        }
        div.sheets {
            @for (title, cards) in [("Held", half(true)), ("Lost", half(false))] {
                h3 { (title) " " span { (cards.len()) } }
                @if cards.is_empty() {
                    (nothing("None."))
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
        (&images.change[0], "m", "change of the left sensor"),
        (&images.change[1], "s", "change of the right sensor"),
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
        (nothing(&example.appearance))
    };
    grasp_card(example.held, images, text)
}
