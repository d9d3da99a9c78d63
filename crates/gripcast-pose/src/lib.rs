//! Pose estimation from printed markers: boards, detection, corner refinement, pose solving,
//! calibration, printing.
//!
//! # Frames
//! Marker corners are given in the frame of the rigid [`Body`] that carries them: the object frame
//! for the sheet that the object stands on, the gripper frame for markers on the gripper and its
//! fingers. Corners are listed top left, top right, bottom right, bottom left of the marker read
//! upright from the front. The camera frame is OpenCV's optical frame. Pixel (0, 0) is the centre
//! of the top-left pixel; the wrapper of each detector converts from its own convention.

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
pub mod levels;
pub mod print;
pub mod refine;
#[cfg(test)]
mod refine_test;
pub mod solve;
pub mod synthetic;
mod yaml;

pub use board::{Board, BoardMarker, Body};
pub use board_file::{BoardFile, PrintedSheet};
pub use board_import::{BoardFormat, ImportedBoards, import_aruco_map, import_kalibr, import_ros};
pub use camera_file::{
    CameraFile, CameraFormat, CameraReadOptions, load_intrinsics, require_size, to_opencv, to_ros,
};
pub use chessboard::Chessboard;
pub use detection::{Detection, MarkerDetector};
pub use dictionary::{DICTIONARY_NAMES, Dictionary, MarkerCells};
