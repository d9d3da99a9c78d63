//! What the pages of reports share: words and numbers, pictures, the style, the choice of colours.
//!
//! A page is one file: no network, inline CSS and SVG, readable without a script. Every string goes
//! through [`Esc`]; pictures are data URIs that [`picture`] has looked at.

pub(crate) mod picture;
mod text;

use std::fmt::Write as _;

pub(crate) use text::{
    Esc, MISSING, duration, engine_name, fixed, label_name, optional, outcome_name, trimmed,
};

/// Writes into a `String`, which cannot fail.
macro_rules! put {
    ($out:expr, $($argument:tt)*) => {{
        let _ = write!($out, $($argument)*);
    }};
}
pub(crate) use put;

/// Style of every page; a page's own rules come after it.
pub(crate) const BASE_STYLE: &str = include_str!("base.css");

/// Opens the frame in which a wide table scrolls; it can be reached by keyboard.
pub(crate) fn open_wide(out: &mut String, label: &str) {
    put!(
        out,
        "<div class=\"wide\" role=\"region\" tabindex=\"0\" aria-label=\"{}\">",
        Esc(label)
    );
}

/// The choice between light and dark, which needs no script.
pub(crate) fn theme_choice(out: &mut String) {
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
