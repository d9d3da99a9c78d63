//! What reports and figures share: the page with its parts ([`page`]), charts ([`chart`]), pictures
//! and the text of numbers.
//!
//! A page is one file: no network, inline CSS and SVG, readable without a script. Every string is
//! escaped by the [`maud`] templates; pictures are data URIs that [`picture`] has checked.

pub mod chart;
pub mod page;
pub mod picture;
pub mod polyline;
mod text;

pub use text::{
    MISSING, duration, engine_name, fixed, label_name, optional, outcome_name, trimmed,
};
