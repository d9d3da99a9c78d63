//! Contents of `grasp.json`.

use std::collections::BTreeMap;
use std::fmt;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::digest::FileDigest;
use super::field::FieldRecord;
use super::layout::Stage;
use super::lift::LiftRecord;
use super::prediction::{LiftVerdict, PredictionRecord};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{ContentKey, FieldName, FileName, GraspId, Label, ObjectName};
use gripcast_geometry::Pose;
use gripcast_imaging::{JpegRepairs, PixelFormat, Role};
use gripcast_shear::{FingerForce, ShearSummary};

/// Tolerance of a unit quaternion's norm.
const UNIT_TOLERANCE: f64 = 1e-3;
/// The only valid frame of a pose.
const POSE_FRAME: &str = "t_object_gripper";

/// Whether the object stayed in the gripper during the lift.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    ToSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// The object stayed in the gripper.
    Stable,
    /// The object slipped or fell.
    Slip,
    /// Not labelled yet.
    #[default]
    Unlabelled,
}

impl Outcome {
    /// Parses the name of an outcome.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "stable" => Some(Self::Stable),
            "slip" => Some(Self::Slip),
            "unlabelled" => Some(Self::Unlabelled),
            _ => None,
        }
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Stable => "stable",
            Self::Slip => "slip",
            Self::Unlabelled => "unlabelled",
        })
    }
}

/// Record of one grasp; keys are sorted in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspRecord {
    /// Version of the format.
    pub schema: u32,
    /// Key of the grasp; equals the directory's name.
    pub id: GraspId,
    /// Object to grasp.
    pub object: ObjectName,
    /// Scene.
    pub scene: Label,
    /// Operator of the gripper.
    pub operator: Label,
    /// Rig file's id.
    pub rig: String,
    /// `gripcast <version>` that wrote the record.
    pub software: String,
    /// Outcome of the lift.
    pub outcome: Outcome,
    /// Time of the label, RFC 3339 UTC.
    pub labelled_at: Option<String>,
    /// Frames before the gripper closed.
    pub initial: StageRecord,
    /// Frames after the gripper closed, before the lift.
    pub grasp: StageRecord,
    /// Frames of the external camera from before the gripper closed, by time; key `approach`.
    #[serde(rename = "approach", default, skip_serializing_if = "Vec::is_empty")]
    pub pre_grasp_frames: Vec<CameraRecord>,
    /// Gripper pose in the object's frame, where annotated.
    pub pose: Option<PoseRecord>,
    /// Prediction shown at the grasp trigger, before the lift.
    pub prediction: Option<PredictionRecord>,
    /// Guards that refused and were overridden.
    pub overridden_guards: Vec<OverriddenGuard>,
    /// First 12 hex digits of the calibration's sha256, by role; file `calibration/<sha12>.toml`.
    pub calibration: BTreeMap<Role, ContentKey>,
    /// Marker boards in view of the external camera, where known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boards: Option<BoardKeys>,
    /// Frames of the gels after the grasp trigger, where they were kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lift: Option<LiftRecord>,
    /// Verdict in the lift when the grasp was first labelled; absent without a model that gives one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lift_verdict: Option<LiftVerdict>,
    /// Digest of each file of the grasp but the record, by file name.
    pub files: BTreeMap<FileName, FileDigest>,
    /// Free text.
    pub note: String,
    /// Ground truth; virtual rigs only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth: Option<SimulatedTruth>,
}

impl GraspRecord {
    /// Parses a `grasp.json`.
    ///
    /// # Errors
    /// `Input` when it is not a valid record of this version.
    pub fn from_json(bytes: &[u8]) -> Result<Self> {
        super::record_file::from_json(bytes)
    }

    /// Whether a virtual rig took the grasp.
    #[must_use]
    pub fn is_simulated(&self) -> bool {
        self.truth.is_some()
    }

    /// Returns both stages, in the order of the cycle.
    pub fn stages(&self) -> [(Stage, &StageRecord); 2] {
        [(Stage::Initial, &self.initial), (Stage::Grasp, &self.grasp)]
    }

    /// Keys of the files in `calibration/` that the grasp refers to.
    pub fn calibration_keys(&self) -> impl Iterator<Item = &ContentKey> {
        let boards = self.boards.iter().flat_map(|b| [&b.sheet, &b.tags]);
        self.calibration.values().chain(boards)
    }

    /// The frames of a stage.
    #[must_use]
    pub fn stage(&self, stage: Stage) -> &StageRecord {
        match stage {
            Stage::Initial => &self.initial,
            Stage::Grasp => &self.grasp,
        }
    }
}

/// Frames of all cameras at one trigger.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageRecord {
    /// Wall clock at the trigger, RFC 3339 UTC.
    pub captured_at: String,
    /// `CLOCK_MONOTONIC` at the trigger, ns.
    pub trigger_time_ns: u64,
    /// `keyboard`, `pedal`, `script`, …
    pub trigger: String,
    /// Largest difference between the driver times of the cameras, ms.
    pub skew_ms: f64,
    /// Cameras by role.
    pub cameras: BTreeMap<Role, CameraRecord>,
    /// Field arrays by gel and name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub fields: BTreeMap<Role, BTreeMap<FieldName, FieldRecord>>,
    /// Shear by gel, where it was measured.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub shear: BTreeMap<Role, ShearSummary>,
    /// Force by gel, where it was estimated.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub force: BTreeMap<Role, FingerForce>,
}

impl StageRecord {
    /// Names of the files of images and field arrays.
    pub(super) fn files(&self) -> impl Iterator<Item = &FileName> {
        let images = self.cameras.values().map(|camera| &camera.file);
        let fields = self.fields.values().flat_map(BTreeMap::values);
        images.chain(fields.map(|field| &field.file))
    }
}

/// One camera's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraRecord {
    /// File name inside the grasp's directory.
    pub file: FileName,
    /// USB product string.
    pub product: String,
    /// USB serial.
    pub serial: String,
    /// USB video-control interface.
    pub interface: u8,
    /// USB port path at that time.
    pub port: String,
    /// Format as sent by the camera.
    pub format: PixelFormat,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Driver's capture time, `CLOCK_MONOTONIC`, ns.
    pub driver_time_ns: u64,
    /// Driver's frame counter.
    pub sequence: u32,
    /// Age of the frame at the trigger, ms.
    pub age_ms: f64,
    /// Control values read back from the camera (exposure, white balance, gain, …).
    pub controls: BTreeMap<String, i64>,
    /// Name of the crop profile; tactile cameras only.
    pub crop_profile: Option<String>,
    /// Metres per count; depth cameras only.
    pub depth_unit_m: Option<f64>,
    /// Fraction of the pixels that have a depth, 0..1; depth cameras only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub valid_fraction: Option<f64>,
    /// Differences of a stored JPEG from the bytes that the camera sent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repairs: Option<JpegRepairs>,
}

/// Gripper pose in the object's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseRecord {
    /// Translation, m.
    pub t_m: [f64; 3],
    /// Unit quaternion, w ≥ 0.
    pub q_wxyz: [f64; 4],
    /// `t_object_gripper`: maps gripper coordinates into the object frame.
    pub frame: String,
    /// 6×6 covariance (translation m, rotation rad), row-major.
    pub covariance: Option<Vec<f64>>,
    /// RMS reprojection error, px.
    pub reprojection_px: Option<f64>,
    /// Whether a person corrected it; programs never overwrite such a pose.
    #[serde(default)]
    pub corrected_by_hand: bool,
    /// Quality of the estimate; none for a pose entered by hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quality: Option<PoseQuality>,
}

impl PoseRecord {
    /// Returns the pose as a transform with a normalised quaternion.
    ///
    /// # Errors
    /// `Input`: it is in another frame, or its numbers are invalid.
    pub fn t_object_gripper(&self) -> Result<Pose> {
        if self.frame != POSE_FRAME {
            return Err(Error::input(format!(
                "expected a pose in frame `{POSE_FRAME}`, found `{}`",
                self.frame
            )));
        }
        let [w, x, y, z] = self.q_wxyz;
        let rotation = DQuat::from_xyzw(x, y, z, w);
        let is_finite = self.t_m.iter().chain(&self.q_wxyz).all(|n| n.is_finite());
        if !is_finite || (rotation.length() - 1.0).abs() > UNIT_TOLERANCE {
            return Err(Error::input(format!(
                "expected a finite pose with a unit quaternion, found t_m {:?}, q_wxyz {:?}",
                self.t_m, self.q_wxyz
            )));
        }
        let translation_m = DVec3::from_array(self.t_m);
        Ok(Pose::new(rotation.normalize(), translation_m))
    }
}

/// Quality of a pose estimate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseQuality {
    /// Files of the frames used.
    pub frames: Vec<String>,
    /// Detected markers of the sheet and tags of the gripper in the last of them.
    pub markers: [usize; 2],
    /// RMS reprojection error of the gripper's tags, px; that of the sheet is `reprojection_px`.
    pub tags_reprojection_px: f64,
    /// Largest distance of a frame's pose from the estimate, m. Errors common to all frames are
    /// not included.
    pub spread_m: f64,
    /// Largest angle between a frame's pose and the estimate, rad.
    pub spread_rad: f64,
    /// Blur of the markers' edges in the sharpest frame, px.
    pub blur_px: f64,
    /// Distance between the undeformed gel faces, m; none where no finger tag was detected.
    pub opening_m: Option<f64>,
    /// Whether another pose fits nearly as well and no two tags face directions 30° apart.
    pub ambiguous: bool,
    /// Hash of the sheet's board.
    pub sheet: String,
    /// Hash of the tags' board.
    pub tags: String,
    /// Notes for the operator.
    pub notes: Vec<String>,
}

/// Keys of board files in `calibration/`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoardKeys {
    /// Board of the sheet under the object.
    pub sheet: ContentKey,
    /// Board of the gripper's tags.
    pub tags: ContentKey,
}

/// Ground truth of a grasp on the virtual rig, whose frames are rendered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedTruth {
    /// Name of the clip of the simulated grasp.
    #[serde(alias = "film")]
    pub clip: String,
    /// Object: mesh file or `builtin:NAME`.
    pub object: String,
    /// Hash of the object's mesh.
    pub object_sha256: String,
    /// Mass of the object, kg.
    pub mass_kg: f64,
    /// Coulomb friction coefficient between gel and object.
    pub friction: f64,
    /// Simulation outcome: `success`, `slip`, `eject`, …
    pub outcome: String,
    /// Whether the object stays in the gripper during the lift.
    #[serde(alias = "held")]
    pub stable: bool,
    /// Rise of the object, m.
    pub lifted_m: f64,
    /// Gripper pose in the object's frame before the gripper closes.
    pub t_object_gripper_initial: Pose,
    /// Gripper pose in the object's frame at the left sensor's grasp frame.
    pub t_object_gripper: Pose,
    /// Distance between the undeformed gel faces at that frame, m.
    pub opening_m: f64,
    /// Normal force on the left and the right gel at that frame, N.
    pub force_n: [f64; 2],
}

/// A guard violation that the operator overrode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OverriddenGuard {
    /// Name of the guard (`stale_frame`, `skew`, …).
    pub guard: String,
    /// `initial` or `grasp`.
    pub stage: String,
    /// Message of the guard.
    pub reason: String,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    proptest! {
        /// `verify` compares records and index exactly.
        #[test]
        fn floats_round_trip_through_json(value in proptest::num::f64::NORMAL) {
            let text = serde_json::to_string(&value).unwrap();
            let back: f64 = serde_json::from_str(&text).unwrap();
            prop_assert_eq!(back.to_bits(), value.to_bits());
        }
    }
}
