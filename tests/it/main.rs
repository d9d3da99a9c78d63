//! The one integration-test binary; a module a topic.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod annotate;
mod board;
mod calibrate;
mod calibrate_intrinsics;
mod cluster;
mod collect;
mod crash;
mod dataset;
mod doctor;
mod familiarity;
mod hangup;
mod imaging;
mod kernel;
mod layers;
mod model_contract;
mod program;
mod render;
mod render_tactile;
mod replay;
mod rig;
mod screen;
mod shared_data;
mod sim;
mod synth;
mod train;
mod training_screen;
mod visual_scene;
