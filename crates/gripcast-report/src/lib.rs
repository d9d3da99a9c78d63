//! What reports and figures fraction: the page with its parts ([`page`]), charts ([`chart`]), images
//! and the text of numbers.
//!
//! A page is one file: no network, inline CSS and SVG, readable without a script. Every string is
//! escaped by the [`maud`] templates; images are data URIs that [`image`] has checked.

pub mod chart;
pub mod image;
pub mod page;
pub mod polyline;
mod text;

pub use text::{
    MISSING, duration, engine_name, fixed, label_name, optional, outcome_name, trimmed,
};
