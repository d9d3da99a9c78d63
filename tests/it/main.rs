//! The one integration-test binary; a module a topic.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod dataset;
mod layers;
