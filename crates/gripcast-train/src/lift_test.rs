use super::*;
use crate::sample_dataset::{row, write_split};
use gripcast_shear::GelMotion;

/// A lift whose level falls by `fall` per image, with noise.
fn lift(fall: f64, draw: &mut SeedStream) -> LiftMotion {
    let frames = (0..LiftMotion::FRAMES).map(|image| {
        let level = 10.0 * (1.0 - fall * image as f64) + draw.between(-1.0, 1.0);
        let gel = GelMotion {
            level: level.max(0.1),
            contact_fraction: 0.2,
            displacement_mm: [0.0, draw.between(0.0, 0.2)],
            confidence: 1.0,
            ..GelMotion::default()
        };
        [gel; 2]
    });
    LiftMotion {
        frames: frames.collect(),
    }
}

fn samples(root: &std::path::Path, split: &str, count: u64) -> Samples {
    let mut draw = SeedStream::named(1, split);
    let rows = (0..count).map(|number| {
        let mut row = row(split, number);
        let is_slip = row.facts.outcome.label() == 0;
        let fall = if is_slip { 0.1 } else { 0.0 };
        row.facts.lift = Some(lift(fall, &mut draw));
        row
    });
    write_split(root, split, rows);
    Samples::open(root, split).unwrap()
}

#[test]
fn verdict_improves_in_the_lift_and_warns_of_losses() {
    let folder = tempfile::tempdir().unwrap();
    let [train, validation, test] =
        ["train", "validation", "test"].map(|split| samples(folder.path(), split, 120));
    // The prediction before the lift knows nothing.
    let logits: Vec<Logit> = validation
        .facts()
        .iter()
        .map(|facts| Logit {
            logit: 0.0,
            is_stable: facts.is_stable,
        })
        .collect();
    let head = fit(&train, &validation, &logits, 1.0, 3).unwrap();
    assert_eq!(head, fit(&train, &validation, &logits, 1.0, 3).unwrap());
    let text = head.to_metadata();
    assert_eq!(LiftHead::from_metadata(&text).unwrap(), head);
    let found = LiftEvaluation::new(&head, &test, &[0.5; 120]).unwrap();
    assert_eq!(found.lifts, [120, 60]);
    let auroc = |at: usize| found.points[at].auroc.unwrap().estimate;
    assert!(
        auroc(4) > 0.97 && auroc(4) > auroc(0),
        "{} {}",
        auroc(0),
        auroc(4)
    );
    assert!((found.points[1].lifted_m - 1.6e-3).abs() < 1e-12);
    assert!(found.alarmed_held.unwrap().estimate < 0.15);
    assert!(found.alarmed_slips.unwrap().estimate > 0.8);
    assert!(found.alarmed_slips_any.unwrap().estimate >= found.alarmed_slips.unwrap().estimate);
    assert_eq!(found.lost_at_once.unwrap().estimate, 0.0);
}

#[test]
fn too_few_lifts_with_motion_give_no_head() {
    let folder = tempfile::tempdir().unwrap();
    let [train, validation] = ["train", "validation"].map(|split| {
        write_split(
            folder.path(),
            split,
            (0..50).map(|number| row(split, number)),
        );
        Samples::open(folder.path(), split).unwrap()
    });
    let logits = vec![
        Logit {
            logit: 0.0,
            is_stable: true
        };
        50
    ];
    assert_eq!(fit(&train, &validation, &logits, 1.0, 3), None);
}

#[test]
fn alarm_after_the_loss_is_none() {
    let mut motion = lift(0.0, &mut SeedStream::named(2, "loss"));
    assert_eq!(loss(&motion), None);
    for frame in &mut motion.frames[3..] {
        frame[1].contact_fraction = 0.0;
    }
    assert_eq!(loss(&motion), Some(3));
}

#[test]
fn gradient_is_that_of_the_loss() {
    let mut draw = SeedStream::named(4, "gradient");
    let rows: Vec<Row> = (0..30)
        .map(|i| Row {
            features: std::array::from_fn(|_| draw.between(-1.0, 1.0)),
            is_stable: i % 3 == 0,
            weight: 0.5 + (i % 2) as f64,
        })
        .collect();
    let network = train_network(&rows, 1).unwrap();
    let inputs: Vec<Vec<f64>> = rows
        .iter()
        .map(|row| network.standardised(&row.features).collect())
        .collect();
    let total: f64 = rows.iter().map(|row| row.weight).sum();
    let loss = |network: &MotionNetwork| -> f64 {
        let losses = rows.iter().map(|row| {
            let logit = network.logit(&row.features);
            let target = f64::from(u8::from(row.is_stable));
            row.weight / total * ((-logit.abs()).exp().ln_1p() + logit.max(0.0) - target * logit)
        });
        losses.sum()
    };
    let found = gradient(&network, &rows, &inputs, total);
    let width = FEATURES + 1;
    for at in [
        0,
        FEATURES,
        3 * width + 5,
        HIDDEN * width + 2,
        HIDDEN * width + HIDDEN,
    ] {
        let moved = |way: f64| {
            let mut network = network.clone();
            let all = network
                .hidden
                .iter_mut()
                .flatten()
                .chain(&mut network.output);
            *all.into_iter().nth(at).unwrap() += way;
            loss(&network)
        };
        // Small, as a unit may switch within a larger step.
        let expected = (moved(1e-7) - moved(-1e-7)) / 2e-7;
        let error = (found[at] - expected).abs();
        assert!(
            error < 1e-6 * (1.0 + 10.0 * expected.abs()),
            "{at}: {} {expected}",
            found[at]
        );
    }
}
