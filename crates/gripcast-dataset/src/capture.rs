//! Captured frames and metadata, the input of the writer.

use std::collections::BTreeMap;

use jiff::Timestamp;

use super::digest::FileDigest;
use super::digest::digest;
use super::encode::encode;
use super::field::{FieldArray, FieldRecord};
use super::grasp::{
    BoardKeys, CameraRecord, Outcome, OverriddenGuard, PoseRecord, SimulatedTruth, StageRecord,
};
use super::layout::{Stage, image_name, pre_grasp_name};
use super::prediction::PredictionRecord;
use gripcast_base::error::Result;
use gripcast_base::files::{ContentKey, FieldName, FileName, Label, ObjectName};
use gripcast_imaging::{Frame, JpegRepairs, Role, valid_depth_fraction};
use gripcast_shear::{FingerForce, ShearSummary};

/// One camera's frame with its stored metadata.
#[derive(Clone, Debug, PartialEq)]
pub struct CapturedCamera {
    /// The frame as sent.
    pub frame: Frame,
    /// USB product string.
    pub product: String,
    /// USB serial.
    pub serial: String,
    /// USB video-control interface.
    pub interface: u8,
    /// USB port path.
    pub port: String,
    /// Control values read back from the camera.
    pub controls: BTreeMap<String, i64>,
    /// Age of the frame at the trigger, ms.
    pub age_ms: f64,
    /// Name of the crop profile; tactile cameras only.
    pub crop_profile: Option<String>,
    /// Metres per count; depth cameras only.
    pub depth_unit_m: Option<f64>,
}

/// The frames of one trigger. Depth is stored with the grasp only.
#[derive(Clone, Debug, PartialEq)]
pub struct StageCapture {
    /// Wall clock at the trigger.
    pub captured_at: Timestamp,
    /// `CLOCK_MONOTONIC` at the trigger, ns.
    pub trigger_time_ns: u64,
    /// `keyboard`, `pedal`, `script`, …
    pub trigger: String,
    /// Cameras by role.
    pub cameras: BTreeMap<Role, CapturedCamera>,
    /// Frames of the external camera from before the gripper closed, by time; stored with the
    /// grasp.
    pub pre_grasp_frames: Vec<CapturedCamera>,
    /// Field arrays of the gels.
    pub fields: Vec<FieldArray>,
    /// Shear by gel. One with a number that is not finite is not stored: it must not stop the save.
    pub shear: BTreeMap<Role, ShearSummary>,
    /// Force by gel. One with a number that is not finite is not stored.
    pub force: BTreeMap<Role, FingerForce>,
    /// Gripper pose in the object's frame, where the pre-grasp frames give one.
    pub pose: Option<Box<PoseRecord>>,
    /// Ground truth of a virtual rig at these frames.
    pub truth: Option<Box<SimulatedTruth>>,
}

/// Metadata of a grasp besides its frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GraspMeta {
    /// Object to grasp.
    pub object: ObjectName,
    /// Scene.
    pub scene: Label,
    /// Operator of the gripper.
    pub operator: Label,
    /// Rig file's id.
    pub rig: String,
    /// Outcome, where it is known before the grasp is saved.
    pub outcome: Outcome,
    /// Marker boards in view of the external camera.
    pub boards: Option<BoardKeys>,
    /// Prediction shown before the lift.
    pub prediction: Option<PredictionRecord>,
    /// Guards overridden at the grasp trigger; those of the initial frame are added.
    pub overridden_guards: Vec<OverriddenGuard>,
    /// Calibration by role, as returned by `DatasetWriter::put_calibration`.
    pub calibration: BTreeMap<Role, ContentKey>,
    /// Free text.
    pub note: String,
}

/// A capture as it is stored.
pub(super) struct EncodedStage {
    pub(super) record: StageRecord,
    /// Pre-grasp frames; only with the grasp.
    pub(super) pre_grasp_frames: Vec<CameraRecord>,
    /// Contents by file name.
    pub(super) contents: BTreeMap<FileName, Vec<u8>>,
    /// Digests by file name.
    pub(super) files: BTreeMap<FileName, FileDigest>,
}

impl StageCapture {
    /// Encodes the frames that are stored at `stage`.
    ///
    /// # Errors
    /// `Input` naming the camera whose frame is invalid.
    pub(super) fn encode(&self, stage: Stage) -> Result<EncodedStage> {
        let mut cameras = BTreeMap::new();
        let mut contents = BTreeMap::new();
        let mut files = BTreeMap::new();
        for (&role, camera) in &self.cameras {
            if !stage.stores(role) {
                continue;
            }
            let frame = &camera.frame;
            let file = image_name(stage, role, frame.format);
            let (bytes, repairs) = encode(frame).map_err(|e| e.at(role))?;
            files.insert(file.clone(), digest(&bytes));
            contents.insert(file.clone(), bytes.into_owned());
            cameras.insert(role, camera.record(file, repairs));
        }
        let mut pre_grasp_frames = Vec::new();
        if stage == Stage::Grasp {
            for (number, camera) in self.pre_grasp_frames.iter().enumerate() {
                let file = pre_grasp_name(number, camera.frame.format);
                let (bytes, repairs) = encode(&camera.frame).map_err(|e| e.at(&file))?;
                files.insert(file.clone(), digest(&bytes));
                contents.insert(file.clone(), bytes.into_owned());
                pre_grasp_frames.push(camera.record(file, repairs));
            }
        }
        let mut fields: BTreeMap<Role, BTreeMap<FieldName, FieldRecord>> = BTreeMap::new();
        for field in &self.fields {
            let record = field.record(stage)?;
            let npy = field.values.to_npy();
            files.insert(record.file.clone(), digest(&npy));
            contents.insert(record.file.clone(), npy);
            let of_role = fields.entry(field.role).or_default();
            of_role.insert(field.name.clone(), record);
        }
        Ok(EncodedStage {
            pre_grasp_frames,
            record: StageRecord {
                captured_at: self.captured_at.to_string(),
                trigger_time_ns: self.trigger_time_ns,
                trigger: self.trigger.clone(),
                skew_ms: skew_ms(cameras.values()),
                cameras,
                fields,
                shear: finite(&self.shear, ShearSummary::is_finite),
                force: finite(&self.force, FingerForce::is_finite),
            },
            contents,
            files,
        })
    }
}

impl CapturedCamera {
    fn record(&self, file: FileName, repairs: Option<JpegRepairs>) -> CameraRecord {
        CameraRecord {
            file,
            product: self.product.clone(),
            serial: self.serial.clone(),
            interface: self.interface,
            port: self.port.clone(),
            format: self.frame.format,
            width: self.frame.width,
            height: self.frame.height,
            driver_time_ns: self.frame.driver_time_ns,
            sequence: self.frame.sequence,
            age_ms: self.age_ms,
            controls: self.controls.clone(),
            crop_profile: self.crop_profile.clone(),
            depth_unit_m: self.depth_unit_m,
            valid_fraction: valid_depth_fraction(&self.frame),
            repairs,
        }
    }
}

/// The values without those that JSON cannot hold.
fn finite<T: Copy>(values: &BTreeMap<Role, T>, is_finite: fn(&T) -> bool) -> BTreeMap<Role, T> {
    let finite = values.iter().filter(|(_, value)| is_finite(value));
    finite.map(|(role, value)| (*role, *value)).collect()
}

/// Largest difference between the driver times, ms.
fn skew_ms<'a>(cameras: impl Iterator<Item = &'a CameraRecord> + Clone) -> f64 {
    let times = cameras.map(|camera| camera.driver_time_ns);
    match (times.clone().min(), times.max()) {
        (Some(first), Some(last)) => (last - first) as f64 / 1e6,
        _ => 0.0,
    }
}
