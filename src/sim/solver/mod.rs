//! One implicit Euler step: the incremental potential and its minimisation.
