//! One implicit Euler step: the incremental potential and its minimisation.

mod gel_factor;

pub use gel_factor::{GelFactor, NotPositiveDefinite};
