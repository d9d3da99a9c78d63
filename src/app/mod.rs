//! The program: command line, engine, screens. The only area that knows tokio, clap and ratatui.

pub mod cli;
pub mod config;
pub mod daemon;
pub mod tui;
