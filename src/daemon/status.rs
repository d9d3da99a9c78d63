//! A snapshot of the running engine, cheap to clone: what the screens draw, the API answers and
//! `collect --attach` reads back.

use std::collections::BTreeMap;
use std::sync::Arc;

use image::RgbImage;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::black_box::BlackBoxStatus;
use gripcast_capture::camera::CameraCounters;
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
    /// Local wall clock, `HH:MM:SS`.
    pub clock: String,
    /// Free space on the dataset's disk, bytes.
    pub disk_free_bytes: Option<u64>,
    /// The black box, where there is one.
    pub black_box: Option<BlackBoxStatus>,
    /// Session.
    pub session: SessionView,
    /// Cameras, in the order of [`Role::ALL`].
    pub cameras: Vec<CameraStatus>,
    /// The newest prediction; `None` before the initial frame or without a model.
    pub prediction: Option<PredictionStatus>,
    /// Why there is no prediction, in a few words.
    pub prediction_absent: Option<String>,
    /// Mean absolute difference of each gel to the initial frame, grey levels of 255.
    pub contact: BTreeMap<Role, f64>,
    /// Small images, which the API sends apart: tactile cameras show the difference to the initial frame (grey = no
    /// change) once there is one, the others what they see.
    #[serde(skip)]
    pub previews: BTreeMap<Role, Preview>,
}

impl EngineStatus {
    /// The status before the engine has told anything.
    #[must_use]
    pub fn starting(dataset: &str, rig: &str, labels: Labels) -> Self {
        let session = Session::new(GuardLimits::default(), labels, OutcomeCounts::new(), None);
        Self {
            dataset: dataset.to_owned(),
            rig: rig.to_owned(),
            clock: String::new(),
            disk_free_bytes: None,
            black_box: None,
            session: session.view(0),
            cameras: Vec::new(),
            prediction: None,
            prediction_absent: None,
            contact: BTreeMap::new(),
            previews: BTreeMap::new(),
        }
    }
}

/// A small image for the screen.
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
    /// The prediction, with the keys of `PredictionRecord`; its probability is steadied over the
    /// frames.
    // The schema of the record allows no other keys beside its own.
    #[serde(flatten)]
    #[schema(value_type = Object)]
    pub said: PredictionRecord,
    /// What it claims, were it not too old.
    pub verdict: PredictedLabel,
    /// Whether the model is a heuristic and not trained.
    pub heuristic: bool,
    /// Age of the tactile frame that it was made from, ms, now.
    pub frame_age_ms: f64,
    /// Driver time of that frame, ns; stays in the process.
    #[serde(skip)]
    pub frame_time_ns: u64,
}

impl PredictionStatus {
    /// The status of a prediction on frames of this moment.
    #[must_use]
    pub fn new(said: PredictionRecord, heuristic: bool) -> Self {
        Self {
            verdict: verdict_of(&said),
            said,
            heuristic,
            frame_age_ms: 0.0,
            frame_time_ns: 0,
        }
    }
}

/// What a prediction claims.
#[must_use]
pub fn verdict_of(said: &PredictionRecord) -> PredictedLabel {
    PredictedLabel::new(said.p_stable, said.threshold, said.ood_score)
}

/// How a camera does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum CameraState {
    /// Being opened for the first time.
    Opening,
    /// Frames arrive.
    Live,
    /// No frame for this long, s; the device is still there.
    Silent {
        /// Seconds since the last frame.
        for_s: f64,
    },
    /// The image does not change although frames arrive.
    Frozen {
        /// Seconds since the last change.
        for_s: f64,
    },
    /// Unplugged or refused; tried again.
    Lost {
        /// What the last attempt said.
        reason: String,
    },
    /// A recorded stream has ended.
    Ended,
}

impl CameraState {
    /// The state in a word.
    #[must_use]
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

    /// How long it is silent or frozen, s.
    #[must_use]
    pub fn since_s(&self) -> Option<f64> {
        match self {
            Self::Silent { for_s } | Self::Frozen { for_s } => Some(*for_s),
            _ => None,
        }
    }

    /// Whether frames of this camera can be used.
    #[must_use]
    pub fn is_live(&self) -> bool {
        matches!(self, Self::Live)
    }
}

/// Whether sheet and tags can be measured in a frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct MarkerStatus {
    /// Whether they can.
    pub ok: bool,
    /// What it shows of them, or why they cannot.
    pub text: String,
}

/// One camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CameraStatus {
    /// Role.
    pub role: Role,
    /// Product string.
    pub product: String,
    /// Serial, or empty.
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
    /// What was counted.
    #[serde(flatten)]
    pub counters: CameraCounters,
    /// What the newest frame shows of sheet and tags; none where they are not looked for.
    pub markers: Option<MarkerStatus>,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the API says is the status itself: `collect --attach` gets back all but the images.
    #[test]
    fn a_status_comes_back_from_json() {
        let said = PredictionRecord {
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
            prediction: Some(PredictionStatus::new(said, true)),
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
