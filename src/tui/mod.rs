//! Operator screen, tones, plain text output without a terminal, and the training dashboard.
//!
//! [`run()`] owns the terminal on its own thread: it draws the newest [`EngineStatus`] and converts
//! keys to session commands. A slow or stuck terminal never delays the capture.
//!
//! [`EngineStatus`]: crate::daemon::EngineStatus

mod big_digits;
mod collect;
mod counts;
mod fault;
mod footer;
mod gauge;
mod graphics;
mod header;
mod health;
mod help;
mod input;
mod key_filter;
mod keyboard;
mod lines;
mod palette;
mod preview;
mod prompt;
mod refusal;
mod run;
mod sensors;
mod start_report;
mod state;
mod steps;
mod terminal;
mod text;
mod tone;
mod training;

pub use collect::draw;
pub use graphics::Graphics;
pub use input::{UiAction, action};
pub(crate) use keyboard::Keyboard;
pub use lines::{LinePrinter, print_lines};
pub use palette::{ColourDepth, Palette};
pub use preview::GelImages;
pub use prompt::{Field, Prompt, Reply};
pub use run::{Output, Wiring, run};
pub use state::{Overlay, Reaction, ScreenState};
pub use terminal::restore;
pub use tone::{Sound, Speaker};
pub use training::{TrainingNews, TrainingStatus, draw as draw_training};
pub(crate) use training::{TrainingScreen, epoch_line};
