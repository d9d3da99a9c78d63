//! The program: command line, engine, screens. The only area that knows tokio, clap and ratatui.

mod camera_check;
pub mod cli;
mod collection;
pub mod config;
pub mod daemon;
mod doctor;
mod model_choice;
mod rig_lock;
mod service;
mod terminal_text;
pub mod tui;
mod web;

pub(crate) use terminal_text::note;
