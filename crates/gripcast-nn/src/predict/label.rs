//! Label that follows from a prediction.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Predicted label of a grasp.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PredictedLabel {
    /// The grasp is predicted to be stable.
    Stable,
    /// The grasp is predicted to slip.
    Slip,
    /// The tactile images are out of distribution, so that the probability is meaningless.
    Unsure,
}

impl PredictedLabel {
    /// Compares a probability with the decision threshold, and the
    /// [OOD score](super::OodDetector::max_score), if any, with 1.
    #[must_use]
    pub fn new(p_stable: f64, threshold: f64, ood_score: Option<f64>) -> Self {
        if ood_score.is_some_and(|score| score > 1.0) {
            Self::Unsure
        } else if p_stable >= threshold {
            Self::Stable
        } else {
            Self::Slip
        }
    }

    /// Name in lower case.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Stable => "stable",
            Self::Slip => "slip",
            Self::Unsure => "unsure",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn label_follows_threshold_and_ood_score() {
        for (p_stable, ood_score, label) in [
            (0.6, None, PredictedLabel::Stable),
            (0.59, None, PredictedLabel::Slip),
            (0.6, Some(1.0), PredictedLabel::Stable),
            (0.59, Some(0.2), PredictedLabel::Slip),
            (0.6, Some(1.01), PredictedLabel::Unsure),
            (0.01, Some(7.0), PredictedLabel::Unsure),
        ] {
            assert_eq!(
                PredictedLabel::new(p_stable, 0.6, ood_score),
                label,
                "{p_stable} {ood_score:?}"
            );
        }
    }
}
