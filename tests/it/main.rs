//! The one integration-test binary; a module a topic.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod annotate;
mod black_box;
mod board;
mod calibrate;
mod calibrate_intrinsics;
mod cluster;
mod collect;
mod crash;
mod daemon;
mod dataset;
mod doctor;
mod export;
mod familiarity;
mod fuzz_corpus;
mod hangup;
mod hostile;
mod hostile_synth;
mod imaging;
mod kernel;
mod model_contract;
mod packaging;
mod program;
mod raw_files;
mod render;
mod render_tactile;
mod replay;
mod rig;
mod screen;
mod sim;
mod synth;
mod train;
mod training_screen;
mod visual_scene;
