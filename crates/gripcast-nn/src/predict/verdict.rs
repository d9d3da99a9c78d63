//! What may be claimed of a prediction.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A claim in one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The grasp will hold.
    Stable,
    /// It will not.
    Slip,
    /// The tactile images are unlike all that the model was trained on, so that its probability
    /// says nothing.
    Unsure,
}

impl Verdict {
    /// Of a probability against the model's decision threshold, and of the
    /// [`novelty`](super::Novelty::of_touch) of the images where the model tells it.
    #[must_use]
    pub fn of(p_stable: f64, threshold: f64, novelty: Option<f64>) -> Self {
        if novelty.is_some_and(|novelty| novelty > 1.0) {
            Self::Unsure
        } else if p_stable >= threshold {
            Self::Stable
        } else {
            Self::Slip
        }
    }

    /// Its word, in lower case.
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
    fn the_threshold_decides_where_the_images_are_known() {
        for (p_stable, novelty, verdict) in [
            (0.6, None, Verdict::Stable),
            (0.59, None, Verdict::Slip),
            (0.6, Some(1.0), Verdict::Stable),
            (0.59, Some(0.2), Verdict::Slip),
            (0.6, Some(1.01), Verdict::Unsure),
            (0.01, Some(7.0), Verdict::Unsure),
        ] {
            assert_eq!(
                Verdict::of(p_stable, 0.6, novelty),
                verdict,
                "{p_stable} {novelty:?}"
            );
        }
    }
}
