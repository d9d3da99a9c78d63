//! ROC and precision–recall curves with a bounded number of points.

use serde::{Deserialize, Serialize};

use gripcast_report::polyline;

/// Maximum number of points of a curve.
pub(super) const MAX_POINTS: usize = 512;

/// Points closer than this to the simplified curve are removed.
const TOLERANCE: f64 = 1e-9;

/// Samples that share one prediction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tie {
    /// The prediction.
    pub(super) p_stable: f64,
    /// Number of stable samples.
    pub(super) stable: u64,
    /// Number of slip samples.
    pub(super) slip: u64,
}

/// A point of a receiver operating characteristic (ROC) curve; stable is positive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RocPoint {
    /// Fraction of the slip samples that are predicted stable: the false positive rate.
    pub false_stable_rate: f64,
    /// Fraction of the stable grasps that are predicted stable: the true positive rate.
    pub true_stable_rate: f64,
    /// Decision threshold; none if no sample is predicted stable.
    pub threshold: Option<f64>,
}

/// A point of a precision–recall curve of the stable class.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PrecisionRecallPoint {
    /// Fraction of the stable grasps that are predicted stable.
    pub recall: f64,
    /// Fraction of the grasps predicted stable that are stable.
    pub precision: f64,
    /// Decision threshold at the end of the step of the point.
    pub threshold: f64,
}

pub(super) fn roc_points(ties: &[Tie]) -> Vec<RocPoint> {
    let (all_stable, all_slip) = totals(ties);
    if all_stable == 0 || all_slip == 0 {
        return Vec::new();
    }
    let mut points = vec![RocPoint {
        false_stable_rate: 0.0,
        true_stable_rate: 0.0,
        threshold: None,
    }];
    let (mut stable, mut slip) = (0, 0);
    for tie in ties {
        stable += tie.stable;
        slip += tie.slip;
        points.push(RocPoint {
            false_stable_rate: slip as f64 / all_slip as f64,
            true_stable_rate: stable as f64 / all_stable as f64,
            threshold: Some(tie.p_stable),
        });
    }
    thinned(points, |point| {
        [point.false_stable_rate, point.true_stable_rate]
    })
}

pub(super) fn precision_recall_points(ties: &[Tie]) -> Vec<PrecisionRecallPoint> {
    let (all_stable, _) = totals(ties);
    if all_stable == 0 {
        return Vec::new();
    }
    let mut points = Vec::with_capacity(2 * ties.len());
    let (mut stable, mut predicted) = (0, 0);
    for tie in ties {
        let recall_before = stable as f64 / all_stable as f64;
        stable += tie.stable;
        predicted += tie.stable + tie.slip;
        // A step has one precision over its whole gain in recall.
        for recall in [recall_before, stable as f64 / all_stable as f64] {
            points.push(PrecisionRecallPoint {
                recall,
                precision: stable as f64 / predicted as f64,
                threshold: tie.p_stable,
            });
        }
    }
    thinned(points, |point| [point.recall, point.precision])
}

/// Simplifies a curve.
fn thinned<T: Copy>(points: Vec<T>, position: impl Fn(&T) -> [f64; 2]) -> Vec<T> {
    let positions: Vec<[f64; 2]> = points.iter().map(position).collect();
    let kept = polyline::simplify(&positions, TOLERANCE, MAX_POINTS);
    kept.into_iter().map(|i| points[i]).collect()
}

/// Returns the total numbers of stable and slip samples.
fn totals(ties: &[Tie]) -> (u64, u64) {
    ties.iter().fold((0, 0), |(stable, slip), tie| {
        (stable + tie.stable, slip + tie.slip)
    })
}

#[cfg(test)]
#[path = "curve_test.rs"]
mod tests;
