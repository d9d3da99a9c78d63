//! Choice of the decision threshold. Choose it on validation data: metrics on the data it was
//! chosen on are biased.

use super::Scored;
use super::curve::Tie;
use super::ranking::Ranking;

/// Threshold that maximises Youden's J, the true minus the false positive rate (Youden 1950). None
/// with one class only.
///
/// Returns the middle of the best gap between predictions; among equally good gaps the widest, then
/// the highest. A constant decision is only chosen if every gap is worse.
pub fn youden_threshold(samples: &[Scored]) -> Option<f64> {
    let cuts = cuts(&Ranking::new(samples).ties());
    let all = cuts.last().filter(|all| all.stable * all.slip > 0)?;
    let score = |cut: &Cut| {
        i128::from(cut.stable) * i128::from(all.slip)
            - i128::from(cut.slip) * i128::from(all.stable)
    };
    let better = |a: &Cut, b: &Cut| {
        let by_score = score(a).cmp(&score(b));
        by_score.then(a.width.total_cmp(&b.width)).is_gt()
    };
    let mut best: Option<&Cut> = None;
    for cut in &cuts {
        if best.is_none_or(|best| better(cut, best)) {
            best = Some(cut);
        }
    }
    best.map(|cut| cut.threshold)
}

/// A decision threshold with its counts.
struct Cut {
    threshold: f64,
    /// Width of the gap around the threshold; 0 at the ends.
    width: f64,
    /// Stable samples predicted stable.
    stable: u64,
    /// Unstable samples predicted stable.
    slip: u64,
}

/// Returns all thresholds, from none to all predicted stable; `ties` are in descending order.
fn cuts(ties: &[Tie]) -> Vec<Cut> {
    let Some(highest) = ties.first() else {
        return Vec::new();
    };
    let mut cuts = vec![Cut {
        threshold: highest.p_stable.next_up(),
        width: 0.0,
        stable: 0,
        slip: 0,
    }];
    let (mut stable, mut slip) = (0, 0);
    for (i, tie) in ties.iter().enumerate() {
        stable += tie.stable;
        slip += tie.slip;
        let (threshold, width) = match ties.get(i + 1) {
            Some(next) => (
                middle(next.p_stable, tie.p_stable),
                tie.p_stable - next.p_stable,
            ),
            None => (tie.p_stable.min(0.0), 0.0),
        };
        cuts.push(Cut {
            threshold,
            width,
            stable,
            slip,
        });
    }
    cuts
}

/// Returns the middle; above `low` even for adjacent numbers.
fn middle(low: f64, high: f64) -> f64 {
    let middle = 0.5 * low + 0.5 * high;
    if middle > low { middle } else { high }
}

#[cfg(test)]
mod tests {
    use super::super::ConfusionMatrix;
    use super::super::reference_test::{dyadic_samples, scored};
    use super::*;

    fn youden(samples: &[Scored], threshold: f64) -> f64 {
        let matrix = ConfusionMatrix::at(samples, threshold);
        matrix.stable().recall.unwrap() - matrix.false_stable_rate().unwrap()
    }

    #[test]
    fn single_best_gap_gives_its_middle() {
        let samples = scored(&[(0.9, true), (0.8, true), (0.3, false), (0.1, false)]);
        assert_eq!(youden_threshold(&samples), Some(0.5 * (0.3 + 0.8)));
    }

    #[test]
    fn equally_good_gaps_give_the_widest() {
        // J is 1/2 in the gaps 0.8..0.9 and 0.2..0.7.
        let samples = scored(&[(0.9, true), (0.8, false), (0.7, true), (0.2, false)]);
        assert_eq!(youden_threshold(&samples), Some(0.5 * (0.2 + 0.7)));
        // Now the upper gap is wider.
        let samples = scored(&[(0.9, true), (0.4, false), (0.3, true), (0.2, false)]);
        assert_eq!(youden_threshold(&samples), Some(0.5 * (0.4 + 0.9)));
    }

    #[test]
    fn equally_wide_gaps_give_the_highest() {
        let samples = scored(&[(1.0, true), (0.75, false), (0.5, true), (0.25, false)]);
        assert_eq!(youden_threshold(&samples), Some(0.875));
    }

    #[test]
    fn chosen_threshold_maximises_youden() {
        for seed in 0..20 {
            let samples = dyadic_samples(50, seed);
            let best = youden(&samples, youden_threshold(&samples).unwrap());
            for step in 0..=1000 {
                assert!(youden(&samples, f64::from(step) / 1000.0) < best + 1e-12);
            }
        }
    }

    #[test]
    fn misleading_predictions_are_all_slip() {
        let samples = scored(&[(0.9, false), (0.1, true)]);
        let threshold = youden_threshold(&samples).unwrap();
        assert!(threshold > 0.9 && youden(&samples, threshold) == 0.0);
        let constant = scored(&[(0.5, false), (0.5, true)]);
        assert!(youden_threshold(&constant).unwrap() > 0.5);
    }

    #[test]
    fn adjacent_numbers_are_separated() {
        // The middle of the first pair is rounded down, that of the second up.
        for low in [0.5_f64, 0.5_f64.next_up()] {
            let samples = scored(&[(low.next_up(), true), (low, false)]);
            assert_eq!(youden_threshold(&samples), Some(low.next_up()));
        }
    }

    #[test]
    fn single_class_has_no_threshold() {
        let stable = scored(&[(0.9, true), (f64::NAN, false)]);
        assert_eq!(youden_threshold(&stable), None);
        assert_eq!(youden_threshold(&[]), None);
    }
}
