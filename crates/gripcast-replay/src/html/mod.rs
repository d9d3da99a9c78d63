//! The report as one page: no network, nothing but inline CSS, SVG and a little script without
//! which everything can still be read.
//!
//! Every string of the report goes through [`text::Esc`]; pictures are data URIs that
//! [`gripcast_report::picture`] has looked at. The page's policy allows no other source.

mod appendix;
mod changes;
mod confusion;
mod curves;
mod gallery;
mod grasp;
mod grasp_index;
mod grid;
mod head;
mod heat;
#[cfg(test)]
mod page_test;
mod plot;
mod tables;
mod text;

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use sha2::{Digest as _, Sha256};

use self::text::Esc;
use super::report::{REPORT_FORMAT, REPORT_VERSION, Reality, Report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_report::{open_wide, picture, put, theme_choice};

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("script.js");

/// The page of a report: the same report gives the same bytes.
///
/// # Errors
/// `Input` where the report is of another format or version.
pub fn page(report: &Report) -> Result<String> {
    if report.format != REPORT_FORMAT || report.version != REPORT_VERSION {
        return Err(Error::new(
            ErrorKind::Input,
            format!(
                "cannot draw the page: expected {REPORT_FORMAT} version {REPORT_VERSION}, found \
                 {:?} version {}",
                report.format, report.version
            ),
        )
        .remedy("replay again with this version of gripcast"));
    }
    let page = Page { report };
    let mut out = String::new();
    page.open(&mut out);
    head::verdict(&page, &mut out);
    tables::accuracy(&page, &mut out);
    tables::parameters(&page, &mut out);
    confusion::sections(&page, &mut out);
    heat::section(&page, &mut out);
    gallery::section(&page, &mut out);
    grasp_index::section(&page, &mut out);
    grasp::section(&page, &mut out);
    appendix::left_out(&page, &mut out);
    appendix::cost(&page, &mut out);
    changes::section(&page, &mut out);
    appendix::notes(&page, &mut out);
    put!(
        out,
        "</main>\n<script>{SCRIPT}</script>\n</body>\n</html>\n"
    );
    Ok(out)
}

/// What all sections need.
struct Page<'a> {
    report: &'a Report,
}

impl Page<'_> {
    /// How reality was made, where it was.
    fn simulated(&self) -> Option<&str> {
        match &self.report.dataset.reality {
            Reality::Real => None,
            Reality::Simulated { how } => Some(how),
        }
    }

    /// What the outcomes of the dataset are called.
    fn reality(&self) -> &'static str {
        match self.simulated() {
            Some(_) => "simulated reality",
            None => "reality",
        }
    }

    /// What the pictures of the dataset are called.
    fn real(&self) -> &'static str {
        match self.simulated() {
            Some(_) => "as if real",
            None => "real",
        }
    }

    /// The statement under every heading that reality is simulated.
    fn banner(&self, out: &mut String) {
        if let Some(how) = self.simulated() {
            put!(
                out,
                "<p class=\"simulated\" role=\"note\"><b>Reality is simulated here:</b> {}</p>\n",
                Esc(how)
            );
        }
    }

    fn open_section(&self, out: &mut String, id: &str, title: &str) {
        put!(out, "<section id=\"{id}\">\n<h2>{title}</h2>\n");
        self.banner(out);
    }

    fn open(&self, out: &mut String) {
        let title = format!("Replay of {}", self.report.dataset.name);
        let script = STANDARD.encode(Sha256::digest(SCRIPT.as_bytes()));
        let script = format!("'sha256-{script}'");
        gripcast_report::begin(out, &self.report.software, &title, STYLE, Some(&script));
        if self.simulated().is_some() {
            out.push_str("<div class=\"spine\" aria-hidden=\"true\">Reality is simulated</div>\n");
        }
        self.bar(out);
        plot::shared_keys(out);
        out.push_str("<main>\n");
    }

    fn bar(&self, out: &mut String) {
        out.push_str("<header class=\"bar\"><nav aria-label=\"Sections\">");
        let mut links = vec![
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
        if self.report.changes.is_some() {
            links.push(("changes", "Changes"));
        }
        links.push(("notes", "Notes"));
        for (id, name) in links {
            put!(out, "<a href=\"#{id}\">{name}</a>");
        }
        out.push_str("</nav>");
        if self.simulated().is_some() {
            out.push_str("<span class=\"flag\">reality is simulated</span>");
        }
        theme_choice(out);
        out.push_str("</header>\n");
    }
}
