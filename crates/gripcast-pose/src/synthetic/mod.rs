//! Images of printed markers with known poses: the test bed of the whole area.

mod degrade;
mod marker_image;
mod scene;
mod surface;

pub use degrade::ImageConditions;
pub use marker_image::{Placed, SyntheticImage, render, render_board};
pub use scene::{GraspScene, gripper_markers, ring_board, test_camera};
