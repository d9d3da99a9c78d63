//! What a calibration of the gripper's markers takes and gives.

use glam::DVec3;

use crate::{BoardFile, Detection, Part};

/// An image of the gripper.
#[derive(Clone, Debug)]
pub struct GripperImage {
    /// What people call it.
    pub name: String,
    /// The markers in it, refined.
    pub detections: Vec<Detection>,
    /// The fingers are closed: the gel faces touch, the opening is 0.
    pub closed: bool,
}

/// What a freedom of the frame comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameSource {
    /// The fingers: their motion, or images with closed fingers.
    Fingers,
    /// The description of the tags.
    Description,
    /// Nothing: there are no markers on fingers.
    Nothing,
}

/// How a marker was found.
#[derive(Clone, Debug, PartialEq)]
pub enum MarkerState {
    /// It was calibrated.
    Calibrated,
    /// It stays where it is described; the reason.
    AsDescribed(&'static str),
    /// It did not stay in its place during the images.
    Loose {
        /// The images between which it moved, by how much (m, rad); none if it moved more than
        /// once.
        moved: Option<([String; 2], f64, f64)>,
    },
}

/// A marker of the calibrated board.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedMarker {
    /// Its number in the dictionary.
    pub id: u32,
    /// What it is fixed to.
    pub part: Part,
    /// How it was found.
    pub state: MarkerState,
    /// Images that it was calibrated with.
    pub images: usize,
    /// Images in which it was an outlier.
    pub outliers: usize,
    /// From where it is described to where it is, along the gripper's axes, m.
    pub shift_m: DVec3,
    /// The turn between both, rad.
    pub turn_rad: f64,
    /// Covariance of [δt, δθ] of `t_part_marker`, m and rad along the gripper's axes, the frame
    /// taken as exact; none for a marker that was not calibrated.
    pub covariance: Option<[[f64; 6]; 6]>,
    /// Root mean square reprojection error, px.
    pub rms_px: Option<f64>,
    /// The same where the images are solved without it.
    pub left_out_rms_px: Option<f64>,
}

impl CalibratedMarker {
    /// Standard deviations of its place (m) and its turn (rad), over all directions.
    #[must_use]
    pub fn sigma(&self) -> Option<(f64, f64)> {
        let c = self.covariance?;
        let root = |axes: std::ops::Range<usize>| axes.map(|i| c[i][i]).sum::<f64>().sqrt();
        Some((root(0..3), root(3..6)))
    }
}

/// A calibrated gripper.
#[derive(Clone, Debug, PartialEq)]
pub struct GripperCalibration {
    /// The markers where they are, under the ids of the description.
    pub board: BoardFile,
    /// The markers in the order of the description.
    pub markers: Vec<CalibratedMarker>,
    /// Images that took part.
    pub images: usize,
    /// Root mean square reprojection error, px.
    pub rms_px: f64,
    /// That of the same images with the markers where they are described.
    pub described_rms_px: Option<f64>,
    /// That of every fifth image where the others calibrate.
    pub holdout_rms_px: Option<f64>,
    /// Standard deviation of one coordinate of a corner that the covariances assume, px.
    pub corner_sigma_px: f64,
    /// Smallest and largest opening, m; none without markers on the fingers.
    pub openings_m: Option<[f64; 2]>,
    /// What the direction of x comes from.
    pub x_from: FrameSource,
    /// Angle between the fingers' line and the described x axis, with its deviation, rad.
    pub line_off_rad: Option<(f64, f64)>,
    /// What the opening's zero comes from.
    pub zero_from: FrameSource,
    /// Estimated standard deviation of the frame's origin, over all directions, m.
    pub frame_sigma_m: Option<f64>,
    /// Estimated standard deviation of the frame's direction about its worst axis, rad.
    pub frame_sigma_rad: Option<f64>,
    /// Images that took no part, with the reason.
    pub left_out: Vec<(String, String)>,
    /// What a person should know.
    pub notes: Vec<String>,
}
