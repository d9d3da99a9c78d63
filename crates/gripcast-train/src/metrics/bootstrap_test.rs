use super::super::reference_test::{dyadic_samples, mapped};
use super::super::{Ranking, Scored};
use super::*;

fn objects_of(n: usize, per_object: usize) -> Vec<usize> {
    (0..n).map(|i| i / per_object).collect()
}

#[test]
fn resample_draws_objects_uniformly() {
    let bootstrap = Bootstrap::new(3);
    let mut total = [0_u32; 10];
    for resample in 0..2000 {
        let mut drawn = [7; 10];
        bootstrap.draw(resample, &mut drawn);
        assert_eq!(drawn.iter().sum::<u32>(), 10);
        for (total, times) in total.iter_mut().zip(drawn) {
            *total += times;
        }
    }
    // Binomial with mean 2000 and deviation 42.
    assert!(
        total.iter().all(|&t| (1800..2200).contains(&t)),
        "{total:?}"
    );
}

#[test]
fn interval_width_matches_theory() {
    // 100 objects of 5 samples with the same value: the mean of 100 uniform numbers has the
    // deviation 0.2887 / 10, whatever the number of samples of each.
    let objects = objects_of(500, 5);
    let values: Vec<f64> = objects.iter().map(|&o| unit(17, o as u64)).collect();
    let interval = Bootstrap::new(1)
        .interval(&objects, |m| resampled_mean(&values, m))
        .unwrap();
    assert!(interval.low < interval.estimate && interval.estimate < interval.high);
    let expected = 2.0 * 1.96 * (1.0_f64 / 12.0).sqrt() / 10.0;
    let width = interval.high - interval.low;
    assert!((width / expected - 1.0).abs() < 0.15, "{width} {expected}");
    // Taken for independent, the samples would seem to say more than they do.
    let single: Vec<usize> = (0..500).collect();
    let naive = Bootstrap::new(1)
        .interval(&single, |m| resampled_mean(&values, m))
        .unwrap();
    assert!(naive.high - naive.low < 0.6 * width);
}

#[test]
fn auroc_interval_contains_estimate() {
    let samples = dyadic_samples(400, 31);
    let ranking = Ranking::new(&samples);
    let objects = objects_of(400, 8);
    let interval = Bootstrap::new(2)
        .interval(&objects, |m| ranking.resampled_auroc(m))
        .unwrap();
    assert_eq!(Some(interval.estimate), ranking.auroc());
    assert!(interval.low < interval.estimate && interval.estimate < interval.high);
    assert!(interval.high - interval.low < 0.2);
    assert_eq!(interval.resamples, 2000);
}

#[test]
fn interval_matches_scikit_learn_and_numpy() {
    // roc_auc_score of scikit-learn 1.9.1 over the samples of the drawn objects, one by one, and
    // numpy.quantile of NumPy 2.4.6.
    let samples = dyadic_samples(60, 51);
    let ranking = Ranking::new(&samples);
    let bootstrap = Bootstrap {
        resamples: 200,
        seed: 9,
    };
    let interval = bootstrap
        .interval(&objects_of(60, 5), |m| ranking.resampled_auroc(m))
        .unwrap();
    assert!((interval.estimate - 0.773_081_201_334_816_6).abs() < 1e-12);
    assert!((interval.low - 0.717_449_944_382_647_4).abs() < 1e-12);
    assert!((interval.high - 0.846_881_981_254_040_1).abs() < 1e-12);
    assert_eq!(interval.resamples, 200);
}

#[test]
fn equal_seeds_give_equal_intervals() {
    let samples = dyadic_samples(100, 32);
    let ranking = Ranking::new(&samples);
    let objects = objects_of(100, 4);
    let interval = |seed| Bootstrap::new(seed).interval(&objects, |m| ranking.resampled_auroc(m));
    assert_eq!(interval(5), interval(5));
    assert_ne!(interval(5), interval(6));
    // Names of objects are only names.
    let renamed: Vec<usize> = objects.iter().map(|o| usize::MAX - 1000 + 3 * o).collect();
    let other = Bootstrap::new(5).interval(&renamed, |m| ranking.resampled_auroc(m));
    assert_eq!(interval(5), other);
}

#[test]
fn pairing_cancels_shared_variance() {
    let samples = dyadic_samples(300, 33);
    // Nearly the same model.
    let other: Vec<Scored> = mapped(&samples, |p| if p > 0.9 { 0.85 } else { p });
    let objects = objects_of(300, 6);
    let (a, b) = (Ranking::new(&samples), Ranking::new(&other));
    let bootstrap = Bootstrap::new(7);
    let single = bootstrap
        .interval(&objects, |m| a.resampled_auroc(m))
        .unwrap();
    let paired = bootstrap
        .paired_interval(&objects, |m| a.resampled_auroc(m), |m| b.resampled_auroc(m))
        .unwrap();
    assert_eq!(paired.estimate, a.auroc().unwrap() - b.auroc().unwrap());
    assert!(paired.high - paired.low < 0.3 * (single.high - single.low));
    let same =
        bootstrap.paired_interval(&objects, |m| a.resampled_auroc(m), |m| a.resampled_auroc(m));
    assert_eq!(same.map(|i| [i.low, i.estimate, i.high]), Some([0.0; 3]));
}

#[test]
fn undefined_resamples_are_ignored_and_counted() {
    // Two objects of one class each: half of the resamples have both.
    let samples = dyadic_samples(20, 34);
    let samples: Vec<Scored> = samples
        .iter()
        .enumerate()
        .map(|(i, s)| Scored {
            stable: i < 10,
            ..*s
        })
        .collect();
    let ranking = Ranking::new(&samples);
    let objects = objects_of(20, 10);
    let interval = Bootstrap::new(1)
        .interval(&objects, |m| ranking.resampled_auroc(m))
        .unwrap();
    assert!((900..1100).contains(&interval.resamples), "{interval:?}");
}

#[test]
fn interval_needs_two_objects_and_a_metric() {
    let bootstrap = Bootstrap::new(1);
    let one = |_: &[u32]| Some(1.0);
    assert_eq!(bootstrap.interval(&[], one), None);
    assert_eq!(bootstrap.interval(&[4, 4, 4], one), None);
    assert_eq!(bootstrap.interval(&[4, 5], |_| None), None);
    assert_eq!(bootstrap.interval(&[4, 5], |_| Some(f64::NAN)), None);
    let never = Bootstrap {
        resamples: 0,
        seed: 1,
    };
    assert_eq!(never.interval(&[4, 5], one), None);
}

#[test]
fn resampled_mean_uses_multiplicities_and_ignores_nan() {
    let values = [1.0, f64::NAN, 4.0];
    assert_eq!(resampled_mean(&values, &[3, 9, 1]), Some(7.0 / 4.0));
    assert_eq!(resampled_mean(&values, &[0, 9, 0]), None);
    assert_eq!(resampled_mean(&[], &[]), None);
}
