//! Label that follows from a prediction.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use gripcast_imaging::{ChangeKind, GelChange, MIN_CONTACT_FRACTION, ViewProblem};

/// Predicted label of a grasp.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PredictedLabel {
    /// The grasp is predicted to be stable.
    Stable,
    /// The grasp is predicted to slip.
    Slip,
    /// The tactile images are out of distribution or show no contact of both gels, so that the
    /// probability is meaningless, or both outcomes are open at the error rate.
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

    /// The label where a prediction set says which outcomes are open: unsure unless it is one alone.
    #[must_use]
    pub fn within(self, stable: bool, slip: bool) -> Self {
        match (self, stable, slip) {
            (Self::Unsure, _, _) => Self::Unsure,
            (_, true, false) => Self::Stable,
            (_, false, true) => Self::Slip,
            _ => Self::Unsure,
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

/// Why the tactile images of a grasp cannot tell whether it is stable, one sentence: the light on a
/// gel changed and hides whether something presses, an image is not as the sensor sends it (colour
/// order, orientation, gamma, dark), a gel is another one, or a grasp is predicted to be stable that
/// both gels do not feel.
#[must_use]
pub fn contact_doubt(changes: [&GelChange; 2], is_stable: bool) -> Option<String> {
    let gels = ["left", "right"].into_iter().zip(changes);
    let gels = gels.map(|(name, change)| (name, change, change.kind(MIN_CONTACT_FRACTION)));
    let of_kind = |kind: ChangeKind| gels.clone().find(|gel| gel.2 == kind);
    // Light may look like exchanged colours or another gamma.
    if let Some((name, change, _)) = of_kind(ChangeKind::Illumination) {
        let levels = change.illumination_levels;
        return Some(format!(
            "the light on the {name} gel changed by {levels:.0} grey levels, and nothing presses on it"
        ));
    }
    // Of real contacts a tenth look mirrored on one gel, but none on both gels of a grasp.
    let is_mirrored = changes
        .iter()
        .all(|change| change.view_problem == Some(ViewProblem::Mirrored));
    let mut views = gels
        .clone()
        .filter_map(|gel| Some((gel.0, gel.1.view_problem?)))
        .filter(|(_, problem)| is_mirrored || *problem != ViewProblem::Mirrored);
    if let Some((name, problem)) = views.next() {
        return Some(format!(
            "the image of the {name} gel {}: {}",
            problem.what(),
            problem.remedy()
        ));
    }
    if let Some((name, ..)) = of_kind(ChangeKind::OtherGel) {
        return Some(format!(
            "the {name} gel is not the one of the initial frame"
        ));
    }
    of_kind(ChangeKind::Unchanged).filter(|_| is_stable)?;
    Some(match of_kind(ChangeKind::Contact) {
        Some((name, ..)) => format!("only the {name} gel is in contact"),
        None => "no gel is in contact".to_owned(),
    })
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

    #[test]
    fn sets_of_one_outcome_decide_in_place_of_the_threshold() {
        let label = PredictedLabel::Stable;
        assert_eq!(label.within(true, false), PredictedLabel::Stable);
        assert_eq!(label.within(false, true), PredictedLabel::Slip);
        assert_eq!(label.within(true, true), PredictedLabel::Unsure);
        let unsure = PredictedLabel::Unsure;
        assert_eq!(unsure.within(true, false), PredictedLabel::Unsure);
    }

    #[test]
    fn contact_of_both_gels_is_no_doubt() {
        let change = |contact_fraction, illumination_levels| GelChange {
            contact_fraction,
            illumination_levels,
            is_other_gel: false,
            view_problem: None,
        };
        let (touched, untouched, lit) = (change(0.1, 9.0), change(0.0, 0.1), change(0.001, 12.0));
        let other = GelChange {
            is_other_gel: true,
            ..touched
        };
        let seen = |problem| GelChange {
            view_problem: Some(problem),
            ..touched
        };
        let mirrored = seen(ViewProblem::Mirrored);
        let upside_down = seen(ViewProblem::UpsideDown);
        let doubt = |left, right, is_stable| contact_doubt([left, right], is_stable);
        for is_stable in [true, false] {
            assert_eq!(doubt(&touched, &touched, is_stable), None);
            let light = doubt(&touched, &lit, is_stable).unwrap();
            assert!(light.contains("light on the right gel"), "{light}");
            assert!(doubt(&lit, &lit, is_stable).is_some());
            assert!(doubt(&other, &touched, is_stable).is_some());
            assert_eq!(doubt(&touched, &mirrored, is_stable), None);
            let view = doubt(&mirrored, &mirrored, is_stable).unwrap();
            assert!(view.contains("is mirrored"), "{view}");
            let view = doubt(&touched, &upside_down, is_stable).unwrap();
            assert!(
                view.starts_with("the image of the right gel is upside down: "),
                "{view}"
            );
        }
        assert_eq!(doubt(&untouched, &touched, false), None);
        let one = doubt(&untouched, &touched, true).unwrap();
        assert_eq!(one, "only the right gel is in contact");
        assert_eq!(
            doubt(&untouched, &untouched, true).unwrap(),
            "no gel is in contact"
        );
    }
}
