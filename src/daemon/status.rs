//! Snapshot of the running engine, shown by the screens, served by the API and read back by
//! `collect --attach`.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use image::RgbImage;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::black_box::BlackBoxStatus;
use super::start_report::StartFinding;
use gripcast_capture::camera::{CameraCounters, CameraState, monotonic_ns};
use gripcast_dataset::PredictionRecord;
use gripcast_imaging::{ChangeKind, GelChange, GelState, ObjectMotion, Role, TactileDifference};
use gripcast_nn::predict::{Adaptation, PredictedLabel};
use gripcast_session::{GuardLimits, Labels, OutcomeCounts, Session, SessionView};
use gripcast_shear::{FingerForce, MarkerField, ShearFrame, ShearSummary};

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
    /// Number of grasps that still fit on the disk: the free space above the limit of the guards
    /// over the mean size of the newest hundred grasps; null before the first grasp.
    pub grasps_left: Option<u64>,
    /// Labelled grasps wanted per object; 0: no target.
    pub target_per_object: u32,
    /// What differs from the dataset's earlier grasps, the most important first.
    #[serde(default)]
    pub start_report: Vec<StartFinding>,
    /// The black box, if enabled.
    pub black_box: Option<BlackBoxStatus>,
    /// State of the session.
    pub session: SessionView,
    /// Cameras, in the order of [`Role::ALL`].
    pub cameras: Vec<CameraStatus>,
    /// Newest prediction; `None` before the initial frame or without a model.
    pub prediction: Option<PredictionStatus>,
    /// Verdict in the lift of the last saved grasp; `None` without a model that gives one.
    #[serde(default)]
    pub lift: Option<LiftStatus>,
    /// Reason why there is no prediction.
    pub no_prediction_reason: Option<String>,
    /// Base rate that predictions are adapted to; null without adaptation.
    #[serde(default)]
    pub adaptation: Option<Adaptation>,
    /// Mean absolute difference of each gel to the initial frame, grey levels (0 to 255).
    pub contact: BTreeMap<Role, f64>,
    /// State of each gel.
    #[serde(default)]
    pub gels: BTreeMap<Role, GelStatus>,
    /// Shear of each gel since the initial frame; absent without one.
    #[serde(default)]
    pub shear: BTreeMap<Role, ShearStatus>,
    /// Force on each gel since the initial frame; absent without one, and for gels of an unknown
    /// sensor.
    #[serde(default)]
    pub force: BTreeMap<Role, FingerForce>,
    /// Number of grasps by object and outcome, which the API sends separately.
    #[serde(skip)]
    pub objects: Arc<OutcomeCounts>,
    /// Preview images, which the API sends separately.
    #[serde(skip)]
    pub previews: BTreeMap<Role, Preview>,
    /// Gel markers in the newest image of each gel that has them, which the API sends separately.
    #[serde(skip)]
    pub marker_fields: BTreeMap<Role, LiveMarkers>,
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
            grasps_left: None,
            target_per_object: 0,
            start_report: Vec::new(),
            black_box: None,
            session: session.view(0),
            cameras: Vec::new(),
            prediction: None,
            lift: None,
            no_prediction_reason: None,
            adaptation: None,
            contact: BTreeMap::new(),
            objects: Arc::default(),
            gels: BTreeMap::new(),
            shear: BTreeMap::new(),
            force: BTreeMap::new(),
            previews: BTreeMap::new(),
            marker_fields: BTreeMap::new(),
        }
    }
}

/// State of a gel and its change since the initial frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GelStatus {
    /// Level, noise and problems.
    #[serde(flatten)]
    pub state: GelState,
    /// A sentence with remedy for each problem.
    pub messages: Vec<String>,
    /// Fraction of the gel in contact, 0 to 1; `None` without an initial frame.
    pub contact_fraction: Option<f64>,
    /// What changed since the initial frame; `None` without one.
    pub change: Option<ChangeKind>,
}

impl GelStatus {
    /// Creates the status; a contact covers at least `min_contact_fraction` of the gel.
    pub fn new(state: GelState, change: Option<GelChange>, min_contact_fraction: f64) -> Self {
        let messages = state.problems.iter().map(|problem| problem.text());
        Self {
            messages: messages.collect(),
            contact_fraction: change.map(|change| change.contact_fraction),
            change: change.map(|change| change.kind(min_contact_fraction)),
            state,
        }
    }
}

/// Shear of a gel since the initial frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ShearStatus {
    /// The shear; null where nothing can be said.
    pub summary: Option<ShearSummary>,
    /// A sentence with remedy for each problem.
    pub messages: Vec<String>,
}

impl ShearStatus {
    /// The shear in a few words, for instance `shear 0.42 mm ↗ slip 12 %`, with `~` where it is
    /// uncertain; the arrow points as the skin of the gel moves in its image. `None` where nothing
    /// can be said.
    #[must_use]
    pub fn words(&self) -> Option<String> {
        let summary = self.summary?;
        let [x, y] = summary.mean_displacement_mm;
        let length_mm = x.hypot(y);
        let about = match summary.confidence < UNCERTAIN {
            true => "~",
            false => "",
        };
        let direction = match length_mm < MIN_DIRECTION_MM {
            true => String::new(),
            false => format!(" {}", arrow(x, y)),
        };
        let slip = summary
            .slip_ratio
            .map(|ratio| format!(" slip {:.0} %", 100.0 * ratio));
        let slip = slip.unwrap_or_default();
        Some(format!("shear {about}{length_mm:.2} mm{direction}{slip}"))
    }
}

/// Confidence below which a shear is shown as uncertain.
const UNCERTAIN: f64 = 0.5;
/// Displacement from which a direction is shown, mm.
const MIN_DIRECTION_MM: f64 = 0.02;

/// Returns the arrow nearest to a direction in an image, y down.
fn arrow(x: f64, y: f64) -> char {
    const ARROWS: [char; 8] = ['→', '↘', '↓', '↙', '←', '↖', '↑', '↗'];
    let eighth = (y.atan2(x) / std::f64::consts::FRAC_PI_4).round() as i32;
    ARROWS[eighth.rem_euclid(8) as usize]
}

impl From<&ShearFrame> for ShearStatus {
    fn from(frame: &ShearFrame) -> Self {
        let messages = frame.problems.iter().map(|problem| problem.text());
        Self {
            summary: frame.summary,
            messages: messages.collect(),
        }
    }
}

/// A preview image.
#[derive(Clone, Debug)]
pub struct Preview {
    /// RGB image of the camera, at most 320×240.
    pub image: Arc<RgbImage>,
    /// Tactile difference to the last initial frame with an arrow for each gel marker, grey for no
    /// change; none before the first initial frame of the session.
    pub difference: Option<Arc<RgbImage>>,
    /// The same in grey levels, without arrows; none in `collect --attach`.
    pub levels: Option<Arc<TactileDifference>>,
    /// Driver time of the frame, `CLOCK_MONOTONIC`, ns.
    pub driver_time_ns: u64,
}

/// The gel markers in an image of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveMarkers {
    /// The gel markers.
    pub field: Arc<MarkerField>,
    /// Driver time of the frame, `CLOCK_MONOTONIC`, ns.
    pub driver_time_ns: u64,
}

impl Preview {
    /// Returns the difference if there is one, else the image, and whether it is a difference.
    pub fn shown(&self) -> (&Arc<RgbImage>, bool) {
        match &self.difference {
            Some(difference) => (difference, true),
            None => (&self.image, false),
        }
    }
}

/// Verdict in the lift of the last saved grasp.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LiftStatus {
    /// Probability that the grasp holds, from the prediction before the lift and what the gels and
    /// the depth camera have shown since.
    pub p_stable: f64,
    /// Probability before the lift.
    pub p_before: f64,
    /// Minimum probability of a stable grasp.
    pub threshold: f64,
    /// Whether the probability is at least the threshold.
    pub is_stable: bool,
    /// Whether the contact is being lost.
    pub is_slipping: bool,
    /// Motion of the object since the saved grasp, as the depth camera sees it; null where it is not
    /// measured.
    pub object: Option<ObjectMotion>,
    /// Driver time of the first tactile frame in which it was being lost, ns.
    pub alarm_time_ns: Option<u64>,
    /// Driver time of the newest tactile frame, ns.
    pub frame_time_ns: u64,
}

impl LiftStatus {
    /// The verdict as a word.
    #[must_use]
    pub fn word(&self) -> &'static str {
        match self {
            Self {
                is_slipping: true, ..
            } => "SLIPPING",
            Self {
                is_stable: true, ..
            } => "STABLE",
            _ => "SLIP",
        }
    }
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
    match record.unsure_reason {
        Some(_) => PredictedLabel::Unsure,
        None => {
            let p_stable = record.shown_p_stable();
            let label = PredictedLabel::new(p_stable, record.threshold, record.ood_score);
            record
                .set
                .map_or(label, |set| label.within(set.stable, set.slip))
        }
    }
}

/// Returns why a verdict is `UNSURE`, in words.
pub fn unsure_words(record: &PredictionRecord) -> String {
    let is_unfamiliar = record.ood_score.is_some_and(|score| score > 1.0);
    match (&record.unsure_reason, record.set) {
        (Some(reason), _) => reason.clone(),
        (None, Some(set)) if !is_unfamiliar => {
            format!("can't tell at an error rate of {}", set.error_rate)
        }
        (None, _) => "unlike the training images".to_owned(),
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
    /// Rate of arriving frames over the last seconds, damaged ones included, 1/s.
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
    use gripcast_dataset::{AdaptedPrediction, OpenOutcomes};
    use gripcast_imaging::GelProblem;
    use gripcast_shear::ShearSource;

    /// `collect --attach` reads back everything but the images.
    #[test]
    fn status_survives_json_round_trip() {
        let record = PredictionRecord {
            p_stable: 0.81,
            ood_score: Some(0.5),
            unsure_reason: None,
            adapted: None,
            set: None,
            threshold: 0.5,
            inputs: None,
            geometry: None,
            model_sha256: "0".repeat(64),
            model: "m".into(),
            latency_ms: 12.0,
            engine_ms: 3.0,
        };
        let gel = GelState {
            level: [90.0, 100.0, 110.0],
            clipped_fraction: 0.0,
            noise_levels: Some(0.25),
            flicker: 0.5,
            drift_per_s: 0.0,
            problems: vec![GelProblem::Flickering],
        };
        let change = GelChange {
            contact_fraction: 0.0,
            illumination_levels: 12.0,
            is_other_gel: false,
            view_problem: None,
        };
        let gel = GelStatus::new(gel, Some(change), 0.005);
        assert!(gel.messages[0].contains("flickers"));
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
            adaptation: Some(Adaptation::new(0.5, 10.0, [1, 6])),
            contact: BTreeMap::from([(Role::Left, 8.5)]),
            gels: BTreeMap::from([(Role::Left, gel)]),
            shear: BTreeMap::from([(Role::Left, shear([0.3, 0.3], 0.9, Some(0.12)))]),
            ..EngineStatus::starting("d", "bench", Labels::default())
        };
        let json = serde_json::to_value(&status).unwrap();
        assert_eq!(json["adaptation"]["labels"], 7);
        assert_eq!(json["gels"]["left"]["problems"][0], "flickering");
        assert_eq!(json["gels"]["left"]["change"], "illumination");
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
        assert_eq!(back.gels, status.gels);
        assert_eq!(back.shear, status.shear);
    }

    #[test]
    fn verdict_follows_adapted_probability_and_set() {
        let record = PredictionRecord {
            p_stable: 0.4,
            ood_score: Some(0.5),
            unsure_reason: None,
            adapted: None,
            set: None,
            threshold: 0.5,
            inputs: None,
            geometry: None,
            model_sha256: String::new(),
            model: "m".into(),
            latency_ms: 1.0,
            engine_ms: 1.0,
        };
        assert_eq!(verdict_of(&record), PredictedLabel::Slip);
        let adapted = PredictionRecord {
            adapted: Some(AdaptedPrediction {
                p_stable: 0.6,
                base_rate: 0.7,
                labels: 20,
            }),
            ..record.clone()
        };
        assert_eq!(verdict_of(&adapted), PredictedLabel::Stable);
        let with_set = |record: &PredictionRecord, stable, slip| PredictionRecord {
            set: Some(OpenOutcomes {
                error_rate: 0.1,
                stable,
                slip,
            }),
            ..record.clone()
        };
        let both = with_set(&adapted, true, true);
        assert_eq!(verdict_of(&both), PredictedLabel::Unsure);
        assert_eq!(unsure_words(&both), "can't tell at an error rate of 0.1");
        assert_eq!(
            verdict_of(&with_set(&adapted, false, true)),
            PredictedLabel::Slip
        );
        let unfamiliar = PredictionRecord {
            ood_score: Some(2.0),
            ..with_set(&adapted, true, false)
        };
        assert_eq!(verdict_of(&unfamiliar), PredictedLabel::Unsure);
        assert_eq!(unsure_words(&unfamiliar), "unlike the training images");
    }

    fn shear(mean_displacement_mm: [f64; 2], confidence: f64, slip: Option<f64>) -> ShearStatus {
        ShearStatus {
            summary: Some(ShearSummary {
                source: ShearSource::Markers,
                confidence,
                tracked_fraction: 1.0,
                mean_displacement_mm,
                max_displacement_mm: 1.0,
                divergence: 0.0,
                curl: 0.0,
                contact_fraction: 0.2,
                slip_ratio: slip,
            }),
            messages: Vec::new(),
        }
    }

    #[test]
    fn shear_is_told_in_a_few_words() {
        let words = |d, confidence, slip| shear(d, confidence, slip).words().unwrap();
        assert_eq!(
            words([0.3, -0.3], 0.9, Some(0.12)),
            "shear 0.42 mm ↗ slip 12 %"
        );
        assert_eq!(words([0.0, 0.5], 0.9, None), "shear 0.50 mm ↓");
        assert_eq!(words([-0.5, 0.01], 0.3, None), "shear ~0.50 mm ←");
        assert_eq!(words([0.0, 0.0], 0.9, None), "shear 0.00 mm");
        assert_eq!(ShearStatus::default().words(), None);
    }
}
