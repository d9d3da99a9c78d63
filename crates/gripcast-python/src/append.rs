//! Appends grasps to a dataset.

use std::collections::BTreeMap;
use std::mem;
use std::path::Path;
use std::process;
use std::str::FromStr as _;

use jiff::Timestamp;
use numpy::{PyArrayDyn, PyArrayMethods as _};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{depth_counts, image};
use super::failure::Outcome;
use super::grasp_record::{gel_of, role_of};
use super::placement::check;
use super::pose::Pose;
use super::predictor::Prediction;
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_base::number::NumberRange;
use gripcast_dataset::{
    CapturedCamera, DatasetWriter, FieldArray, GraspMeta, GraspRecord, Outcome as Label,
    PoseRecord, PredictionRecord, Stage, StageCapture,
};
use gripcast_geometry::GraspGeometry;
use gripcast_imaging::{CropProfile, Frame, PixelFormat, Role};

/// Trigger and product of images that a program gave.
const SOURCE: &str = "python";
/// Frame of a gripper pose.
const POSE_FRAME: &str = "t_object_gripper";

/// The writer of a dataset, opened when it is needed. It holds the dataset's lock.
#[derive(Default)]
pub(crate) struct Writer(Option<(u32, DatasetWriter)>);

impl Writer {
    /// The writer of this process.
    fn open(&mut self, path: &Path) -> Result<&mut DatasetWriter> {
        let here = process::id();
        if self.0.as_ref().is_some_and(|(owner, _)| *owner != here) {
            self.close();
        }
        let (_, writer) = match self.0.take() {
            Some(open) => self.0.insert(open),
            None => self.0.insert((here, DatasetWriter::open(path)?.0)),
        };
        Ok(writer)
    }

    /// Writes the index and releases the lock.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, …: the index is out of date, the grasps are safe.
    pub(crate) fn finish(&mut self) -> Result<()> {
        let here = process::id();
        let flushed = match &mut self.0 {
            Some((owner, writer)) if *owner == here => writer.flush_index(),
            _ => Ok(()),
        };
        self.close();
        flushed
    }

    fn close(&mut self) {
        if let Some((owner, writer)) = self.0.take()
            && owner != process::id()
        {
            // The lock is the parent's, and so is the index.
            mem::forget(writer);
        }
    }

    /// Saves a grasp; it is durable when this returns.
    pub(crate) fn append(&mut self, path: &Path, new: NewGrasp) -> Result<GraspRecord> {
        let writer = self.open(path)?;
        let rig = writer.descriptor().rig.clone();
        let pending = writer.save_initial(&new.initial, Vec::new())?;
        let meta = GraspMeta { rig, ..new.meta };
        let saved = writer.save_grasp(&pending, &new.grasp, meta);
        if saved.is_err() {
            // The caller has the images; nobody completes the pending initial frame.
            let _ = writer.discard_initial(&pending);
        }
        saved
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.close();
    }
}

/// A grasp to be saved.
pub(crate) struct NewGrasp {
    initial: StageCapture,
    grasp: StageCapture,
    meta: GraspMeta,
}

/// Arguments of `Dataset.append_grasp`.
pub(crate) struct Arguments<'a, 'py> {
    pub(crate) object: &'a str,
    pub(crate) initial: &'a Bound<'py, PyDict>,
    pub(crate) grasp: &'a Bound<'py, PyDict>,
    pub(crate) outcome: &'a str,
    pub(crate) scene: &'a str,
    pub(crate) operator: &'a str,
    pub(crate) note: &'a str,
    pub(crate) t_object_gripper: Option<&'a Pose>,
    pub(crate) prediction: Option<&'a Prediction>,
    pub(crate) markers: Option<&'a Bound<'py, PyDict>>,
    pub(crate) m_per_px: Option<f64>,
    pub(crate) depth_unit_m: f64,
    pub(crate) crop_profile: &'a str,
    pub(crate) captured_at: Option<&'a Bound<'py, PyAny>>,
}

impl Arguments<'_, '_> {
    /// Checks and copies everything.
    pub(crate) fn read(&self) -> Outcome<NewGrasp> {
        check(
            "depth_unit_m",
            Some(self.depth_unit_m),
            NumberRange::POSITIVE,
        )?;
        check("m_per_px", self.m_per_px, NumberRange::POSITIVE)?;
        let outcome = Label::by_name(self.outcome).ok_or_else(|| {
            unknown_name("outcome", self.outcome, &["stable", "slip", "unlabelled"])
        })?;
        let captured_at = self.captured_at.map(time).transpose()?;
        let captured_at = captured_at.unwrap_or_else(Timestamp::now);
        let stage = |stage, given| self.stage(stage, given, captured_at);
        let (initial, mut grasp) = (
            stage(Stage::Initial, self.initial)?,
            stage(Stage::Grasp, self.grasp)?,
        );
        grasp.fields = self.fields()?;
        grasp.pose = self.t_object_gripper.map(|pose| {
            let (t_m, (w, x, y, z)) = (pose.0.translation_m, pose.q_wxyz());
            Box::new(PoseRecord {
                t_m: t_m.to_array(),
                q_wxyz: [w, x, y, z],
                frame: POSE_FRAME.to_owned(),
                covariance: None,
                reprojection_px: None,
                corrected_by_hand: false,
                quality: None,
            })
        });
        Ok(NewGrasp {
            initial,
            grasp,
            meta: GraspMeta {
                object: self.object.parse()?,
                scene: self.scene.parse()?,
                operator: self.operator.parse()?,
                outcome,
                prediction: self.prediction.map(prediction_record),
                note: self.note.to_owned(),
                ..GraspMeta::default()
            },
        })
    }

    fn stage(
        &self,
        stage: Stage,
        given: &Bound<'_, PyDict>,
        captured_at: Timestamp,
    ) -> Outcome<StageCapture> {
        let crop = CropProfile::by_name(self.crop_profile)?;
        let time_ns = monotonic_ns();
        let mut cameras = BTreeMap::new();
        for (key, value) in given {
            let key: String = key.extract()?;
            let role = role_of(&key)?;
            let name = format!("{}[{key:?}]", stage.name());
            let is_depth = role == Role::Depth;
            if is_depth && stage == Stage::Initial {
                let error = Error::usage(format!("`{name}`: depth is stored with the grasp only"));
                return Err(error.remedy("put it into `grasp`").into());
            }
            let (format, width, height, data) = if is_depth {
                let depth = depth_counts(&value, &name)?;
                let bytes = depth.as_raw().iter().flat_map(|c| c.to_le_bytes());
                (
                    PixelFormat::Z16,
                    depth.width(),
                    depth.height(),
                    bytes.collect(),
                )
            } else {
                let image = image(&value, &name)?;
                (
                    PixelFormat::Rgb,
                    image.width(),
                    image.height(),
                    image.into_raw(),
                )
            };
            let camera = CapturedCamera {
                frame: Frame {
                    format,
                    width,
                    height,
                    data: data.into(),
                    sequence: 0,
                    driver_time_ns: time_ns,
                    received_ns: time_ns,
                },
                product: SOURCE.to_owned(),
                serial: String::new(),
                interface: 0,
                port: String::new(),
                controls: BTreeMap::new(),
                age_ms: 0.0,
                crop_profile: role.is_tactile().then(|| crop.name().to_owned()),
                depth_unit_m: is_depth.then_some(self.depth_unit_m),
            };
            cameras.insert(role, camera);
        }
        if cameras.is_empty() {
            let error = Error::usage(format!("`{}` has no images", stage.name()));
            return Err(error.remedy("pass a dict such as {\"left\": image}").into());
        }
        Ok(StageCapture {
            captured_at,
            trigger_time_ns: time_ns,
            trigger: SOURCE.to_owned(),
            cameras,
            pre_grasp_frames: Vec::new(),
            fields: Vec::new(),
            shear: BTreeMap::new(),
            force: BTreeMap::new(),
            pose: None,
            truth: None,
        })
    }

    /// Gel markers of the grasp frame.
    fn fields(&self) -> Outcome<Vec<FieldArray>> {
        let mut fields = Vec::new();
        let Some(markers) = self.markers else {
            return Ok(fields);
        };
        let m_per_px = self.m_per_px.ok_or_else(|| {
            Error::usage("`markers` need the scale of the image").remedy("pass `m_per_px`")
        })?;
        for (key, value) in markers {
            let key: String = key.extract()?;
            let role = gel_of(&key)?;
            let (values, shape) = marker_values(&value, &format!("markers[{key:?}]"))?;
            fields.push(FieldArray::markers(role, values, shape, m_per_px)?);
        }
        Ok(fields)
    }
}

/// Rows × columns × 5 values; NaN where there is no marker.
fn marker_values(value: &Bound<'_, PyAny>, name: &str) -> Outcome<(Vec<f32>, [usize; 3])> {
    let py = value.py();
    let wrong = || {
        Error::input(format!(
            "`{name}` must be a numpy array, float32 of shape (rows, columns, 5)"
        ))
    };
    let array = py
        .import("numpy")?
        .call_method1("asarray", (value, "float32"));
    let array = array.map_err(|_| wrong())?;
    let shape: Vec<usize> = array.getattr("shape")?.extract()?;
    let &[rows, columns, 5] = shape.as_slice() else {
        return Err(wrong().into());
    };
    let array = array.cast::<PyArrayDyn<f32>>().map_err(|_| wrong())?;
    let values: Vec<f32> = array.readonly().as_array().iter().copied().collect();
    if values.iter().any(|value| value.is_infinite()) {
        return Err(Error::input(format!("`{name}` must be finite or NaN, found infinity")).into());
    }
    Ok((values, [rows, columns, 5]))
}

/// An RFC 3339 text, or a `datetime` with a time zone.
fn time(value: &Bound<'_, PyAny>) -> Outcome<Timestamp> {
    let text = match value.extract::<String>() {
        Ok(text) => text,
        Err(_) => value.call_method0("isoformat")?.extract()?,
    };
    let parsed = Timestamp::from_str(&text);
    Ok(parsed.map_err(|_| {
        Error::usage(format!(
            "`captured_at` must be a time with its zone, as 2026-11-20T10:15:03Z, found {text:?}"
        ))
    })?)
}

/// `CLOCK_MONOTONIC`, the clock of drivers, ns.
fn monotonic_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

fn prediction_record(prediction: &Prediction) -> PredictionRecord {
    PredictionRecord {
        p_stable: prediction.p_stable,
        ood_score: prediction.ood_score,
        unsure_reason: prediction.unsure_reason.clone(),
        adapted: None,
        set: None,
        threshold: prediction.threshold,
        inputs: prediction.inputs.clone(),
        geometry: prediction.geometry_m.map(GraspGeometry::from_array),
        model_sha256: prediction.model_sha256.clone(),
        model: prediction.model.clone(),
        latency_ms: prediction.engine_ms,
        engine_ms: prediction.engine_ms,
    }
}
