//! Networks.
#![allow(dead_code, unused_imports)]
pub mod architecture;
mod batch_norm;
pub mod conv;
mod lanes;
pub mod network;
mod product;
pub mod probe;
