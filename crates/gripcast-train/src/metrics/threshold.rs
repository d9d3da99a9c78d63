//! Choice of the threshold from which a prediction counts as stable. Choose it on validation data;
//! figures of the data that it was chosen on are too good.

use super::Scored;
use super::curve::Tie;
use super::ranking::Ranking;

/// Threshold that maximises Youden's J, the true minus the false positive rate (Youden 1950). None
/// with one class only.
///
/// Of several equally good gaps between predictions the widest is taken, of equally wide ones the
/// highest, and of a gap its middle. Predicting all grasps alike wins only where every threshold
/// between predictions is worse.
pub fn youden_threshold(samples: &[Scored]) -> Option<f64> {
    let cuts = cuts(&Ranking::new(samples).ties());
    let all = cuts.last().filter(|all| all.stable * all.unstable > 0)?;
    let score = |cut: &Cut| {
        i128::from(cut.stable) * i128::from(all.unstable)
            - i128::from(cut.unstable) * i128::from(all.stable)
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

/// A way to divide the samples: those of the highest predictions are stable.
struct Cut {
    threshold: f64,
    /// Width of the gap in which the threshold lies; 0 at the ends.
    width: f64,
    /// Stable samples predicted stable.
    stable: u64,
    /// Unstable samples predicted stable.
    unstable: u64,
}

/// All ways to divide the samples, from none to all predicted stable. `ties` fall.
fn cuts(ties: &[Tie]) -> Vec<Cut> {
    let Some(highest) = ties.first() else {
        return Vec::new();
    };
    let mut cuts = vec![Cut {
        threshold: highest.p_stable.next_up(),
        width: 0.0,
        stable: 0,
        unstable: 0,
    }];
    let (mut stable, mut unstable) = (0, 0);
    for (i, tie) in ties.iter().enumerate() {
        stable += tie.stable;
        unstable += tie.unstable;
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
            unstable,
        });
    }
    cuts
}

/// Above `low` also where no number lies between the two.
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
    fn the_middle_of_the_only_best_gap_is_taken() {
        let samples = scored(&[(0.9, true), (0.8, true), (0.3, false), (0.1, false)]);
        assert_eq!(youden_threshold(&samples), Some(0.5 * (0.3 + 0.8)));
    }

    #[test]
    fn of_equally_good_gaps_the_widest_is_taken() {
        // J is 1/2 in the gaps 0.8..0.9 and 0.2..0.7.
        let samples = scored(&[(0.9, true), (0.8, false), (0.7, true), (0.2, false)]);
        assert_eq!(youden_threshold(&samples), Some(0.5 * (0.2 + 0.7)));
        // Now the upper gap is wider.
        let samples = scored(&[(0.9, true), (0.4, false), (0.3, true), (0.2, false)]);
        assert_eq!(youden_threshold(&samples), Some(0.5 * (0.4 + 0.9)));
    }

    #[test]
    fn of_equally_wide_gaps_the_highest_is_taken() {
        let samples = scored(&[(1.0, true), (0.75, false), (0.5, true), (0.25, false)]);
        assert_eq!(youden_threshold(&samples), Some(0.875));
    }

    #[test]
    fn no_threshold_beats_the_chosen_one() {
        for seed in 0..20 {
            let samples = dyadic_samples(50, seed);
            let best = youden(&samples, youden_threshold(&samples).unwrap());
            for step in 0..=1000 {
                assert!(youden(&samples, f64::from(step) / 1000.0) < best + 1e-12);
            }
        }
    }

    #[test]
    fn predictions_that_mislead_are_all_called_unstable() {
        let samples = scored(&[(0.9, false), (0.1, true)]);
        let threshold = youden_threshold(&samples).unwrap();
        assert!(threshold > 0.9 && youden(&samples, threshold) == 0.0);
        let constant = scored(&[(0.5, false), (0.5, true)]);
        assert!(youden_threshold(&constant).unwrap() > 0.5);
    }

    #[test]
    fn neighbouring_numbers_can_be_divided() {
        // The middle of the first pair is rounded down, that of the second up.
        for low in [0.5_f64, 0.5_f64.next_up()] {
            let samples = scored(&[(low.next_up(), true), (low, false)]);
            assert_eq!(youden_threshold(&samples), Some(low.next_up()));
        }
    }

    #[test]
    fn one_class_has_no_threshold() {
        let stable = scored(&[(0.9, true), (f64::NAN, false)]);
        assert_eq!(youden_threshold(&stable), None);
        assert_eq!(youden_threshold(&[]), None);
    }
}
