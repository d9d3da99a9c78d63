//! Shared parts of reports and figures: pages ([`page`]), charts ([`chart`]), images ([`image`])
//! and number formatting.
//!
//! A page is a single file: no network access, inline CSS and SVG, readable without a script.
//! Strings are escaped by the [`maud`] templates; images are validated data URIs.

pub mod chart;
pub mod image;
pub mod page;
pub mod polyline;
mod text;

pub use text::{
    MISSING, duration, engine_name, fixed, optional, outcome_label, outcome_name, trimmed,
};
