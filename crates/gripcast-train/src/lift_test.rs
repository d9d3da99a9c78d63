use super::*;
use crate::sample_dataset::{row, write_split};
use gripcast_base::random::SeedStream;
use gripcast_imaging::ObjectMotion;
use gripcast_shear::GelMotion;

/// A lift whose level falls by `fall` per image, with noise; the object drops by 0.2 mm per image if
/// `is_dropped`.
fn lift(fall: f64, is_dropped: Option<bool>, draw: &mut SeedStream) -> LiftMotion {
    let images = (0..LiftMotion::FRAMES).map(|image| {
        let level = 10.0 * (1.0 - fall * image as f64) + draw.between(-1.0, 1.0);
        let gel = GelMotion {
            level: level.max(0.1),
            contact_fraction: 0.2,
            displacement_mm: [0.0, draw.between(0.0, 0.2)],
            confidence: 1.0,
            ..GelMotion::default()
        };
        let object = is_dropped.map(|is_dropped| {
            let drop_mm = 0.2 * image as f64 * f64::from(u8::from(is_dropped));
            ObjectMotion::from_array([drop_mm + draw.between(-0.1, 0.1), f64::NAN, f64::NAN])
        });
        LiftImage {
            gels: [gel; 2],
            object,
        }
    });
    LiftMotion {
        images: images.collect(),
    }
}

fn samples(root: &std::path::Path, split: &str, count: u64, with_object: bool) -> Samples {
    let mut draw = SeedStream::named(1, split);
    let rows = (0..count).map(|number| {
        let mut row = row(split, number);
        let is_slip = row.facts.outcome.label() == 0;
        let fall = if is_slip { 0.1 } else { 0.0 };
        row.facts.lift = Some(lift(fall, with_object.then_some(is_slip), &mut draw));
        row
    });
    write_split(root, split, rows);
    Samples::open(root, split).unwrap()
}

#[test]
fn verdict_improves_in_the_lift_and_warns_of_losses() {
    let folder = tempfile::tempdir().unwrap();
    let [train, validation, test] =
        ["train", "validation", "test"].map(|split| samples(folder.path(), split, 120, false));
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
    assert!(head.with_object.is_none() && found.with_object == 0.0);
}

#[test]
fn motion_of_the_object_is_used_where_lifts_have_it() {
    let folder = tempfile::tempdir().unwrap();
    let [train, validation, test] =
        ["train", "validation", "test"].map(|split| samples(folder.path(), split, 120, true));
    let facts = validation.facts().iter();
    let logits = facts.map(|facts| Logit {
        logit: 0.0,
        is_stable: facts.is_stable,
    });
    let logits: Vec<Logit> = logits.collect();
    let head = fit(&train, &validation, &logits, 1.0, 3).unwrap();
    let from_all = LiftEvaluation::new(&head, &test, &[0.5; 120]).unwrap();
    assert_eq!(from_all.with_object, 1.0);
    let gels = LiftHead {
        with_object: None,
        ..head.clone()
    };
    let from_gels = LiftEvaluation::new(&gels, &test, &[0.5; 120]).unwrap();
    assert_eq!(from_gels.with_object, 0.0);
    let auroc = |found: &LiftEvaluation, at: usize| found.points[at].auroc.unwrap().estimate;
    let [all, gels] = [&from_all, &from_gels].map(|found| auroc(found, 1));
    assert!(all > gels + 0.005, "{all} {gels}");
    // Lifts without it are judged by their gels.
    let unseen = samples(folder.path(), "other", 40, false);
    let unseen = LiftEvaluation::new(&head, &unseen, &[0.5; 40]).unwrap();
    assert_eq!(unseen.with_object, 0.0);
    assert!(auroc(&unseen, 4) > 0.9);
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
    let mut motion = lift(0.0, None, &mut SeedStream::named(2, "loss"));
    assert_eq!(loss(&motion), None);
    for image in &mut motion.images[3..] {
        image.gels[1].contact_fraction = 0.0;
    }
    assert_eq!(loss(&motion), Some(3));
}
