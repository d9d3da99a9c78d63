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
mod board_check;
mod board_file;
mod board_import;
pub mod calibrate;
pub mod camera;
mod camera_file;
mod chessboard;
pub mod detect;
mod detection;
mod dictionary;
mod least_squares;
pub mod print;
pub mod refine;
#[cfg(test)]
mod refine_test;
pub mod solve;
pub mod synthetic;
mod yaml;

pub use board::{Board, BoardMarker, Part};
pub use board_file::{BoardFile, PrintedSheet};
pub use board_import::{ForeignBoard, import_kalibr, import_ros};
pub use camera_file::{
    CameraChoice, CameraFile, CameraFormat, load_intrinsics, require_size, to_opencv, to_ros,
};
pub use chessboard::Chessboard;
pub use detection::{Detection, MarkerDetector};
pub use dictionary::{DICTIONARY_NAMES, Dictionary, MarkerCells};
