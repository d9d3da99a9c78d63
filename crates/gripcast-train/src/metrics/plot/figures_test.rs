use super::super::reference_test::{dyadic_samples, flipped, scored, smooth_samples};
use super::super::{Bootstrap, Ranking, ReliabilityTable, Scored};
use super::*;
use gripcast_report::chart::layout::{check, number, tags, texts};

/// A name that must be escaped and shortened.
const LONG: &str = "A model <b>with</b> an exceedingly long name that no legend has room for";

fn curves(n: usize) -> Vec<(String, Vec<Scored>)> {
    let name = |i: usize| {
        if i == 1 {
            LONG.to_owned()
        } else {
            format!("M{i}")
        }
    };
    (0..n)
        .map(|i| (name(i), dyadic_samples(60, i as u64)))
        .collect()
}

#[test]
fn roc_layout_has_no_overlaps() {
    for n in [0, 1, 3, 14] {
        let curves: Vec<ModelCurve> = curves(n)
            .iter()
            .map(|(name, samples)| {
                let ranking = Ranking::new(samples);
                let objects: Vec<usize> = (0..samples.len()).map(|i| i / 6).collect();
                let bootstrap = Bootstrap {
                    resamples: 50,
                    seed: 1,
                };
                let interval = bootstrap.interval(&objects, |m| ranking.resampled_auroc(m));
                assert!(interval.is_some());
                ModelCurve::new(name, samples, interval)
            })
            .collect();
        let svg = roc(&curves).to_svg();
        check(&svg);
        assert_eq!(svg.matches("class=\"curve ").count(), 2 * n);
    }
}

#[test]
fn roc_legend_shows_areas() {
    let samples = scored(&[(0.9, true), (0.4, true), (0.4, false), (0.2, false)]);
    let one_class = scored(&[(0.9, true)]);
    let curves = [("V", &samples), ("T", &one_class)];
    let svg = roc(&curves.map(|(name, samples)| ModelCurve::new(name, samples, None))).to_svg();
    check(&svg);
    let texts = texts(&svg);
    assert!(texts.contains(&"AUROC 0.875".to_owned()), "{texts:?}");
    assert!(texts.contains(&"AUROC undefined".to_owned()), "{texts:?}");
    assert!(svg.contains("V: AUROC 0.875."));
    // Straight from (0, 1/2) to (1/2, 1), as the tie counts half; then along the top.
    let data = path(&[[0.0, 0.0], [0.0, 0.5], [0.5, 1.0], [1.0, 1.0]]);
    assert!(svg.contains(&data), "{data}");
}

/// The line through points of a square figure.
fn path(points: &[[f64; 2]]) -> String {
    let drawn = square("", "")
        .line("", points.iter().copied())
        .into_string();
    let (_, data) = drawn.split_once("d=").unwrap();
    data.to_owned()
}

#[test]
fn precision_recall_plot_shows_steps_and_chance() {
    let samples = scored(&[(0.9, true), (0.6, false), (0.4, true)]);
    let curve = ModelCurve::new("V", &samples, None);
    let svg = precision_recall(&[curve], Some(0.25)).to_svg();
    let third = 2.0 / 3.0;
    let steps = [
        [0.0, 1.0],
        [0.5, 1.0],
        [0.5, 0.5],
        [0.5, third],
        [1.0, third],
    ];
    assert!(svg.contains(&path(&steps)), "{svg}");
    let guide = square("", "").guide([0.0, 0.25], [1.0, 0.25]);
    assert!(svg.contains(&guide.into_string()), "{svg}");
    let texts = texts(&svg);
    assert!(texts.contains(&"AP 0.833".to_owned()) && texts.contains(&"AP 0.250".to_owned()));
}

#[test]
fn reliability_plot_shows_fractions_at_mean_probabilities() {
    let samples = scored(&[(0.9, true), (0.9, true), (0.9, true), (0.9, false)]);
    let svg = reliability("Reliability", &ReliabilityTable::new(&samples)).to_svg();
    let tags = tags(&svg);
    let drawn = |what: &str| tags.iter().find(|tag| tag.starts_with(what)).unwrap();
    let panel = square("", "");
    let (point, bar) = (drawn("circle"), drawn("rect class=\"pale"));
    let [x, y] = panel.to_px([0.9, 0.75]);
    assert!((number(point, "cx") - x).abs() < 0.1 && (number(point, "cy") - y).abs() < 0.1);
    assert!((number(bar, "y") - y).abs() < 0.1);
    // The bin from 13/15 to 14/15, with a little room at both sides.
    let [left, right] = [13.0, 14.0].map(|k| panel.to_px([k / 15.0, 0.0])[0]);
    let (x, width) = (number(bar, "x"), number(bar, "width"));
    assert!(x > left && x + width < right && width > 0.8 * (right - left));
}

#[test]
fn precision_recall_layout_has_no_overlaps() {
    for (n, fraction) in [
        (0, None),
        (1, Some(0.6)),
        (9, Some(1.0)),
        (2, Some(f64::NAN)),
    ] {
        let curves: Vec<ModelCurve> = curves(n)
            .iter()
            .map(|(name, samples)| ModelCurve::new(name, samples, None))
            .collect();
        let svg = precision_recall(&curves, fraction).to_svg();
        check(&svg);
        assert_eq!(svg.matches("class=\"curve ").count(), 2 * n);
        let has_chance = texts(&svg).contains(&"Chance".to_owned());
        assert_eq!(has_chance, fraction.is_some_and(f64::is_finite));
    }
}

#[test]
fn reliability_layout_has_no_overlaps() {
    let many = smooth_samples(120_000, 1);
    let few = dyadic_samples(30, 2);
    let wrong = flipped(&scored(&[(0.0, false), (1.0, true)]));
    for samples in [&many[..], &few, &wrong, &[]] {
        let table = ReliabilityTable::new(samples);
        let svg = reliability("Reliability", &table).to_svg();
        check(&svg);
        let filled = table.bins.iter().filter(|bin| bin.n > 0).count();
        // The legend has one too.
        assert_eq!(svg.matches("class=\"point ").count(), filled + 1);
    }
    let texts = texts(&reliability("", &ReliabilityTable::new(&wrong)).to_svg());
    assert!(
        texts.contains(&"ECE 1.000 over 2 grasps".to_owned()),
        "{texts:?}"
    );
}

fn bar(mean: f64, deviation: f64) -> Option<Bar> {
    Some(Bar {
        mean,
        interval: Some([mean - deviation, mean + deviation]),
        seeds: vec![mean - deviation, mean, mean + 0.5 * deviation, f64::NAN],
    })
}

fn chart(y_range: [f64; 2], series: usize, groups: usize) -> BarChart {
    let [low, high] = y_range;
    let value = |i: usize| low + (high - low) * (i * 7 % 11) as f64 / 10.0;
    let group = |g: usize| BarGroup {
        name: [LONG, "Seen", "Unseen objects", ""][g % 4].to_owned(),
        bars: (0..series)
            .map(|s| bar(value(series * g + s), 0.1 * (high - low)))
            .collect(),
    };
    BarChart {
        title: "Bars".to_owned(),
        y_label: LONG.to_owned(),
        y_range,
        series: (0..series)
            .map(|s| format!("Series {s} {}", &LONG[..7 * s]))
            .collect(),
        groups: (0..groups).map(group).collect(),
        interval_meaning: LONG.repeat(groups),
        reference: Some(Reference {
            name: LONG.to_owned(),
            value: value(3),
        }),
    }
}

#[test]
fn bar_chart_layout_has_no_overlaps() {
    for range in [
        [0.0, 1.0],
        [0.5, 1.0],
        [-0.2, 0.2],
        [0.0, 25_000.0],
        [0.0, 0.0],
    ] {
        for (series, groups) in [(0, 0), (0, 2), (1, 1), (1, 5), (3, 2), (8, 4)] {
            let chart = chart(range, series, groups);
            let svg = bars(&chart).to_svg();
            check(&svg);
            // One more of each series in the legend.
            assert_eq!(svg.matches("class=\"bar ").count(), series * (groups + 1));
        }
    }
}

#[test]
fn bars_end_at_their_values() {
    let mut chart = chart([0.0, 1.0], 1, 1);
    chart.groups[0].bars = vec![bar(0.75, 0.05)];
    let svg = bars(&chart).to_svg();
    let tags = tags(&svg);
    let tag = tags.iter().find(|tag| tag.contains("\"bar ")).unwrap();
    let whole = svg.split("class=\"grid\" d=\"").nth(1).unwrap();
    // The grid lines of 0 and 1 come first and last.
    let lines: Vec<f64> = whole[..whole.find('"').unwrap()]
        .split('M')
        .skip(1)
        .map(|line| line.split([' ', 'H']).nth(1).unwrap().parse().unwrap())
        .collect();
    let (zero, one) = (lines[0], lines[lines.len() - 1]);
    assert!((number(tag, "height") - 0.75 * (zero - one)).abs() < 0.1);
    assert!((number(tag, "y") + number(tag, "height") - zero).abs() < 0.2);
    assert!(texts(&svg).contains(&"0.750".to_owned()));
    assert_eq!(svg.matches("class=\"seed\"").count(), 3 + 1);
}

#[test]
fn negative_bars_start_at_zero() {
    let mut chart = chart([-0.5, 0.5], 2, 1);
    chart.groups[0].bars = vec![bar(-0.25, 0.01), bar(0.25, 0.01)];
    let svg = bars(&chart).to_svg();
    check(&svg);
    let tags = tags(&svg);
    let [down, up]: [&str; 2] = tags
        .iter()
        .filter(|tag| tag.contains("\"bar "))
        .take(2)
        .copied()
        .collect::<Vec<_>>()
        .try_into()
        .unwrap();
    let zero = number(down, "y");
    assert!((number(up, "y") + number(up, "height") - zero).abs() < 0.2);
    assert!((number(up, "height") - number(down, "height")).abs() < 0.2);
    assert!(number(up, "height") > 20.0);
    assert_eq!(svg.matches(&format!("{zero}H")).count(), 1, "grid");
    assert_eq!(svg.matches("class=\"axis\"").count(), 2, "edges and zero");
}

#[test]
fn missing_and_out_of_range_values_are_not_drawn() {
    let mut chart = chart([0.5, 1.0], 3, 1);
    chart.groups[0].bars = vec![bar(0.98, 0.05), None, bar(f64::NAN, 0.1)];
    chart.reference = Some(Reference {
        name: "Majority class".to_owned(),
        value: 0.4,
    });
    let svg = bars(&chart).to_svg();
    check(&svg);
    // One cap of the error bar from 0.93 to 1.03.
    let whisker = svg.split("class=\"whisker\"").nth(1).unwrap();
    assert_eq!(
        whisker[..whisker.find('>').unwrap()].matches("h8").count(),
        1
    );
    // 0.93 and 0.98 but not 1.005; none of the missing bars; one in the legend.
    assert_eq!(svg.matches("class=\"seed\"").count(), 2 + 1);
    assert_eq!(svg.matches("class=\"bar ").count(), 1 + 3);
    assert_eq!(texts(&svg).iter().filter(|t| t.as_str() == "–").count(), 2);
    // Only the legend's.
    assert_eq!(svg.matches("class=\"guide\"").count(), 1);
    assert!(texts(&svg).contains(&"Majority class 0.400".to_owned()));
}
