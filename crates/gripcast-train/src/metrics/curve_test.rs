use super::super::reference_test::{dyadic_samples, scored, smooth_samples};
use super::super::{Ranking, Scored};
use super::*;

fn area(points: impl IntoIterator<Item = [f64; 2]>) -> f64 {
    let points: Vec<[f64; 2]> = points.into_iter().collect();
    let strips = points.windows(2);
    strips
        .map(|w| 0.5 * (w[1][0] - w[0][0]) * (w[1][1] + w[0][1]))
        .sum()
}

fn roc_area(samples: &[Scored]) -> f64 {
    let points = Ranking::new(samples).roc_curve();
    area(
        points
            .iter()
            .map(|p| [p.false_stable_rate, p.true_stable_rate]),
    )
}

fn precision_recall_area(samples: &[Scored]) -> f64 {
    let points = Ranking::new(samples).precision_recall_curve();
    area(points.iter().map(|p| [p.recall, p.precision]))
}

#[test]
fn roc_curve_counts_positives_by_threshold() {
    let samples = scored(&[(0.9, true), (0.4, true), (0.4, false), (0.2, false)]);
    let points: Vec<_> = Ranking::new(&samples)
        .roc_curve()
        .iter()
        .map(|p| (p.false_stable_rate, p.true_stable_rate, p.threshold))
        .collect();
    assert_eq!(
        points,
        [
            (0.0, 0.0, None),
            (0.0, 0.5, Some(0.9)),
            (0.5, 1.0, Some(0.4)),
            (1.0, 1.0, Some(0.2))
        ]
    );
}

#[test]
fn precision_recall_curve_keeps_step_corners() {
    let samples = scored(&[(0.9, true), (0.6, false), (0.4, true)]);
    let points: Vec<_> = Ranking::new(&samples)
        .precision_recall_curve()
        .iter()
        .map(|p| (p.recall, p.precision, p.threshold))
        .collect();
    assert_eq!(
        points,
        [
            (0.0, 1.0, 0.9),
            (0.5, 1.0, 0.9),
            (0.5, 0.5, 0.6),
            (0.5, 2.0 / 3.0, 0.4),
            (1.0, 2.0 / 3.0, 0.4)
        ]
    );
}

#[test]
fn areas_under_curves_equal_metrics() {
    let samples = dyadic_samples(200, 21);
    let ranking = Ranking::new(&samples);
    assert!((roc_area(&samples) - ranking.auroc().unwrap()).abs() < 1e-9);
    let ap = ranking.average_precision().unwrap();
    assert!((precision_recall_area(&samples) - ap).abs() < 1e-9);
}

#[test]
fn curves_of_many_samples_stay_small_and_accurate() {
    let samples = smooth_samples(100_000, 22);
    let ranking = Ranking::new(&samples);
    let (roc, pr) = (ranking.roc_curve(), ranking.precision_recall_curve());
    // Not so few that the curve would be coarse.
    assert!((300..=MAX_POINTS).contains(&roc.len()), "{}", roc.len());
    assert!((300..=MAX_POINTS).contains(&pr.len()), "{}", pr.len());
    assert!((roc_area(&samples) - ranking.auroc().unwrap()).abs() < 2e-4);
    let ap = ranking.average_precision().unwrap();
    assert!((precision_recall_area(&samples) - ap).abs() < 1e-3);
    let [first, last] = [roc[0], roc[roc.len() - 1]];
    assert_eq!([first.false_stable_rate, first.true_stable_rate], [0.0; 2]);
    assert_eq!([last.false_stable_rate, last.true_stable_rate], [1.0; 2]);
    for pair in roc.windows(2) {
        assert!(pair[0].false_stable_rate <= pair[1].false_stable_rate);
        assert!(pair[0].true_stable_rate <= pair[1].true_stable_rate);
    }
    for pair in pr.windows(2) {
        assert!(pair[0].recall <= pair[1].recall);
    }
}

#[test]
fn single_class_has_no_roc_curve() {
    assert!(Ranking::new(&[]).roc_curve().is_empty());
    assert!(Ranking::new(&[]).precision_recall_curve().is_empty());
    let slip = scored(&[(0.3, false), (0.4, false)]);
    assert!(Ranking::new(&slip).roc_curve().is_empty());
    assert!(Ranking::new(&slip).precision_recall_curve().is_empty());
    let stable = scored(&[(0.3, true), (0.4, true)]);
    assert!(Ranking::new(&stable).roc_curve().is_empty());
    assert_eq!(Ranking::new(&stable).precision_recall_curve().len(), 2);
}
