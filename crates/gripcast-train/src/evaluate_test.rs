use super::*;
use crate::sample_dataset::{graded_row, row, write_dataset, write_split};
use crate::{conformal_scores, dataset_sha256, page};
use gripcast_nn::predict::{BASELINE, Model, SHIPPED, model_bytes};

fn evaluated(root: &std::path::Path, models: usize) -> (EvalReport, Samples) {
    let samples = Samples::open(root, "test").unwrap();
    let models: Vec<(String, Model)> = (0..models)
        .map(|i| (format!("model-{i}.onnx"), Model::baseline().unwrap()))
        .collect();
    let sha256 = dataset_sha256(&[root.to_owned()]).unwrap();
    let report = evaluate(&models, &samples, None, &sha256, &|_, _| {}).unwrap();
    (report, samples)
}

#[test]
fn heuristic_separates_sample_dataset() {
    let folder = tempfile::tempdir().unwrap();
    write_dataset(folder.path(), 8);
    write_split(
        folder.path(),
        "test",
        (0..12).map(|number| row("test", number)),
    );
    let (report, samples) = evaluated(folder.path(), 2);
    let model = &report.models[0];
    assert_eq!(
        (model.summary.n, model.summary.stable, report.objects),
        (12, 6, 4)
    );
    assert_eq!(model.summary.auroc, Some(1.0));
    assert_eq!(model.in_contact.n, 6, "stable grasps alone show a contact");
    assert_eq!(model.per_object.len(), 4);
    let chance = model.ece_by_chance.unwrap();
    assert!(chance.mean <= chance.high, "{chance:?}");
    let base = model.at_base_rate.unwrap();
    assert_eq!(base.base_rate, 0.5);
    assert!((base.ece - model.summary.ece.unwrap()).abs() < 1e-12);
    assert_eq!(model.forces.len(), 1);
    let difference = report.differences[0].auroc.unwrap();
    assert_eq!(
        [difference.estimate, difference.low, difference.high],
        [0.0; 3]
    );
    assert!(report.warnings.is_empty(), "{:?}", report.warnings);
    assert!(
        report.over_models.is_empty(),
        "two heuristics are not seeds of a training"
    );
    let html = page(&report, &samples).unwrap();
    for text in [
        "Stability prediction",
        "AUROC 1.000",
        "test-object-3",
        "by chance &lt; 0.",
        "data:",
    ] {
        assert!(text == "data:" || html.contains(text), "{text}");
    }
    assert!(!html.contains("<script") && !html.contains("at base rate"));
    let json = serde_json::to_string(&report).unwrap();
    assert_eq!(serde_json::from_str::<EvalReport>(&json).unwrap(), report);
    let mut uneven = report;
    uneven.models[0].at_base_rate = Some(BaseRateCalibration {
        base_rate: 0.75,
        ..base
    });
    let html = page(&uneven, &samples).unwrap();
    assert!(html.contains("at base rate 0.75: "));
    let html = page(&hostile(uneven), &samples).unwrap();
    for wrong in ["<script", "alert(\"", "\u{1}", "\u{202e}", "NaN"] {
        assert!(!html.contains(wrong), "{wrong:?}");
    }
    let escaped = "&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt;&amp;  ";
    assert!(html.matches(escaped).count() >= 10, "{html}");
}

#[test]
fn prediction_sets_need_scores_and_are_in_the_report() {
    let folder = tempfile::tempdir().unwrap();
    write_dataset(folder.path(), 32);
    let rows = (0..40).map(|number| {
        // A fifth of the grasps with contact slips.
        let is_stable = number % 2 == 1 && number % 5 != 0;
        graded_row("test", number, is_stable, (number % 10) as f32 / 10.0)
    });
    write_split(folder.path(), "test", rows);
    let (mut report, samples) = evaluated(folder.path(), 1);
    let plain = [("model-0.onnx".to_owned(), Model::baseline().unwrap())];
    report.add_sets(&plain, &samples, 0.1, false).unwrap();
    assert_eq!(report.models[0].conformal, None);
    let error = report.add_sets(&plain, &samples, 0.1, true).unwrap_err();
    assert!(error.to_string().contains("model-0.onnx"), "{error}");
    assert!(error.remedy_text().unwrap().contains("predict conformal"));

    let scores = conformal_scores(&plain[0].1, &samples, "these", &|_| ()).unwrap();
    let mut contract = plain[0].1.contract().clone();
    let key = gripcast_nn::predict::conformal::METADATA.to_owned();
    contract.other.insert(key, scores.to_metadata());
    let onnx = contract.stamp(&model_bytes(BASELINE).unwrap()).unwrap();
    let with_scores = [("model-0.onnx".to_owned(), Model::from_bytes(&onnx).unwrap())];
    report.add_sets(&with_scores, &samples, 0.2, true).unwrap();
    let sets = report.models[0].conformal.clone().unwrap();
    assert_eq!(
        (sets.scores_of.as_str(), sets.limits.error_rate),
        ("these", 0.2)
    );
    assert_eq!(sets.stable.n + sets.slip.n, 40);
    // On the grasps of the scores themselves both labels are covered.
    for label in [&sets.stable, &sets.slip] {
        assert!(label.coverage.unwrap() >= 0.8, "{label:?}");
    }
    assert!(sets.all.cant_tell.unwrap() > 0.0, "{sets:?}");
    let html = page(&report, &samples).unwrap();
    assert!(html.contains("Prediction sets: stable, slip or can") && html.contains("Coverage"));
    let json = serde_json::to_string(&report).unwrap();
    assert_eq!(serde_json::from_str::<EvalReport>(&json).unwrap(), report);
}

/// Returns the report with hostile names.
fn hostile(mut report: EvalReport) -> EvalReport {
    let name = || "<script>alert(\"1\")</script>&\u{1}\u{202e}".to_owned();
    report.software = name();
    report.dataset = name();
    report.split = name();
    report.warnings = vec![name()];
    report.differences[0].first = name();
    let model = &mut report.models[0];
    (model.file, model.name, model.sha256) = (name(), name(), name());
    for groups in [&mut model.categories, &mut model.per_object] {
        groups[0].name = name();
    }
    report
}

#[test]
fn report_shows_images_of_mistakes() {
    let folder = tempfile::tempdir().unwrap();
    let wrong = (0..6).map(|number| {
        let mut row = row("test", number);
        // Labels flipped: contact slips, no contact is stable.
        row.facts.outcome = match row.facts.outcome {
            gripcast_dataset::shard::ShardOutcome::Stable => {
                gripcast_dataset::shard::ShardOutcome::Slip
            }
            gripcast_dataset::shard::ShardOutcome::Slip => {
                gripcast_dataset::shard::ShardOutcome::Stable
            }
        };
        row
    });
    write_split(folder.path(), "test", wrong);
    let (report, samples) = evaluated(folder.path(), 1);
    let model = &report.models[0];
    assert_eq!(model.summary.auroc, Some(0.0));
    // One mistake of each of the four objects.
    let labels: Vec<bool> = model.mistakes.iter().map(|m| m.stable).collect();
    assert_eq!(labels, [true, true, false, false]);
    assert!(model.mistakes[0].p_stable <= model.mistakes[1].p_stable);
    assert!(model.mistakes[2].p_stable >= model.mistakes[3].p_stable);
    let html = page(&report, &samples).unwrap();
    assert_eq!(html.matches("data:image/jpeg").count(), 3 * 4);
}

#[test]
fn single_label_gives_warning() {
    let folder = tempfile::tempdir().unwrap();
    write_split(folder.path(), "test", (0..4).map(|n| row("test", 2 * n)));
    let (report, _) = evaluated(folder.path(), 1);
    assert!(
        report.warnings[0].contains("the same label"),
        "{:?}",
        report.warnings
    );
    assert_eq!(report.models[0].summary.auroc, None);
}

/// A regression test of decoding, the shipped model and the metrics; the synthetic set says nothing
/// about the quality of the model.
#[test]
fn shipped_model_keeps_its_metrics_on_synthetic_set() {
    let folder = tempfile::tempdir().unwrap();
    let rows = (0..24_u64).map(|number| {
        let contact = (number * 7 % 24) as f32 / 24.0;
        // Stronger contact is stable more often.
        let is_stable = (contact > 0.4) != (number % 5 == 0);
        let mut row = graded_row("test", number, is_stable, contact);
        row.facts.crop_profile = "gsmini-seventh-v1".to_owned();
        row
    });
    write_split(folder.path(), "test", rows);
    let samples = Samples::open(folder.path(), "test").unwrap();
    let model = Model::by_name(SHIPPED).unwrap();
    let models = [(SHIPPED.to_owned(), model)];
    let report = evaluate(&models, &samples, None, "", &|_, _| {}).unwrap();
    let summary = &report.models[0].summary;
    let matrix = &summary.confusion;
    let counts = [
        matrix.true_stable,
        matrix.false_stable,
        matrix.true_slip,
        matrix.false_slip,
    ];
    let figures = [
        summary.auroc,
        summary.average_precision,
        summary.brier,
        summary.log_loss,
        summary.ece,
    ]
    .map(Option::unwrap);
    assert_eq!(counts, [4, 2, 9, 9]);
    let expected = [
        0.734_265_734_265_734_3,
        0.674_245_412_706_951_2,
        0.243_058_441_831_858_9,
        0.675_008_258_904_244,
        0.317_569_875_475_96,
    ];
    for (found, expected) in figures.into_iter().zip(expected) {
        assert!((found - expected).abs() < 1e-6, "{figures:?}");
    }
}

#[test]
fn mean_over_models_needs_seeds_of_one_training() {
    let folder = tempfile::tempdir().unwrap();
    let rows = (0..4).map(|number| row("test", number));
    write_split(folder.path(), "test", rows);
    let samples = Samples::open(folder.path(), "test").unwrap();
    let trained = |seed: u64, data: &str, architecture: &str| {
        let bytes = gripcast_nn::predict::baseline::onnx_bytes().unwrap();
        let mut contract = gripcast_nn::predict::baseline::contract();
        contract.origin = Origin::Trained {
            seed,
            manifest_sha256: data.repeat(32),
        };
        contract.crop_profile = Some(gripcast_imaging::CropProfile::FULL);
        let architecture = (ARCHITECTURE.to_owned(), architecture.to_owned());
        contract.other.extend([architecture]);
        let bytes = contract.stamp(&bytes).unwrap();
        (format!("{seed}.onnx"), Model::from_bytes(&bytes).unwrap())
    };
    let over = |models: [(String, Model); 2]| {
        let report = evaluate(&models, &samples, None, "", &|_, _| {}).unwrap();
        report.over_models.first().map(|over| over.summary.seeds)
    };
    let first = || trained(1, "0a", "gripcast");
    assert_eq!(over([first(), trained(2, "0a", "gripcast")]), Some(2));
    for other in [
        trained(1, "0a", "gripcast"),
        trained(2, "0b", "gripcast"),
        trained(2, "0a", "small"),
        ("heuristic".to_owned(), Model::baseline().unwrap()),
    ] {
        assert_eq!(over([first(), other]), None);
    }
}

#[test]
fn images_shared_with_the_training_split_give_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    write_dataset(folder.path(), 8);
    let mut rows: Vec<_> = (0..4).map(|number| row("test", number)).collect();
    rows[1].images.grasp_right = row("train", 3).images.grasp_right;
    write_split(folder.path(), "test", rows);
    let [training, samples] =
        ["train", "test"].map(|split| Samples::open(folder.path(), split).unwrap());
    let models = [("baseline".to_owned(), Model::baseline().unwrap())];
    let report = evaluate(&models, &samples, Some(&training), "", &|_, _| {}).unwrap();
    assert_eq!(report.warnings.len(), 1, "{:?}", report.warnings);
    let example = "`test-0001` and `train-0003`";
    assert!(
        report.warnings[0].contains(example),
        "{:?}",
        report.warnings
    );
}
