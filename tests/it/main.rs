//! The one integration-test binary; a module a topic.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod annotate;
mod black_box;
mod board;
mod calibrate;
mod calibrate_intrinsics;
mod camera_states;
mod cluster;
mod collect;
mod crash;
mod daemon;
mod daemon_kills;
mod dataset;
mod dataset_contents;
mod docs;
mod doctor;
mod examples;
mod export;
mod familiarity;
mod fuzz_corpus;
mod gels;
mod hangup;
mod help;
mod hostile;
mod hostile_synth;
mod imaging;
mod json_schema;
mod kernel;
mod model_contract;
mod names;
mod packaging;
mod peers;
mod program;
mod raw_files;
mod readme;
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
