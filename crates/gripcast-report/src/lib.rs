//! What the pages of reports share: words and numbers, pictures, the style, the choice of colours.
//!
//! A page is one file: no network, inline CSS and SVG, readable without a script. Every string goes
//! through [`Esc`]; pictures are data URIs that [`picture`] has looked at.

pub mod picture;
pub mod polyline;
mod text;
mod ticks;

use std::fmt::Write as _;

pub use text::{
    Esc, MISSING, duration, engine_name, fixed, label_name, optional, outcome_name, trimmed,
};
pub use ticks::{tick_step, ticks};

/// Writes into a `String`, which cannot fail.
#[macro_export]
macro_rules! put {
    ($out:expr, $($argument:tt)*) => {{
        let _ = write!($out, $($argument)*);
    }};
}

/// Style of every page; a page's own rules come after it.
pub const BASE_STYLE: &str = include_str!("base.css");

/// Begins a page of a program's version, up to its body: no network, and no script but `script`, a
/// source of the content security policy.
pub fn begin(out: &mut String, software: &str, title: &str, style: &str, script: Option<&str>) {
    let script = script.map_or(String::new(), |source| format!("; script-src {source}"));
    put!(
        out,
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; \
         img-src data:; style-src 'unsafe-inline'{script}\">\n\
         <meta name=\"generator\" content=\"{}\">\n<title>{}</title>\n\
         <style>{BASE_STYLE}{style}</style>\n</head>\n<body>\n",
        Esc(software),
        Esc(title)
    );
}

/// Writes the links to the sections of a page into its bar.
pub fn section_links(out: &mut String, sections: &[(&str, &str)]) {
    out.push_str("<header class=\"bar\"><nav aria-label=\"Sections\">");
    for (id, name) in sections {
        put!(out, "<a href=\"#{id}\">{name}</a>");
    }
    out.push_str("</nav>");
}

/// Opens a section with its heading.
pub fn open_section(out: &mut String, id: &str, title: &str) {
    put!(out, "<section id=\"{id}\">\n<h2>{title}</h2>\n");
}

/// Opens the frame in which a wide table scrolls; it can be reached by keyboard.
pub fn open_wide(out: &mut String, label: &str) {
    put!(
        out,
        "<div class=\"wide\" role=\"region\" tabindex=\"0\" aria-label=\"{}\">",
        Esc(label)
    );
}

/// The choice between light and dark, which needs no script.
pub fn theme_choice(out: &mut String) {
    out.push_str("<fieldset class=\"theme\"><legend>Colours</legend>");
    for (value, name) in [("auto", "auto"), ("light", "light"), ("dark", "dark")] {
        let checked = if value == "auto" { " checked" } else { "" };
        put!(
            out,
            "<label><input type=\"radio\" name=\"theme\" id=\"theme-{value}\"{checked}>\
             <span>{name}</span></label>"
        );
    }
    out.push_str("</fieldset>");
}
