//! The synthetic dataset.

pub mod family;
