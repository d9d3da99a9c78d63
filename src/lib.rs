//! gripcast: collects visuo-tactile grasps and predicts their stability before the lift.
//!
//! This crate is the program: command line, engine, screens, page. The libraries are in `crates/`;
//! ARCHITECTURE.md shows how they depend on each other.
//!
//! # Units and frames
//! SI units everywhere (m, kg, s, N, Pa, rad); a suffix names the unit where a number crosses a
//! boundary. `t_a_b` maps coordinates of frame b into frame a. Colour order is RGB. Pixel (0,0)
//! is the centre of the top-left pixel. Tactile difference = grasp − initial, signed.

#![deny(unsafe_code)]

mod camera_check;
pub mod cli;
mod collection;
pub mod config;
pub mod daemon;
mod doctor;
mod gel_check;
mod model_choice;
mod rig_lock;
mod service;
mod terminal_text;
pub mod tui;
mod web;

pub(crate) use terminal_text::note;
