//! Pictures of printed markers with known poses: the test bed of the whole area.

mod degrade;
mod picture;
mod scene;
mod surface;

pub use degrade::PictureConditions;
pub use picture::{Placed, SyntheticPicture, render, render_board};
pub use scene::{GraspScene, gripper_markers, ring_board, test_camera};
