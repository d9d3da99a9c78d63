//! Reports of the engine: cameras while it runs, and the closing report.

use std::collections::BTreeMap;

use serde::Serialize;

use super::black_box::BlackBoxReport;
use super::hub::{CameraSlot, Hub};
use super::start_report::StartFinding;
use super::status::CameraStatus;
use gripcast_capture::calibration::RigFile;
use gripcast_capture::camera::CameraCounters;
use gripcast_dataset::Outcome;
use gripcast_imaging::Role;
use gripcast_session::Summary;

/// Reason why the engine ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EndReason {
    /// The operator quit.
    Quit,
    /// The script finished.
    ScriptDone,
    /// Ctrl-C.
    Interrupted,
    /// CommandRequest to end by the system (SIGTERM, closed terminal).
    Terminated,
}

/// Identity and counters of a camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraReport {
    /// USB product string.
    pub product: String,
    /// USB serial.
    pub serial: String,
    /// Counters.
    #[serde(flatten)]
    pub counters: CameraCounters,
    /// Frames skipped because the decoder was busy.
    pub not_decoded: u64,
    /// Measured frame rate at the end, 1/s.
    pub measured_fps: f64,
    /// Settings of the rig file that the camera did not apply.
    pub warnings: Vec<String>,
}

/// Counts and latency of predictions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PredictionReport {
    /// Model name.
    pub model: Option<String>,
    /// Number of predictions.
    pub predictions: u64,
    /// Number of failed predictions.
    pub failures: u64,
    /// Median latency from camera frame to prediction, ms.
    pub latency_p50_ms: Option<f64>,
    /// 99th percentile of the latency, ms.
    pub latency_p99_ms: Option<f64>,
    /// Median time to judge a tactile image, ms.
    pub gel_judge_p50_ms: Option<f64>,
    /// Median time to measure the shear of a tactile image, ms.
    pub shear_p50_ms: Option<f64>,
}

/// Lifts whose frames were to be kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LiftReport {
    /// Lifts stored with their grasps.
    pub stored: u64,
    /// Lifts that could not be stored; the log has the reasons.
    pub failed: u64,
}

/// A grasp of this session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GraspReport {
    /// Grasp id.
    pub id: String,
    /// Object.
    pub object: String,
    /// Outcome at the end.
    pub outcome: Outcome,
    /// Probability predicted before the lift.
    pub p_stable: Option<f64>,
}

/// The closing report of a collection.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CollectReport {
    /// Dataset directory.
    pub dataset: String,
    /// Rig id.
    pub rig: String,
    /// Reason of the end.
    pub ended: EndReason,
    /// Summary of the session.
    pub session: Summary,
    /// What differed from the dataset's earlier grasps.
    pub start_report: Vec<StartFinding>,
    /// Grasps saved in this session.
    pub grasps: Vec<GraspReport>,
    /// Cameras by role.
    pub cameras: BTreeMap<Role, CameraReport>,
    /// Inference.
    pub prediction: PredictionReport,
    /// Lift frames.
    pub lifts: LiftReport,
    /// The black box, if enabled.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub black_box: Option<BlackBoxReport>,
}

pub(super) fn camera_status(slot: &CameraSlot, rig: &RigFile, now_ns: u64) -> CameraStatus {
    let role = slot.role;
    let newest_ns = slot.newest_time_ns();
    let report = camera_report(slot, rig);
    let state = slot.camera_state(now_ns);
    slot.with_info(|info| CameraStatus {
        role,
        product: report.product,
        serial: report.serial,
        port: info
            .stream
            .as_ref()
            .map(|stream| stream.identity.port.clone())
            .unwrap_or_default(),
        state,
        measured_fps: report.measured_fps,
        nominal_fps: rig.cameras.get(&role).map_or(0.0, |camera| camera.fps),
        frame_age_ms: newest_ns.map(|t| now_ns.saturating_sub(t) as f64 * 1e-6),
        counters: report.counters,
        markers: None,
    })
}

/// Returns health and counters of all cameras by role, for the black box.
pub(super) fn cameras_json(hub: &Hub, rig: &RigFile, now_ns: u64) -> serde_json::Value {
    let camera = |slot: &CameraSlot| {
        let state = slot.camera_state(now_ns);
        let newest_ns = slot.newest_time_ns();
        serde_json::json!({
            "state": state.word(),
            "fault": state.fault_text(),
            "frame_age_ms": newest_ns.map(|t| now_ns.saturating_sub(t) as f64 * 1e-6),
            "report": camera_report(slot, rig),
        })
    };
    hub.slots()
        .map(|slot| (slot.role.name().to_owned(), camera(slot)))
        .collect::<serde_json::Map<_, _>>()
        .into()
}

pub(super) fn camera_report(slot: &CameraSlot, rig: &RigFile) -> CameraReport {
    let config = rig.cameras.get(&slot.role);
    slot.with_info(|info| {
        let identity = info.stream.as_ref().map(|stream| &stream.identity);
        CameraReport {
            product: identity.map_or_else(
                || config.map_or_else(String::new, |c| c.product.clone()),
                |i| i.product.clone(),
            ),
            serial: identity.map_or_else(
                || config.and_then(|c| c.serial.clone()).unwrap_or_default(),
                |i| i.serial.clone(),
            ),
            counters: CameraCounters {
                damaged: info.counters.damaged + info.damaged_when_decoded,
                ..info.counters
            },
            not_decoded: info.not_decoded,
            measured_fps: info.measured_fps,
            warnings: info.warnings.clone(),
        }
    })
}
