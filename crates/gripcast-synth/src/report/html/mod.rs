//! The report as one page: no network, no script, light and dark; drawn from the facts alone.

mod balance;
mod cost;
mod counts;
mod head;
mod notes;
#[cfg(test)]
mod page_test;
mod pictures;
mod sheet;

use std::fmt::Write as _;

use super::facts::{Labels, SYNTH_REPORT_FORMAT, SYNTH_REPORT_VERSION, SynthReport};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_report::{MISSING, fixed, put, section_links, theme_choice};

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
        return Err(Error::new(
            ErrorKind::Input,
            format!(
                "cannot draw the page: expected {SYNTH_REPORT_FORMAT} version \
                 {SYNTH_REPORT_VERSION}, found {:?} version {}",
                report.format, report.version
            ),
        )
        .remedy("report again with this version of gripcast"));
    }
    let mut out = String::new();
    open(report, &mut out);
    head::summary(report, &mut out);
    counts::section(report, &mut out);
    balance::section(report, &mut out);
    sheet::section(report, &mut out);
    pictures::section(report, &mut out);
    cost::section(report, &mut out);
    cost::unlabelled(report, &mut out);
    notes::section(report, &mut out);
    out.push_str("</main>\n</body>\n</html>\n");
    Ok(out)
}

fn open(report: &SynthReport, out: &mut String) {
    let title = format!("Simulated grasps of plan {}", short(&report.plan.sha256));
    gripcast_report::begin(out, &report.software, &title, STYLE, None);
    out.push_str("<div class=\"spine\" aria-hidden=\"true\">Everything is simulated</div>\n");
    section_links(out, &SECTIONS);
    out.push_str("<span class=\"flag\">everything is simulated</span>");
    theme_choice(out);
    out.push_str("</header>\n<main>\n");
}

/// The begin of a hash.
fn short(hash: &str) -> String {
    hash.chars().take(12).collect()
}

/// A bar of both labels, `full` simulations long where it fills its place.
fn bar(out: &mut String, labels: Labels, full: usize) {
    let percent = |count: usize| fixed(100.0 * count as f64 / full.max(1) as f64, 2);
    out.push_str("<div class=\"stack\" aria-hidden=\"true\">");
    for (class, count) in [("held", labels.held), ("lost", labels.lost)] {
        if count > 0 {
            let width = percent(count);
            put!(out, "<i class=\"{class}\" style=\"width:{width}%\"></i>");
        }
    }
    out.push_str("</div>");
}

/// `63 %`, or that there is nothing.
fn percent(share: Option<f64>) -> String {
    share.map_or_else(
        || MISSING.to_owned(),
        |share| format!("{}&nbsp;%", fixed(100.0 * share, 0)),
    )
}

/// A name in files as people write it.
fn words(name: &str) -> String {
    name.replace('_', " ")
}

/// What the colours of the bars mean.
fn key(out: &mut String) {
    out.push_str("<p class=\"key\"><i class=\"held\"></i> held <i class=\"lost\"></i> lost</p>\n");
}
