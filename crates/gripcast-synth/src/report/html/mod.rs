//! The report as one page: no network, no script, light and dark; drawn from the facts alone.

mod balance;
mod contact;
mod cost;
mod counts;
mod head;
mod notes;
#[cfg(test)]
mod page_test;
mod sheet;

use super::facts::{Labels, SYNTH_REPORT_FORMAT, SYNTH_REPORT_VERSION, SynthReport};
use gripcast_base::error::{Error, Result};
use gripcast_report::page::{Page, stack};
use gripcast_report::{MISSING, fixed};
use maud::{Markup, html};

const STYLE: &str = include_str!("style.css");

/// Sections with their names in the bar.
const SECTIONS: [(&str, &str); 8] = [
    ("summary", "Summary"),
    ("counts", "Counts"),
    ("balance", "Balance"),
    ("sheet", "Contact sheet"),
    ("contact", "Contact"),
    ("cost", "Cost"),
    ("unlabelled", "Without label"),
    ("notes", "Notes"),
];

/// The page of a report: the same report gives the same bytes.
///
/// # Errors
/// `Input` where the report is of another format or version.
pub fn page(report: &SynthReport) -> Result<String> {
    if report.format != SYNTH_REPORT_FORMAT || report.version != SYNTH_REPORT_VERSION {
        return Err(Error::input(format!(
            "cannot draw the page: expected {SYNTH_REPORT_FORMAT} version \
                 {SYNTH_REPORT_VERSION}, found {:?} version {}",
            report.format, report.version
        ))
        .remedy("report again with this version of gripcast"));
    }
    let page = Page {
        software: &report.software,
        title: &format!("Simulated grasps of plan {}", short(&report.plan.sha256)),
        style: STYLE,
        script: None,
        sections: &SECTIONS,
        flag: Some("Everything is simulated"),
        main: html! {
            (head::summary(report))
            (counts::section(report))
            (balance::section(report))
            (sheet::section(report))
            (contact::section(report))
            (cost::section(report))
            (cost::unlabelled(report))
            (notes::section(report))
        },
    };
    Ok(page.to_html())
}

/// The begin of a hash.
fn short(hash: &str) -> String {
    hash.chars().take(12).collect()
}

/// A bar of both labels, `full` simulations long where it fills its place.
fn bar(labels: Labels, full: usize) -> Markup {
    let fraction = |count: usize| count as f64 / full.max(1) as f64;
    stack([
        ("held", fraction(labels.held)),
        ("lost", fraction(labels.lost)),
    ])
}

/// `63 %`, or that there is nothing.
fn percent(fraction: Option<f64>) -> String {
    fraction.map_or_else(
        || MISSING.to_owned(),
        |fraction| format!("{}\u{a0}%", fixed(100.0 * fraction, 0)),
    )
}

/// A name in files as people write it.
fn words(name: &str) -> String {
    name.replace('_', " ")
}

/// What the colours of the bars mean.
fn key() -> Markup {
    html! {
        p.key {
            i.held {} " held "
            i.lost {} " lost"
        }
    }
}
