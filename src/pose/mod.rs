//! Poses from printed markers: boards, detection, corner refinement, solving, calibration.
//!
//! # Frames
//! A board's frame is that of what it is fixed to: the object's frame for the sheet that the
//! object stands on, the gripper's frame (or that of a finger) for the gripper's markers. Markers
//! are flat squares; their corners are listed top left, top right, bottom right, bottom left as
//! they appear when the marker's code is read upright from the front. Camera: OpenCV optical
//! frame. Pixel (0, 0) is the centre of the top-left pixel; every detector's own convention is
//! converted in its wrapper.

mod board;
mod detection;
mod dictionary;
mod yaml;

pub use board::{Board, BoardMarker, Part};
pub use detection::{Detection, MarkerDetector};
pub use dictionary::{DICTIONARY_NAMES, Dictionary, MarkerCells};
