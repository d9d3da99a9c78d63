//! The report as a single page without network access or scripts, rendered from the facts alone.

mod balance;
mod contact;
mod cost;
mod counts;
mod head;
mod notes;
#[cfg(test)]
mod page_test;
mod sheet;

use super::facts::{LabelCounts, SYNTH_REPORT_FORMAT, SYNTH_REPORT_VERSION, SynthReport};
use gripcast_base::error::{Error, Result};
use gripcast_report::page::{Page, stacked_bar};
use gripcast_report::{MISSING, fixed};
use maud::{Markup, html};

const STYLE: &str = include_str!("style.css");

/// Ids and names of the sections, for the navigation bar.
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

/// Renders the page of a report: equal reports give identical bytes.
///
/// # Errors
/// `Input` for a report of another format or version.
pub fn page(report: &SynthReport) -> Result<String> {
    if report.format != SYNTH_REPORT_FORMAT || report.version != SYNTH_REPORT_VERSION {
        return Err(Error::input(format!(
            "cannot render the page: expected {SYNTH_REPORT_FORMAT} version \
                 {SYNTH_REPORT_VERSION}, found {:?} version {}",
            report.format, report.version
        ))
        .remedy("create the report again with this version of gripcast"));
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

/// The first digits of a hash.
fn short(hash: &str) -> String {
    hash.chars().take(12).collect()
}

/// A bar of both labels; `full` simulations fill its width.
fn bar(labels: LabelCounts, full: usize) -> Markup {
    let fraction = |count: usize| count as f64 / full.max(1) as f64;
    stacked_bar([
        ("stable", fraction(labels.stable)),
        ("slip", fraction(labels.slip)),
    ])
}

/// Formats `63 %`, or a placeholder.
fn percent(fraction: Option<f64>) -> String {
    fraction.map_or_else(
        || MISSING.to_owned(),
        |fraction| format!("{}\u{a0}%", fixed(100.0 * fraction, 0)),
    )
}

/// Formats a name from a file.
fn words(name: &str) -> String {
    name.replace('_', " ")
}

/// Legend of the bars.
fn key() -> Markup {
    html! {
        p.key {
            i.stable {} " stable "
            i.slip {} " slip"
        }
    }
}
