//! What carries the markers.

use glam::DVec3;

/// What a board is fixed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// The table or the sheet that the object stands on: the object's frame.
    Object,
    /// The gripper's body: the gripper's frame.
    Body,
    /// The left finger, which moves with the opening: the gripper's frame at opening 0.
    FingerLeft,
    /// The right finger.
    FingerRight,
}

/// One marker.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardMarker {
    /// Its number in the dictionary.
    pub id: u32,
    /// What it is fixed to.
    pub part: Part,
    /// Outer corners of its black border in the part's frame, m: top left, top right, bottom
    /// right, bottom left.
    pub corners_m: [DVec3; 4],
}

/// Markers of one dictionary with known places.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    /// Name, as people call it.
    pub name: String,
    /// Name of the dictionary, such as `DICT_6X6_250` or `36h11`.
    pub dictionary: String,
    /// The markers; every id once.
    pub markers: Vec<BoardMarker>,
}
