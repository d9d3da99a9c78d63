//! The prediction that is stored with a grasp.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use gripcast_geometry::GraspGeometry;

/// Prediction of the model before the lift.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PredictionRecord {
    /// Probability that the grasp is stable.
    pub p_stable: f64,
    /// OOD score, 1 at the threshold; absent where the model has none.
    #[serde(alias = "novelty", default, skip_serializing_if = "Option::is_none")]
    pub ood_score: Option<f64>,
    /// Why the images cannot tell, one sentence; absent where they can.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unsure_reason: Option<String>,
    /// The probability at the base rate of the rig's labels; absent without adaptation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub adapted: Option<AdaptedPrediction>,
    /// Outcomes that the prediction leaves open; absent without an error rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set: Option<OpenOutcomes>,
    /// Decision threshold of the model.
    pub threshold: f64,
    /// Inputs that the prediction is made from: `VTD`, `VT`, `T`, …; absent in older datasets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inputs: Option<String>,
    /// Extents of the object in the gripper frame as the model sees them; absent without camera
    /// images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Object>)]
    pub geometry: Option<GraspGeometry>,
    /// sha256 of the ONNX file.
    pub model_sha256: String,
    /// Name of the model.
    pub model: String,
    /// Time from the newest frame's driver time stamp to the result, ms.
    pub latency_ms: f64,
    /// Inference time of the model, ms.
    pub engine_ms: f64,
}

/// Verdict in the lift: what the gels have shown since the grasp trigger.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LiftVerdict {
    /// Probability that the grasp holds, from the prediction before the lift and the gels.
    pub p_stable: f64,
    /// Minimum probability of a stable grasp.
    pub threshold: f64,
    /// Driver time of the newest tactile frame, ns.
    pub frame_time_ns: u64,
    /// Driver time of the first tactile frame with the alarm that the contact is being lost, ns;
    /// absent without an alarm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alarm_time_ns: Option<u64>,
}

/// A prediction at the base rate of a rig's labels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AdaptedPrediction {
    /// Probability that the grasp is stable.
    pub p_stable: f64,
    /// Base rate.
    pub base_rate: f64,
    /// Number of labels that the base rate follows from.
    pub labels: u64,
}

/// Conformal prediction set.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct OpenOutcomes {
    /// Chosen error rate.
    pub error_rate: f64,
    /// Whether stable is in the set.
    pub stable: bool,
    /// Whether slip is in the set.
    pub slip: bool,
}

impl PredictionRecord {
    /// The probability that is shown and compared with the threshold: the adapted one, if there is
    /// one, else the model's.
    #[must_use]
    pub fn shown_p_stable(&self) -> f64 {
        self.adapted
            .map_or(self.p_stable, |adapted| adapted.p_stable)
    }
}
