//! Snapshot of the running engine, shown by the screens, served by the API and read back by
//! `collect --attach`.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use image::RgbImage;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::black_box::BlackBoxStatus;
use gripcast_capture::camera::{CameraCounters, monotonic_ns};
use gripcast_dataset::PredictionRecord;
use gripcast_imaging::Role;
use gripcast_nn::predict::PredictedLabel;
use gripcast_session::{GuardLimits, Labels, OutcomeCounts, Session, SessionView};

/// Snapshot of the engine.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct EngineStatus {
    /// Dataset name.
    pub dataset: String,
    /// Rig id.
    pub rig: String,
    /// `CLOCK_MONOTONIC` of this snapshot, ms. A sender that measures the time since it arrived
    /// knows the time at which it sends a command on this clock.
    pub monotonic_ms: u64,
    /// Local wall clock, `HH:MM:SS`.
    pub clock: String,
    /// Free space on the dataset's disk, bytes.
    pub disk_free_bytes: Option<u64>,
    /// The black box, if enabled.
    pub black_box: Option<BlackBoxStatus>,
    /// State of the session.
    pub session: SessionView,
    /// Cameras, in the order of [`Role::ALL`].
    pub cameras: Vec<CameraStatus>,
    /// Newest prediction; `None` before the initial frame or without a model.
    pub prediction: Option<PredictionStatus>,
    /// Reason why there is no prediction.
    pub no_prediction_reason: Option<String>,
    /// Mean absolute difference of each gel to the initial frame, grey levels (0 to 255).
    pub contact: BTreeMap<Role, f64>,
    /// Preview images, which the API sends separately. Tactile cameras show the difference to the
    /// initial frame (grey = no change) once there is one.
    #[serde(skip)]
    pub previews: BTreeMap<Role, Preview>,
}

impl EngineStatus {
    /// Returns the status before the engine's first update.
    pub fn starting(dataset: &str, rig: &str, labels: Labels) -> Self {
        let session = Session::new(GuardLimits::default(), labels, OutcomeCounts::new(), None);
        Self {
            dataset: dataset.to_owned(),
            rig: rig.to_owned(),
            monotonic_ms: monotonic_ns() / 1_000_000,
            clock: String::new(),
            disk_free_bytes: None,
            black_box: None,
            session: session.view(0),
            cameras: Vec::new(),
            prediction: None,
            no_prediction_reason: None,
            contact: BTreeMap::new(),
            previews: BTreeMap::new(),
        }
    }
}

/// A preview image.
#[derive(Clone, Debug)]
pub struct Preview {
    /// RGB image, at most 320×240.
    pub image: Arc<RgbImage>,
    /// Whether the image is a tactile difference.
    pub is_difference: bool,
}

/// The newest live prediction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PredictionStatus {
    /// The prediction, with the keys of `PredictionRecord`; its probability is smoothed over time.
    // The schema of the record does not allow further keys.
    #[serde(flatten)]
    #[schema(value_type = Object)]
    pub record: PredictionRecord,
    /// PredictedLabel, regardless of the frame's age.
    pub verdict: PredictedLabel,
    /// Whether the model is a heuristic rather than trained.
    pub heuristic: bool,
    /// Current age of the tactile frame, ms.
    pub frame_age_ms: f64,
    /// Driver time of the tactile frame, ns; not serialised.
    #[serde(skip)]
    pub frame_time_ns: u64,
}

impl PredictionStatus {
    /// Creates the status of a prediction on current frames.
    pub fn new(record: PredictionRecord, heuristic: bool) -> Self {
        Self {
            verdict: verdict_of(&record),
            record,
            heuristic,
            frame_age_ms: 0.0,
            frame_time_ns: 0,
        }
    }
}

/// Returns the verdict of a prediction.
pub fn verdict_of(record: &PredictionRecord) -> PredictedLabel {
    PredictedLabel::new(record.p_stable, record.threshold, record.ood_score)
}

/// State of a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum CameraState {
    /// Being opened for the first time.
    Opening,
    /// Frames arrive.
    Live,
    /// No frames arrive, but the device is still present.
    Silent {
        /// Seconds since the last frame.
        for_s: f64,
    },
    /// Frames arrive but the image does not change.
    Frozen {
        /// Seconds since the last change.
        for_s: f64,
    },
    /// Unplugged or not accessible; reopened automatically.
    Lost {
        /// Error of the last attempt to open it.
        reason: String,
    },
    /// A recorded stream has ended.
    Ended,
}

impl CameraState {
    /// Returns the state as one word.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Opening => "opening",
            Self::Live => "live",
            Self::Silent { .. } => "silent",
            Self::Frozen { .. } => "frozen",
            Self::Lost { .. } => "lost",
            Self::Ended => "ended",
        }
    }

    /// Returns how long the camera has been silent or frozen, s.
    pub fn since_s(&self) -> Option<f64> {
        match self {
            Self::Silent { for_s } | Self::Frozen { for_s } => Some(*for_s),
            _ => None,
        }
    }

    /// Returns whether frames of the camera can be used.
    pub fn is_live(&self) -> bool {
        matches!(self, Self::Live)
    }
}

/// Whether sheet and tags are detected in a frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct MarkerStatus {
    /// Whether both are detected.
    pub ok: bool,
    /// Number of markers and error, or the reason for the failure.
    pub text: String,
}

/// One camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CameraStatus {
    /// Role.
    pub role: Role,
    /// Product string.
    pub product: String,
    /// Serial number, or empty.
    pub serial: String,
    /// Port path.
    pub port: String,
    /// State.
    #[serde(flatten)]
    pub state: CameraState,
    /// Measured frame rate over the last seconds, 1/s.
    pub measured_fps: f64,
    /// Nominal frame rate, 1/s.
    pub nominal_fps: f64,
    /// Age of the newest frame, ms.
    pub frame_age_ms: Option<f64>,
    /// Counters.
    #[serde(flatten)]
    pub counters: CameraCounters,
    /// Marker detection in the newest frame; `None` for cameras without detection.
    pub markers: Option<MarkerStatus>,
}

/// Returns the free space of the disk of `path`, bytes.
pub(crate) fn disk_free_bytes(path: &Path) -> Option<u64> {
    let disk = rustix::fs::statvfs(path).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `collect --attach` reads back everything but the images.
    #[test]
    fn status_survives_json_round_trip() {
        let record = PredictionRecord {
            p_stable: 0.81,
            ood_score: Some(0.5),
            threshold: 0.5,
            model_sha256: "0".repeat(64),
            model: "m".into(),
            latency_ms: 12.0,
            engine_ms: 3.0,
        };
        let camera = |role, state| CameraStatus {
            role,
            product: "GelSight".into(),
            serial: String::new(),
            port: "3-2".into(),
            state,
            measured_fps: 24.9,
            nominal_fps: 25.0,
            frame_age_ms: None,
            counters: CameraCounters::default(),
            markers: Some(MarkerStatus {
                ok: true,
                text: "sheet 13".into(),
            }),
        };
        let status = EngineStatus {
            cameras: vec![
                camera(Role::Left, CameraState::Silent { for_s: 1.5 }),
                camera(Role::Right, CameraState::Live),
            ],
            prediction: Some(PredictionStatus::new(record, true)),
            contact: BTreeMap::from([(Role::Left, 8.5)]),
            ..EngineStatus::starting("d", "bench", Labels::default())
        };
        let json = serde_json::to_value(&status).unwrap();
        let camera = &json["cameras"][0];
        assert_eq!(
            (&camera["state"], &camera["for_s"]),
            (&"silent".into(), &1.5.into())
        );
        assert_eq!(camera["received"], 0);
        assert_eq!(json["prediction"]["verdict"], "stable");
        assert_eq!(json["prediction"]["model"], "m");
        assert_eq!(json["contact"]["left"], 8.5);
        assert!(json.get("previews").is_none());
        let back: EngineStatus = serde_json::from_value(json).unwrap();
        assert_eq!(back.session, status.session);
        assert_eq!(back.cameras, status.cameras);
        assert_eq!(back.prediction, status.prediction);
        assert_eq!(back.contact, status.contact);
    }
}
