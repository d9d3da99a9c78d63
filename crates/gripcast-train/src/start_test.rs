use std::panic::AssertUnwindSafe;
use std::path::PathBuf;
use std::{fs, iter};

use std::slice::from_ref;

use super::*;
use crate::run::tests::settings;
use crate::sample_dataset::{graded_row, write_dataset, write_split};
use crate::{Comparison, Finished, TrainEvent, TrainSettings, Verdict, fine_tune, finish, train};
use gripcast_base::catch_panic::catch_panic;
use gripcast_base::error::ErrorKind;
use gripcast_dataset::shard::ShardRow;
use gripcast_imaging::{TactileDifference, encode_jpeg};
use gripcast_nn::predict::contract::Modality;
use gripcast_nn::predict::{BASELINE, Model};
use tempfile::TempDir;

/// A run of a start model on one dataset, and a dataset of own grasps with other gels.
struct Case {
    dir: TempDir,
    start: PathBuf,
    own: PathBuf,
}

/// A grasp of own gels: darker, of another tint.
fn own_row(split: &str, number: u64, objects: u64) -> ShardRow {
    let is_stable = number % 2 == 1;
    let mut row = graded_row(
        split,
        500 + number,
        is_stable,
        if is_stable { 0.8 } else { 0.1 },
    );
    row.facts.object = format!("own-{split}-{}", number / 2 % objects);
    let images = &mut row.images;
    let mut decoder = gripcast_imaging::Decoder::new().unwrap();
    for image in [
        &mut images.initial_left,
        &mut images.initial_right,
        &mut images.grasp_left,
        &mut images.grasp_right,
    ] {
        let mut pixels = decoder.stored_image(image).unwrap();
        pixels.pixels_mut().for_each(|pixel| {
            let [r, g, b] = pixel.0;
            pixel.0 = [r / 4, g, b / 2];
        });
        *image = encode_jpeg(&pixels, 85).unwrap();
    }
    row
}

fn write_own(data: &Path, train: u64, validation: u64, objects: u64) {
    let rows = |split: &'static str, count| (0..count).map(move |n| own_row(split, n, objects));
    write_split(data, "train", rows("train", train));
    write_split(data, "validation", rows("validation", validation));
}

fn own_settings() -> TrainSettings {
    TrainSettings {
        epochs: 2,
        ..settings(Modality::V)
    }
}

impl Case {
    fn new(modality: Modality) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let [data, start, own] = ["data", "start", "own"].map(|name| dir.path().join(name));
        write_dataset(&data, 24);
        train(from_ref(&data), &start, &settings(modality), None, &|_| {}).unwrap();
        let run = RunFolder::at(&start);
        let file = run.read().unwrap().unwrap();
        finish(&run, &file, from_ref(&data), "first", &|_| {}).unwrap();
        write_own(&own, 12, 8, 3);
        Self { dir, start, own }
    }

    fn model(&self) -> StartModel {
        StartModel::by_name(&self.start.display().to_string()).unwrap()
    }

    fn tuned(&self, name: &str, unfreeze_epochs: u32) -> (RunFolder, Finished) {
        let out = self.dir.path().join(name);
        let start = self.model();
        fine_tune(
            from_ref(&self.own),
            &out,
            &own_settings(),
            &start,
            unfreeze_epochs,
            &|_| {},
        )
        .unwrap();
        self.finished(out)
    }

    fn finished(&self, out: PathBuf) -> (RunFolder, Finished) {
        let run = RunFolder::at(out);
        let file = run.read().unwrap().unwrap();
        let finished = finish(&run, &file, from_ref(&self.own), "second", &|_| {}).unwrap();
        (run, finished)
    }
}

#[test]
fn head_alone_is_tuned_and_the_rest_comes_from_the_start_model() {
    let case = Case::new(Modality::Vt);
    let start = case.model();
    let (run, finished) = case.tuned("tuned", 0);
    let file = run.read().unwrap().unwrap();
    assert_eq!(file.settings.modality, Modality::Vt);
    assert_eq!(file.settings.architecture.name, "tiny");
    assert_eq!(file.normalisation(), start.normalisation());
    let (network, _) = run.best_network(&file.settings).unwrap();
    let mut params = network.layout().params().iter();
    let head = params
        .find(|param| param.name.starts_with("head"))
        .unwrap()
        .first;
    let [before, after] = [start.network(), &network].map(|n| n.parameters.split_at(head));
    assert!(before.0 == after.0, "the encoders changed");
    assert!(before.1 != after.1);
    assert!(network.running_stats == start.network().running_stats);

    let model = Model::from_bytes(&finished.onnx).unwrap();
    let contract = model.contract();
    assert_eq!(contract.inputs, start.contract().inputs);
    assert_eq!(contract.other["gripcast.start.sha256"], start.sha256());
    let objects = &contract.other[OBJECTS];
    assert!(objects.contains("\"train-object-1\"") && objects.contains("\"own-train-1\""));
    assert!(contract.card.contains("Fine-tuned") && !contract.card.contains("simulated"));
    let comparison = finished.comparison.unwrap();
    assert_eq!((comparison.objects, comparison.lifts), (3, 8));
    assert_ne!(comparison.verdict, Verdict::Better);
    assert!(contract.card.contains(&comparison.advice));
    // The model can be tuned again.
    assert!(StartModel::by_name(&run.model().display().to_string()).is_ok());
}

#[test]
fn own_gels_are_in_distribution_and_the_old_ones_no_longer() {
    let case = Case::new(Modality::T);
    let [start, tuned] = [case.model(), {
        case.tuned("tuned", 0);
        StartModel::by_name(&case.dir.path().join("tuned").display().to_string()).unwrap()
    }];
    let mut decoder = gripcast_imaging::Decoder::new().unwrap();
    let mut score = |model: &StartModel, row: &ShardRow| {
        let mut image = |bytes: &[u8]| decoder.stored_image(bytes).unwrap();
        let left = [&row.images.initial_left, &row.images.grasp_left];
        let [initial, grasp] = left.map(|bytes| image(bytes));
        let difference = TactileDifference::between(&initial, &grasp).unwrap();
        model.ood_detector().unwrap().score(&difference).unwrap()
    };
    for number in 0..6 {
        let own = own_row("test", number, 3);
        assert!(score(&tuned, &own) < 1.0, "{number}");
        let old = graded_row("test", 500 + number, true, 0.8);
        assert!(score(&start, &old) < 1.0, "{number}");
    }
    let [old, new] = [&start, &tuned].map(|model| model.ood_detector().unwrap());
    assert!(new.score_of_mean(old) > old.score_of_mean(old));
}

#[test]
fn killed_fine_tuning_resumes_to_same_bytes() {
    let case = Case::new(Modality::T);
    let (whole, finished) = case.tuned("whole", 2);
    let start = case.model();
    let broken = case.dir.path().join("broken");
    // In the epochs of the head, at the change, and in those of all parameters.
    for last in [1_u64, 6, 7, 11] {
        let killed = catch_panic(AssertUnwindSafe(|| {
            fine_tune(
                from_ref(&case.own),
                &broken,
                &own_settings(),
                &start,
                2,
                &|event| {
                    let is_last =
                        matches!(event, TrainEvent::Step { steps, .. } if steps[0] == last);
                    assert!(!is_last, "killed");
                },
            )
        }));
        assert!(killed.is_err(), "step {last}");
    }
    fine_tune(
        from_ref(&case.own),
        &broken,
        &own_settings(),
        &start,
        2,
        &|_| {},
    )
    .unwrap();
    let (broken, again) = case.finished(broken);
    assert!(again == finished);
    let state = |run: &RunFolder| fs::read(run.state().shown()).unwrap();
    assert!(state(&whole) == state(&broken));
}

#[test]
fn unfreezing_changes_the_encoders_and_not_their_statistics() {
    let case = Case::new(Modality::T);
    let start = case.model();
    let (run, _) = case.tuned("tuned", 2);
    let settings = run.read().unwrap().unwrap().settings;
    assert_eq!(settings.total_epochs(), 4);
    let (_, arrays): (serde_json::Value, _) = crate::state::load(&run.state()).unwrap();
    assert!(arrays[0][0] != start.network().parameters[0]);
    assert!(arrays[1] == start.network().running_stats);
}

#[test]
fn resuming_with_another_start_model_is_refused() {
    let case = Case::new(Modality::T);
    case.tuned("tuned", 0);
    let tuned = case.dir.path().join("tuned");
    let other = StartModel::by_name(&tuned.display().to_string()).unwrap();
    let error = fine_tune(
        from_ref(&case.own),
        &tuned,
        &own_settings(),
        &other,
        0,
        &|_| {},
    )
    .unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Usage);
    assert!(error.what().contains("start_sha256"), "{error}");
    let error = train(from_ref(&case.own), &tuned, &own_settings(), None, &|_| {}).unwrap_err();
    assert!(error.what().contains("fine_tuning"), "{error}");
}

#[test]
fn models_that_train_did_not_write_are_refused() {
    let case = Case::new(Modality::T);
    let error = StartModel::by_name(BASELINE).unwrap_err();
    assert!(error.what().contains("baseline-contact"), "{error}");
    let mut foreign = case.model().contract().clone();
    foreign.other.remove(ARCHITECTURE);
    let bytes = foreign.stamp(case.model().bytes()).unwrap();
    let path = case.dir.path().join("foreign.onnx");
    fs::write(&path, bytes).unwrap();
    let error = StartModel::by_name(&path.display().to_string()).unwrap_err();
    assert!(error.what().contains("`train` did not write it"), "{error}");
    assert!(error.to_string().contains("foreign.onnx"), "{error}");
    let error = StartModel::by_name(&case.own.display().to_string()).unwrap_err();
    assert!(error.what().contains("no model"), "{error}");
}

#[test]
fn own_grasps_with_another_crop_are_refused() {
    let case = Case::new(Modality::T);
    let rows = |split: &str| -> Vec<ShardRow> {
        let rows = (0..4).map(|n| {
            let mut row = own_row(split, n, 2);
            row.facts.crop_profile = "gsmini-seventh-v1".to_owned();
            row
        });
        rows.collect()
    };
    for split in ["train", "validation"] {
        write_split(&case.own, split, rows(split));
    }
    let out = case.dir.path().join("tuned");
    let error = fine_tune(
        from_ref(&case.own),
        &out,
        &own_settings(),
        &case.model(),
        0,
        &|_| {},
    )
    .unwrap_err();
    assert!(error.what().contains("crop profile"), "{error}");
    assert!(!out.exists());
}

#[test]
fn few_grasps_of_two_objects_are_tuned_and_nothing_is_claimed() {
    let case = Case::new(Modality::T);
    write_own(&case.own, 2, 2, 1);
    let (_, finished) = case.tuned("tuned", 1);
    let comparison: Comparison = finished.comparison.unwrap();
    assert_eq!((comparison.objects, comparison.lifts), (1, 2));
    assert!(comparison.auroc.is_none() && comparison.balanced_accuracy.is_none());
    assert_ne!(comparison.verdict, Verdict::Better);
}

#[test]
fn dataset_without_splits_is_explained_with_the_command_that_makes_them() {
    let case = Case::new(Modality::T);
    let data = case.dir.path().join("unsplit");
    write_split(&data, "test", iter::once(own_row("test", 0, 1)));
    let out = case.dir.path().join("tuned");
    let error = fine_tune(
        from_ref(&data),
        &out,
        &own_settings(),
        &case.model(),
        0,
        &|_| {},
    )
    .unwrap_err();
    assert!(error.what().contains("no split `train`"), "{error}");
    assert!(
        error.to_string().contains("gripcast dataset split"),
        "{error}"
    );
}
