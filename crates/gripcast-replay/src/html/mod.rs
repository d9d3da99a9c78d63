//! The report as a single page without network access: inline CSS, SVG and a small optional script.
//! The page's content security policy allows no other source.

mod agreement;
mod appendix;
mod changes;
mod gallery;
mod grasp;
mod grasp_index;
mod head;
#[cfg(test)]
mod page_test;
mod settings;
mod tables;
mod text;

use super::report::{REPORT_FORMAT, REPORT_VERSION, Reality, Report};
use gripcast_base::error::{Error, Result};
use gripcast_report::page;
use maud::{Markup, Render, html};

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("script.js");

/// Renders the page of a report: equal reports give identical bytes.
///
/// # Errors
/// `Input` for a report of another format or version.
pub fn page(report: &Report) -> Result<String> {
    if report.format != REPORT_FORMAT || report.version != REPORT_VERSION {
        return Err(Error::input(format!(
            "cannot render the page: expected {REPORT_FORMAT} version {REPORT_VERSION}, found \
                 {:?} version {}",
            report.format, report.version
        ))
        .remedy("repeat the replay with this version of gripcast"));
    }
    let page = Page { report };
    let mut sections = vec![
        ("verdict", "Verdict"),
        ("accuracy", "Table 1"),
        ("parameters", "Table 2"),
        ("confusion", "Confusion"),
        ("settings", "Settings"),
        ("failures", "Failures"),
        ("index", "Grasps"),
        ("left-out", "Left out"),
        ("cost", "Cost"),
    ];
    sections.extend(report.changes.as_ref().map(|_| ("changes", "Changes")));
    sections.push(("notes", "Notes"));
    let html_page = page::Page {
        software: &report.software,
        title: &format!("Replay of {}", report.dataset.name),
        style: STYLE,
        script: Some(SCRIPT),
        sections: &sections,
        flag: page.simulated().map(|_| "Reality is simulated"),
        main: html! {
            (head::verdict(&page))
            (tables::accuracy(&page))
            (tables::parameters(&page))
            (agreement::section(&page))
            (settings::section(&page))
            (gallery::section(&page))
            (grasp_index::section(&page))
            (grasp::section(&page))
            (appendix::left_out(&page))
            (appendix::cost(&page))
            @if let Some(changes) = &report.changes {
                (changes::section(&page, changes))
            }
            (appendix::notes(&page))
        },
    };
    Ok(html_page.to_html())
}

/// Context of all sections.
struct Page<'a> {
    report: &'a Report,
}

impl Page<'_> {
    /// Description of a simulated reality.
    fn simulated(&self) -> Option<&str> {
        match &self.report.dataset.reality {
            Reality::Real => None,
            Reality::Simulated { description } => Some(description),
        }
    }

    /// Name of the dataset's outcomes.
    fn reality(&self) -> &'static str {
        match self.simulated() {
            Some(_) => "simulated reality",
            None => "reality",
        }
    }

    /// Name of the dataset's images.
    fn real(&self) -> &'static str {
        match self.simulated() {
            Some(_) => "as if real",
            None => "real",
        }
    }

    /// Notice below every heading that reality is simulated.
    fn banner(&self) -> Markup {
        html! {
            @if let Some(description) = self.simulated() {
                p.simulated role="note" { b { "Reality is simulated here:" } " " (description) }
            }
        }
    }

    fn section(&self, id: &str, title: &str, body: impl Render) -> Markup {
        page::section(id, title, html! { (self.banner()) (body) })
    }
}
