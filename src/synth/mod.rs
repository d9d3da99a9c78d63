//! The synthetic dataset.

pub mod properties;
