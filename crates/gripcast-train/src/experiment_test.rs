use std::fs;

use super::*;
use crate::sample_dataset::{row, write_dataset, write_split};
use gripcast_nn::{Architecture, ConvSpec};

#[test]
fn experiment_trains_tests_and_compares_conditions() {
    let folder = tempfile::tempdir().unwrap();
    let [fem, rigid, out] = ["fem", "rigid", "out"].map(|name| folder.path().join(name));
    for data in [&fem, &rigid] {
        write_dataset(data, 8);
        write_split(data, "test", (0..8).map(|number| row("test", number)));
    }
    let architecture = Architecture {
        name: "tiny".to_owned(),
        convolutions: vec![ConvSpec {
            channels: 16,
            kernel: 8,
            stride: 8,
            pad: 0,
        }],
        pool: [6, 8],
        embedding: 16,
        camera_embedding: 16,
        geometry: false,
        fallbacks: true,
        hidden: 16,
    };
    let settings = ExperimentSettings {
        tests: vec![TestSet {
            title: "Held-out objects".to_owned(),
            name: "held-out",
            data: fem.clone(),
            split: "test".to_owned(),
        }],
        fem,
        rigid: Some(rigid),
        with_depth: true,
        seeds: 2,
        training: TrainSettings {
            pretrain_epochs: 1,
            epochs: 2,
            batch_size: 4,
            ..TrainSettings::new(Modality::Vt, architecture, 0)
        },
        cameras: None,
    };
    let runs = std::sync::Mutex::new([0, 0]);
    let on_progress = |event| {
        let mut runs = runs.lock().unwrap();
        match event {
            ExperimentEvent::Run(..) => runs[0] += 1,
            ExperimentEvent::Train(_, _, TrainEvent::Epoch(_)) => runs[1] += 1,
            ExperimentEvent::Train(..) => {}
        }
    };
    let report = experiment(&settings, &out, 2, &on_progress).unwrap();
    assert_eq!(*runs.lock().unwrap(), [10, 20]);
    assert_eq!(report.results.len(), 5);
    assert_eq!(report.differences.len(), 5);
    for result in &report.results {
        assert_eq!((result.n, result.stable, result.seeds.len()), (8, 4, 2));
        let mean = result.over_seeds.auroc.unwrap().mean;
        assert!((result.auroc.unwrap().estimate - mean).abs() < 1e-12);
    }
    for name in ["fig6.svg", "fig6-auroc.svg"] {
        let chart = fs::read_to_string(out.join(name)).unwrap();
        assert!(
            chart.contains("V+T, rigid") && chart.contains("Held-out objects"),
            "{name}"
        );
    }
    // Models that also predict from fewer inputs are compared with all of theirs.
    for (condition, modality) in [
        ("v", "V"),
        ("t", "T"),
        ("vt", "VT"),
        ("vtd", "VTD"),
        ("vt-rigid", "VT"),
    ] {
        let cache = out.join(condition).join("seed-1/eval-held-out.json");
        let cached: serde_json::Value = serde_json::from_slice(&fs::read(cache).unwrap()).unwrap();
        assert_eq!(cached["evaluation"]["modality"], modality);
    }
    let written = fs::read(out.join("fig6.json")).unwrap();
    // Again: nothing is trained, and the figures are the same.
    assert_eq!(
        experiment(&settings, &out, 2, &on_progress).unwrap(),
        report
    );
    assert_eq!(*runs.lock().unwrap(), [20, 20]);
    assert_eq!(fs::read(out.join("fig6.json")).unwrap(), written);
    // Without the rigid-body simulator and depth the rest is the same.
    let three = ExperimentSettings {
        rigid: None,
        with_depth: false,
        ..settings.clone()
    };
    let found = experiment(&three, &out, 2, &on_progress).unwrap();
    assert_eq!(found.results[..], report.results[..3]);
    assert_eq!(found.differences[..], report.differences[1..4]);
    assert!(!found.datasets.contains_key("rigid"));
    let chart = fs::read_to_string(out.join("fig6.svg")).unwrap();
    assert!(chart.contains("V+T") && !chart.contains("rigid"));
    // Another test set is not mistaken for the old one.
    write_split(
        &settings.fem,
        "test",
        (0..6).map(|number| row("test", number)),
    );
    let error = experiment(&settings, &out, 2, &on_progress).unwrap_err();
    assert!(error.to_string().contains("another dataset"), "{error}");
    // A test set that cannot be read is found before anything is trained.
    let begun = *runs.lock().unwrap();
    let mut absent = settings.clone();
    absent.tests[0].data = out.clone();
    assert!(experiment(&absent, &folder.path().join("other"), 2, &on_progress).is_err());
    assert_eq!(*runs.lock().unwrap(), begun);
}
