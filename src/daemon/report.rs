//! What the engine tells of its cameras, while it runs and when it ends.

use std::collections::BTreeMap;

use serde::Serialize;

use super::black_box::BlackBoxReport;
use super::hub::{CameraSlot, Hub};
use super::status::{CameraState, CameraStatus};
use gripcast_capture::calibration::RigFile;
use gripcast_capture::camera::{CameraCounters, Health};
use gripcast_dataset::Outcome;
use gripcast_imaging::Role;
use gripcast_session::Summary;

/// Why the engine ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// The operator quit.
    Quit,
    /// The script ran to its end.
    ScriptDone,
    /// Ctrl-C.
    Interrupted,
    /// Asked to end by the system (SIGTERM, closed terminal).
    Terminated,
}

/// What a camera delivered.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraReport {
    /// USB product string.
    pub product: String,
    /// USB serial.
    pub serial: String,
    /// What was counted.
    #[serde(flatten)]
    pub counters: CameraCounters,
    /// Frames that arrived while the decoder was busy with the one before.
    pub not_decoded: u64,
    /// Measured frame rate at the end, 1/s.
    pub measured_fps: f64,
    /// Wishes of the rig file that the camera did not follow.
    pub warnings: Vec<String>,
}

/// What inference did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PredictionReport {
    /// Model name.
    pub model: Option<String>,
    /// Predictions made.
    pub predictions: u64,
    /// Predictions that failed.
    pub failures: u64,
    /// Camera frame to prediction, median, ms.
    pub latency_p50_ms: Option<f64>,
    /// Camera frame to prediction, 99th percentile, ms.
    pub latency_p99_ms: Option<f64>,
}

/// A grasp of this session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GraspReport {
    /// Its key.
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
    /// Why it ended.
    pub ended: Ended,
    /// What the session did.
    pub session: Summary,
    /// Grasps of this session that are in the dataset.
    pub grasps: Vec<GraspReport>,
    /// Cameras by role.
    pub cameras: BTreeMap<Role, CameraReport>,
    /// Inference.
    pub prediction: PredictionReport,
    /// The black box, where there was one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub black_box: Option<BlackBoxReport>,
}

/// Why a camera's frames cannot be used, for the operator; `None` when they can.
pub(super) fn fault_text(health: &Health, now_ns: u64) -> Option<String> {
    let since_s = |since_ns: &u64| now_ns.saturating_sub(*since_ns) as f64 * 1e-9;
    match health {
        Health::Live => None,
        Health::Opening => Some("not open yet".into()),
        Health::Silent { since_ns } => Some(format!("silent for {:.1} s", since_s(since_ns))),
        Health::Frozen { since_ns } => Some(format!("image frozen for {:.1} s", since_s(since_ns))),
        Health::Lost { reason } => Some(format!("lost: {reason}")),
        Health::Ended => Some("the recording has ended".into()),
    }
}

fn camera_state(health: &Health, now_ns: u64) -> CameraState {
    let since_s = |since_ns: &u64| now_ns.saturating_sub(*since_ns) as f64 * 1e-9;
    match health {
        Health::Opening => CameraState::Opening,
        Health::Live => CameraState::Live,
        Health::Silent { since_ns } => CameraState::Silent {
            for_s: since_s(since_ns),
        },
        Health::Frozen { since_ns } => CameraState::Frozen {
            for_s: since_s(since_ns),
        },
        Health::Lost { reason } => CameraState::Lost {
            reason: reason.clone(),
        },
        Health::Ended => CameraState::Ended,
    }
}

pub(super) fn camera_status(slot: &CameraSlot, rig: &RigFile, now_ns: u64) -> CameraStatus {
    let role = slot.role();
    let newest_ns = slot.newest_time_ns();
    let report = camera_report(slot, rig);
    slot.facts(|facts| CameraStatus {
        role,
        product: report.product,
        serial: report.serial,
        port: facts
            .info
            .as_ref()
            .map(|info| info.identity.port.clone())
            .unwrap_or_default(),
        state: camera_state(&facts.health, now_ns),
        measured_fps: report.measured_fps,
        nominal_fps: rig.cameras.get(&role).map_or(0.0, |camera| camera.fps),
        frame_age_ms: newest_ns.map(|t| now_ns.saturating_sub(t) as f64 * 1e-6),
        counters: report.counters,
        markers: None,
    })
}

/// Health and counters of all cameras by role, for the black box.
pub(super) fn cameras_note(hub: &Hub, rig: &RigFile, now_ns: u64) -> serde_json::Value {
    let note = |slot: &CameraSlot| {
        let fault = slot.facts(|facts| fault_text(&facts.health, now_ns));
        let newest_ns = slot.newest_time_ns();
        serde_json::json!({
            "state": if fault.is_none() { "live" } else { "fault" },
            "fault": fault,
            "frame_age_ms": newest_ns.map(|t| now_ns.saturating_sub(t) as f64 * 1e-6),
            "report": camera_report(slot, rig),
        })
    };
    hub.slots()
        .map(|slot| (slot.role().name().to_owned(), note(slot)))
        .collect::<serde_json::Map<_, _>>()
        .into()
}

pub(super) fn camera_report(slot: &CameraSlot, rig: &RigFile) -> CameraReport {
    let config = rig.cameras.get(&slot.role());
    slot.facts(|facts| {
        let identity = facts.info.as_ref().map(|info| &info.identity);
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
                damaged: facts.counters.damaged + facts.damaged_when_decoded,
                ..facts.counters
            },
            not_decoded: facts.not_decoded,
            measured_fps: facts.measured_fps,
            warnings: facts.warnings.clone(),
        }
    })
}
