//! Synthetic images of markers with known poses.

mod degrade;
mod marker_image;
mod scene;
mod surface;

pub use degrade::ImageConditions;
pub use marker_image::{PlacedBoard, SyntheticImage, render, render_board};
pub use scene::{GraspScene, gripper_markers, ring_board, test_camera};
