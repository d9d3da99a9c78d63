//! What follows from a prediction: the adapted probability, the prediction set, doubts.

use super::status::verdict_of;
use gripcast_dataset::{AdaptedPrediction, OpenOutcomes, PredictionRecord};
use gripcast_imaging::GelChange;
use gripcast_nn::predict::{
    Adaptation, ConformalLimits, LivePredictor, PredictedLabel, contact_doubt,
};

/// Limits of the prediction set, which hold for predictions from all inputs of the model.
pub(super) fn limits_of(
    predictor: &LivePredictor,
    record: &PredictionRecord,
    limits: Option<ConformalLimits>,
) -> Option<ConformalLimits> {
    let all = predictor.model().contract().modality.name();
    limits.filter(|_| record.inputs.as_deref() == Some(all))
}

/// Adds the adapted probability and the prediction set. The set follows from the model's own
/// probability: it covers each outcome on its own, whatever the base rate.
pub(super) fn decided(
    record: PredictionRecord,
    limits: Option<ConformalLimits>,
    adaptation: Option<Adaptation>,
) -> PredictionRecord {
    let p_stable = record.p_stable;
    let set = limits.map(|limits| {
        let set = limits.set_of(p_stable);
        OpenOutcomes {
            error_rate: limits.error_rate,
            stable: set.contains(true),
            slip: set.contains(false),
        }
    });
    let adapted = adaptation.map(|adaptation| AdaptedPrediction {
        p_stable: adaptation.adapted(p_stable),
        base_rate: adaptation.base_rate,
        labels: adaptation.labels,
    });
    PredictionRecord {
        adapted,
        set,
        ..record
    }
}

/// Adds why the changes of both gels cannot support a tactile prediction.
pub(super) fn with_doubt(
    record: PredictionRecord,
    predictor: &LivePredictor,
    changes: [Option<GelChange>; 2],
) -> PredictionRecord {
    let (true, [Some(left), Some(right)]) =
        (predictor.model().contract().modality.has_touch(), changes)
    else {
        return record;
    };
    let is_stable = verdict_of(&record) == PredictedLabel::Stable;
    PredictionRecord {
        unsure_reason: contact_doubt([&left, &right], is_stable),
        ..record
    }
}
