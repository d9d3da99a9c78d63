//! The synthetic dataset.

pub mod acronym;
pub mod properties;
