//! Input and result of the gripper calibration.

use glam::DVec3;

use crate::{BoardFile, Body, Detection};

/// An image of the gripper.
#[derive(Clone, Debug)]
pub struct GripperImage {
    /// Display name.
    pub name: String,
    /// Detected markers with refined corners.
    pub detections: Vec<Detection>,
    /// Whether the fingers are closed: the gel faces touch and the opening is 0.
    pub closed: bool,
}

/// Source of a degree of freedom of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameSource {
    /// The fingers: their motion, or images with closed fingers.
    Fingers,
    /// The board file.
    Description,
    /// None: there are no markers on the fingers.
    Nothing,
}

/// Calibration state of a marker.
#[derive(Clone, Debug, PartialEq)]
pub enum MarkerState {
    /// Calibrated.
    Calibrated,
    /// Kept at its nominal pose, for this reason.
    Nominal(&'static str),
    /// Moved during the image sequence.
    Loose {
        /// Images before and after the move, translation (m) and rotation (rad); none if it moved
        /// more than once.
        moved: Option<([String; 2], f64, f64)>,
    },
}

/// A marker of the calibrated board.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedMarker {
    /// Id in the dictionary.
    pub id: u32,
    /// Body that carries the marker.
    pub body: Body,
    /// Calibration state.
    pub state: MarkerState,
    /// Number of images with inlier observations.
    pub images: usize,
    /// Number of images with outlier observations.
    pub outliers: usize,
    /// Translation from the nominal to the calibrated position along the gripper's axes, m.
    pub shift_m: DVec3,
    /// Rotation between nominal and calibrated orientation, rad.
    pub rotation_rad: f64,
    /// Covariance of [δt, δθ] of `t_body_marker`, m and rad along the gripper's axes, in an exact
    /// frame; none for a marker that was not calibrated.
    pub covariance: Option<[[f64; 6]; 6]>,
    /// RMS reprojection error, px.
    pub rms_px: Option<f64>,
    /// Leave-one-out RMS reprojection error, px.
    pub left_out_rms_px: Option<f64>,
}

impl CalibratedMarker {
    /// Standard deviations of position (m) and orientation (rad), over all directions.
    #[must_use]
    pub fn sigma(&self) -> Option<(f64, f64)> {
        let c = self.covariance?;
        let root = |axes: std::ops::Range<usize>| axes.map(|i| c[i][i]).sum::<f64>().sqrt();
        Some((root(0..3), root(3..6)))
    }
}

/// Result of the gripper calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct GripperCalibration {
    /// Board with the calibrated marker poses.
    pub board: BoardFile,
    /// The markers in the order of the nominal board.
    pub markers: Vec<CalibratedMarker>,
    /// Number of images used.
    pub images: usize,
    /// RMS reprojection error, px.
    pub rms_px: f64,
    /// The same with the nominal marker poses.
    pub described_rms_px: Option<f64>,
    /// RMS reprojection error of every fifth image, calibrated with the others, px.
    pub holdout_rms_px: Option<f64>,
    /// Standard deviation of one corner coordinate assumed by the covariances, px.
    pub corner_sigma_px: f64,
    /// Minimum and maximum opening, m; none without markers on the fingers.
    pub openings_m: Option<[f64; 2]>,
    /// Source of the x direction.
    pub x_from: FrameSource,
    /// Angle between the sliding direction and the nominal x axis, and its standard deviation, rad.
    pub line_off_rad: Option<(f64, f64)>,
    /// Source of the opening's zero.
    pub zero_from: FrameSource,
    /// Standard deviation of the frame's origin over all directions, m.
    pub frame_sigma_m: Option<f64>,
    /// Standard deviation of the frame's orientation about its least certain axis, rad.
    pub frame_sigma_rad: Option<f64>,
    /// Names of excluded images, with the reason.
    pub left_out: Vec<(String, String)>,
    /// Notes for the user.
    pub notes: Vec<String>,
}
