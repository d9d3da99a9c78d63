use gripcast_base::error::ErrorKind;
use std::panic::AssertUnwindSafe;

use std::slice::from_ref;

use super::*;
use crate::augment::{Augmentation, SampleImages};
use crate::sample_dataset::{row, write_dataset, write_split};
use crate::samples::SampleReader;
use crate::{evaluate, finish, logits};
use gripcast_base::catch_panic;
use gripcast_nn::predict::contract::Modality;
use gripcast_nn::predict::{Model, ModelInput, grasp_head, training_base_rate};
use gripcast_nn::{Architecture, ConvSpec};
use gripcast_shear::ContactMaps;

pub(crate) fn settings(modality: Modality) -> TrainSettings {
    let conv = |channels, kernel, stride, pad| ConvSpec {
        channels,
        kernel,
        stride,
        pad,
    };
    let architecture = Architecture {
        name: "tiny".to_owned(),
        convolutions: vec![conv(16, 8, 8, 0), conv(16, 3, 2, 1)],
        pool: [3, 4],
        embedding: 16,
        camera_embedding: 10,
        geometry: true,
        fallbacks: true,
        hidden: 16,
    };
    TrainSettings {
        pretrain_epochs: 1,
        epochs: 3,
        batch_size: 4,
        warm_up_steps: 1,
        learning_rate: 3e-3,
        ..TrainSettings::new(modality, architecture, 5)
    }
}

fn without_times(folder: &RunFolder) -> Vec<EpochMetrics> {
    let text = fs::read_to_string(folder.metrics().shown()).unwrap();
    let lines = text.lines().map(|line| serde_json::from_str(line).unwrap());
    lines
        .map(|metrics: EpochMetrics| EpochMetrics {
            samples_per_s: 0.0,
            ..metrics
        })
        .collect()
}

#[test]
fn exported_model_matches_network() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    write_dataset(&data, 24);
    let out = folder.path().join("run");
    for modality in [Modality::Vtd, Modality::T, Modality::V] {
        let settings = TrainSettings {
            epochs: 6,
            ..settings(modality)
        };
        let out = out.join(modality.name());
        let trained = train(from_ref(&data), &out, &settings, None, &|_| {}).unwrap();
        // One epoch of the extents; without touch one to fit the heads that read them.
        let epochs = [(Modality::Vtd, 7), (Modality::T, 6), (Modality::V, 2)];
        let expected = epochs
            .into_iter()
            .find(|(of, _)| *of == modality)
            .unwrap()
            .1;
        assert_eq!(trained.epochs, expected);
        if modality != Modality::V {
            assert!(trained.best.validation_auroc.unwrap() > 0.9, "{trained:?}");
        }
        let run = RunFolder::at(&out);
        let file = run.read().unwrap().unwrap();
        let validation = Samples::open(&data, "validation").unwrap();
        let finished = finish(&run, &file, from_ref(&data), "tiny", &|_| {}).unwrap();
        assert_eq!(fs::read(run.model().shown()).unwrap(), finished.onnx);
        let model = Model::from_bytes(&finished.onnx).unwrap();
        assert_eq!(model.contract().modality, modality);
        assert_eq!(model.ood_detector().is_some(), modality.has_touch());
        let has_geometry = trained.best.validation_geometry_error_m.is_some();
        assert_eq!(has_geometry, modality != Modality::T);
        let sets = model.conformal_scores().unwrap();
        let [slip, stable] = validation.by_label();
        assert_eq!(
            (sets.source(), sets.grasps()),
            ("validation", [slip, stable])
        );
        assert_eq!(training_base_rate(model.contract()), 0.5);
        let (network, _) = run.best_network(&settings).unwrap();
        let found = logits(
            &network,
            &validation,
            &settings,
            file.normalisation(),
            &|_| {},
        )
        .unwrap();
        // Epochs after the first update these predictions instead of reading all images again.
        let error = Scores::new(found.best()).loss - trained.best.validation_loss;
        assert!(error.abs() < 1e-6, "{modality:?}: {error}");
        let mut reader = SampleReader::new(&validation, 0);
        let mut decoder = gripcast_imaging::Decoder::new().unwrap();
        for (i, logit) in found.best().iter().enumerate() {
            let (rows, row) = reader.rows(&[i]).unwrap().remove(0);
            let images =
                SampleImages::decode(&mut decoder, &rows[row].images, Modality::Vtd).unwrap();
            let mut input = ModelInput::new(model.contract()).unwrap();
            let names = [
                gripcast_nn::predict::contract::InputName::TactileLeft,
                gripcast_nn::predict::contract::InputName::TactileRight,
            ];
            for (name, [initial, grasp]) in names.into_iter().zip(&images.tactile) {
                let difference =
                    gripcast_imaging::TactileDifference::between(initial, grasp).unwrap();
                input.set_tactile(name, &difference).unwrap();
            }
            input.set_rgb(&images.rgb).unwrap();
            input.set_depth(images.depth.as_ref().unwrap()).unwrap();
            let predicted = model.predict(&input).unwrap().p_stable;
            let expected = logit.scored(finished.temperature).p_stable;
            assert!(
                (predicted - expected).abs() < 1e-5,
                "{predicted} {expected}"
            );
        }
    }
}

#[test]
fn contact_maps_are_learned_before_the_labels() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    for (split, rows) in [(TRAIN, 200), (VALIDATION, 48)] {
        let rows = (0..rows).map(|number| {
            let mut row = row(split, number);
            let depth_m = 2e-4 * (number % 2) as f64;
            let cells = ContactMaps::LEN / ContactMaps::COMPONENTS;
            let values = (0..cells).flat_map(|_| [0.0, 0.0, depth_m]);
            row.facts.contact = ContactMaps::new(values.collect());
            row
        });
        write_split(&data, split, rows);
    }
    let mut settings = settings(Modality::Vtd);
    let last = settings.architecture.convolutions[1];
    settings.architecture.convolutions.push(last);
    settings.architecture.pool = [2, 2];
    (settings.contact_epochs, settings.epochs) = (2, 2);
    let out = folder.path().join("run");
    let trained = train(from_ref(&data), &out, &settings, None, &|_| {}).unwrap();
    // One epoch of the extents, two of the maps, two of the labels.
    assert_eq!(trained.epochs, 5);
    assert!(trained.best_epoch > 3, "{trained:?}");
    let run = RunFolder::at(&out);
    let epochs = without_times(&run);
    assert!(
        epochs[2].train_loss < 0.7 * epochs[1].train_loss,
        "{epochs:?}"
    );
    // The model predicts from the maps what training found.
    let file = run.read().unwrap().unwrap();
    let finished = finish(&run, &file, from_ref(&data), "maps", &|_| {}).unwrap();
    let validation = Samples::open(&data, VALIDATION).unwrap();
    let evaluated = |onnx: &[u8]| {
        let model = Model::from_bytes(onnx).unwrap();
        assert_eq!(model.contract().contact.len(), 2);
        assert!(model.contract().other.contains_key(grasp_head::METADATA));
        let models = [("maps".to_owned(), model)];
        let report = evaluate(&models, &validation, None, "", &|_, _| {}).unwrap();
        report.models[0].summary.clone()
    };
    let found = evaluated(&finished.onnx);
    assert!((found.brier.unwrap() - finished.validation.brier.unwrap()).abs() < 1e-5);
    assert_eq!(found.confusion, finished.validation.confusion);
    // Fine-tuning keeps the trees.
    let start = StartModel::by_name(out.to_str().unwrap()).unwrap();
    let own = folder.path().join("own");
    write_dataset(&own, 24);
    let tuned = folder.path().join("tuned");
    fine_tune(from_ref(&own), &tuned, &settings, &start, 0, &|_| {}).unwrap();
    let tuned = RunFolder::at(&tuned);
    let file = tuned.read().unwrap().unwrap();
    let tuned = finish(&tuned, &file, from_ref(&own), "tuned", &|_| {}).unwrap();
    let found = StartModel::from_bytes(tuned.onnx).unwrap();
    let trees = |model: &StartModel| model.grasp_head().estimators[0].trees.clone();
    assert_eq!(trees(&found), trees(&start));
    // A network whose feature map has other cells does not.
    let other = self::settings(Modality::T);
    let trained = train(
        from_ref(&data),
        &folder.path().join("other"),
        &other,
        None,
        &|_| {},
    );
    assert_eq!(trained.unwrap().epochs, 3);
}

#[test]
fn killed_run_resumes_to_same_bytes() {
    let settings = &settings(Modality::T);
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    write_dataset(&data, 24);
    let [whole, broken] = ["whole", "broken"].map(|name| folder.path().join(name));
    train(from_ref(&data), &whole, settings, None, &|_| {}).unwrap();
    for last in [1_u64, 8, 14] {
        let killed = catch_panic::catch_panic(AssertUnwindSafe(|| {
            train(from_ref(&data), &broken, settings, None, &|event| {
                let is_last = matches!(event, TrainEvent::Step { steps, .. } if steps[0] == last);
                assert!(!is_last, "killed");
            })
        }));
        assert!(killed.is_err(), "step {last}");
    }
    train(from_ref(&data), &broken, settings, None, &|_| {}).unwrap();
    let [whole, broken] = [whole, broken].map(RunFolder::at);
    assert_eq!(without_times(&whole), without_times(&broken));
    let network = |folder: &RunFolder| folder.best_network(settings).unwrap().0.parameters;
    assert!(network(&whole) == network(&broken));
    let state = |folder: &RunFolder| state::load::<Position>(&folder.state()).unwrap();
    assert!(state(&whole) == state(&broken));
}

#[test]
fn run_resumes_within_epoch() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    write_dataset(&data, 24);
    let settings = settings(Modality::T);
    let file = {
        let train = Samples::open(&data, TRAIN).unwrap();
        let out = folder.path().join("run");
        fs::create_dir_all(&out).unwrap();
        open_or_create(
            &RunFolder::at(&out),
            from_ref(&data),
            &settings,
            None,
            &train,
        )
        .unwrap()
    };
    let [train, validation] = [TRAIN, VALIDATION].map(|split| Samples::open(&data, split).unwrap());
    let run = RunFolder::at(folder.path().join("run"));
    let mut whole = Training::new(&run, &file, None, &train, &validation).unwrap();
    whole.epoch(&|_| {}).unwrap();
    let broken =
        std::cell::RefCell::new(Training::new(&run, &file, None, &train, &validation).unwrap());
    // The checkpoint is written where the panic leaves the run: after a step and its update.
    let killed = catch_panic::catch_panic(AssertUnwindSafe(|| {
        let mut training = broken.borrow_mut();
        training.epoch(&|event| {
            let is_third = matches!(event, TrainEvent::Step { steps, .. } if steps[0] == 3);
            assert!(!is_third, "killed");
        })
    }));
    assert!(killed.is_err());
    broken.borrow_mut().save().unwrap();
    let mut again = Training::new(&run, &file, None, &train, &validation).unwrap();
    assert_eq!(again.position.step, 3);
    again.epoch(&|_| {}).unwrap();
    assert!(again.network.parameters == whole.network.parameters);
    assert_eq!(again.position.loss_sum, whole.position.loss_sum);
}

#[test]
fn resuming_with_other_settings_or_dataset_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    write_dataset(&data, 8);
    let out = folder.path().join("run");
    let one = TrainSettings {
        epochs: 1,
        ..settings(Modality::T)
    };
    train(from_ref(&data), &out, &one, None, &|_| {}).unwrap();
    let other = TrainSettings {
        dropout: 0.5,
        ..one.clone()
    };
    let error = train(from_ref(&data), &out, &other, None, &|_| {}).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Usage);
    assert!(
        error.to_string().contains("dropout 0.2, not 0.5"),
        "{error}"
    );
    write_dataset(&data, 12);
    let error = train(from_ref(&data), &out, &one, None, &|_| {}).unwrap_err();
    assert!(error.to_string().contains("another dataset"), "{error}");
}

#[test]
fn several_datasets_are_trained_on_together() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
    write_dataset(&a, 8);
    // No objects of `a`, no depth and nothing for validation.
    let own = (0..5).map(|number| {
        let mut row = row("own", number);
        row.images.grasp_depth = None;
        row
    });
    write_split(&b, TRAIN, own);
    let out = folder.path().join("run");
    let settings = TrainSettings {
        epochs: 1,
        pretrain_epochs: 1,
        ..settings(Modality::Vtd)
    };
    let both = [b.clone(), a.clone()];
    train(&both, &out, &settings, None, &|_| {}).unwrap();
    let run = RunFolder::at(&out);
    let file = run.read().unwrap().unwrap();
    for object in ["own-object-0", "train-object-0"] {
        assert!(file.objects.iter().any(|name| name == object), "{file:?}");
    }
    let finished = finish(&run, &file, &both, "both", &|_| {}).unwrap();
    assert_eq!(finished.validation.n, 4);
    let error = train(from_ref(&a), &out, &settings, None, &|_| {}).unwrap_err();
    assert!(error.to_string().contains("another dataset"), "{error}");

    // An object of `a` in the validation split of `b`.
    write_split(&b, VALIDATION, (0..4).map(|number| row(TRAIN, number)));
    let error = train(&both, &folder.path().join("x"), &settings, None, &|_| {}).unwrap_err();
    assert!(error.what().contains("train-object-0"), "{error}");
    let nowhere = [a, folder.path().join("nowhere")];
    let error = train(&nowhere, &out, &settings, None, &|_| {}).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::NotFound, "{error}");
}

#[test]
fn runs_of_other_versions_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    write_dataset(&data, 8);
    let out = folder.path().join("run");
    let settings = TrainSettings {
        epochs: 1,
        ..settings(Modality::Vt)
    };
    train(from_ref(&data), &out, &settings, None, &|_| {}).unwrap();
    let run = RunFolder::at(&out);
    let mut older = serde_json::to_value(run.read().unwrap().unwrap()).unwrap();
    older["version"] = 1.into();
    fs::write(run.run().shown(), older.to_string()).unwrap();
    let error = train(from_ref(&data), &out, &settings, None, &|_| {}).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Usage);
    assert!(error.to_string().contains("found version 1"), "{error}");
}

#[test]
fn unusable_datasets_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let settings = settings(Modality::T);
    let refused = |name: &str, rows: Vec<gripcast_dataset::shard::ShardRow>, validation: &str| {
        let data = folder.path().join(name);
        write_split(&data, "train", rows);
        write_split(&data, "validation", (0..4).map(|n| row(validation, n)));
        let out = folder.path().join(format!("{name}-run"));
        let error = train(from_ref(&data), &out, &settings, None, &|_| {}).unwrap_err();
        assert!(!out.exists(), "{name}");
        error.to_string()
    };
    let stable = (0..8).map(|n| row("train", 2 * n + 1)).collect();
    let text = refused("one", stable, "validation");
    assert!(text.contains("8 stable and 0 slip"), "{text}");
    let text = refused("leak", (0..8).map(|n| row("train", n)).collect(), "train");
    assert!(text.contains("objects are in both"), "{text}");
    let mut cropped: Vec<_> = (0..8).map(|n| row("train", n)).collect();
    cropped[3].facts.crop_profile = "paper".to_owned();
    let text = refused("crops", cropped, "validation");
    assert!(
        text.contains("different crop profiles: full-v1, paper"),
        "{text}"
    );
    let text = refused("none", Vec::new(), "validation");
    assert!(text.contains("no samples"), "{text}");
}

#[test]
fn image_of_wrong_size_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut rows: Vec<_> = (0..8).map(|n| row("train", n)).collect();
    let small = image::RgbImage::new(160, 120);
    rows[5].images.grasp_left = gripcast_imaging::encode_jpeg(&small, 90).unwrap();
    write_split(folder.path(), "train", rows);
    write_split(
        folder.path(),
        "validation",
        (0..4).map(|n| row("validation", n)),
    );
    let out = folder.path().join("run");
    let error = train(
        &[folder.path().to_owned()],
        &out,
        &settings(Modality::T),
        None,
        &|_| {},
    )
    .unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("train-0005") && text.contains("160×120"),
        "{text}"
    );
}

#[test]
fn nan_loss_ends_run_and_keeps_best_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    write_dataset(&data, 8);
    let out = folder.path().join("run");
    let settings = TrainSettings {
        epochs: 2,
        augmentation: Augmentation::NONE,
        ..settings(Modality::T)
    };
    let run = RunFolder::at(&out);
    // The first epoch ends; then a parameter is spoilt, as an overflow would.
    let killed = catch_panic::catch_panic(AssertUnwindSafe(|| {
        train(from_ref(&data), &out, &settings, None, &|event| {
            assert!(!matches!(event, TrainEvent::Epoch(_)), "killed");
        })
    }));
    assert!(killed.is_err());
    let (position, mut arrays): (Position, _) = state::load(&run.state()).unwrap();
    arrays[0][0] = f32::NAN;
    let arrays: Vec<&[f32]> = arrays.iter().map(Vec::as_slice).collect();
    state::save(&run.state(), &position, &arrays).unwrap();
    let best = fs::read(run.best().shown()).unwrap();
    let error = train(from_ref(&data), &out, &settings, None, &|_| {}).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("NaN or infinite in epoch 2"), "{text}");
    assert!(text.contains("of epoch 1, is kept"), "{text}");
    assert_eq!(fs::read(run.best().shown()).unwrap(), best);
}

#[test]
fn batch_size_is_limited_to_the_training_samples() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    write_dataset(&data, 6);
    let settings = TrainSettings {
        epochs: 1,
        batch_size: 16,
        ..settings(Modality::T)
    };
    let out = folder.path().join("run");
    let trained = train(from_ref(&data), &out, &settings, None, &|_| {}).unwrap();
    assert_eq!(trained.warnings.len(), 1, "{:?}", trained.warnings);
    assert!(trained.warnings[0].ends_with("the batch size is 6 instead of 16"));
    let file = RunFolder::at(&out).read().unwrap().unwrap();
    assert_eq!(file.settings.batch_size, 6);
    // The same command goes on with the run.
    let again = train(from_ref(&data), &out, &settings, None, &|_| {}).unwrap();
    assert_eq!(again, trained);
}

#[test]
fn second_trainer_in_a_folder_is_refused_with_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    write_dataset(&data, 8);
    let settings = TrainSettings {
        epochs: 1,
        ..settings(Modality::T)
    };
    let out = folder.path().join("run");
    let second = std::sync::Mutex::new(None);
    train(from_ref(&data), &out, &settings, None, &|event| {
        if matches!(event, TrainEvent::Started(_)) {
            *second.lock().unwrap() = Some(train(from_ref(&data), &out, &settings, None, &|_| {}));
        }
    })
    .unwrap();
    let error = second.into_inner().unwrap().unwrap().unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Busy);
    let own = format!("process {}", std::process::id());
    assert!(error.what().contains(&own), "{error}");
    let run = RunFolder::at(&out);
    let held = run.lock().unwrap();
    let file = run.read().unwrap().unwrap();
    let error = finish(&run, &file, from_ref(&data), "model", &|_| {}).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Busy);
    drop(held);
    assert!(finish(&run, &file, from_ref(&data), "model", &|_| {}).is_ok());
}

#[test]
fn samples_without_depth_are_no_predictions_from_fewer_inputs() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    write_dataset(&data, 16);
    let settings = settings(Modality::Vtd);
    let out = folder.path().join("run");
    train(from_ref(&data), &out, &settings, None, &|_| {}).unwrap();
    let run = RunFolder::at(&out);
    let file = run.read().unwrap().unwrap();
    let onnx = finish(&run, &file, from_ref(&data), "tiny", &|_| {})
        .unwrap()
        .onnx;
    let models = [("tiny.onnx".to_owned(), Model::from_bytes(&onnx).unwrap())];

    // Only the last of a split lacks depth.
    let without = |split: &str| {
        let mut rows: Vec<_> = (0..8).map(|number| row(split, number)).collect();
        rows[7].images.grasp_depth = None;
        write_split(&data, split, rows);
    };
    without("test");
    let test = Samples::open(&data, "test").unwrap();
    let error = crate::evaluate(&models, &test, None, "", &|_, _| {}).unwrap_err();
    assert!(error.to_string().contains("test-0007"), "{error}");
    assert!(error.what().contains("depth"), "{error}");

    // Nor are predictions exported that nothing calibrates.
    without("validation");
    let error = train(
        from_ref(&data),
        &folder.path().join("other"),
        &settings,
        None,
        &|_| {},
    )
    .unwrap_err();
    assert!(error.what().contains("split `validation`"), "{error}");
    assert!(error.remedy_text().unwrap().contains("--modality"));
}

#[test]
fn cameras_of_a_model_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    write_dataset(&data, 24);
    let source = |modality: Modality| {
        let out = folder.path().join(modality.name());
        train(from_ref(&data), &out, &settings(modality), None, &|_| {}).unwrap();
        let run = RunFolder::at(&out);
        let file = run.read().unwrap().unwrap();
        finish(&run, &file, from_ref(&data), "source", &|_| {}).unwrap();
        StartModel::by_name(&out.display().to_string()).unwrap()
    };
    let [cameras, touch] = [Modality::Vd, Modality::T].map(source);
    let all = TrainSettings {
        pretrain_epochs: 0,
        ..settings(Modality::Vtd)
    };
    let [whole, broken, refused] = ["whole", "broken", "refused"].map(|n| folder.path().join(n));
    let trained = train(from_ref(&data), &whole, &all, Some(&cameras), &|_| {}).unwrap();
    // None of them learns the geometry.
    assert_eq!(trained.epochs, all.epochs);
    let run = RunFolder::at(&whole);
    let file = run.read().unwrap().unwrap();
    assert_eq!(file.settings.cameras.as_ref().unwrap().name, "source");
    let (network, _) = run.best_network(&file.settings).unwrap();
    let values = |network: &Network, start: &str| -> Vec<f32> {
        let params = network.layout().params().iter();
        let params = params.filter(|param| param.name.starts_with(start));
        params
            .flat_map(|param| network.parameters[param.range()].to_vec())
            .collect()
    };
    for encoder in ["vision.", "depth."] {
        let kept = values(&network, encoder);
        assert!(
            !kept.is_empty() && kept == values(cameras.network(), encoder),
            "{encoder}"
        );
    }
    let resumed = AssertUnwindSafe(|| {
        train(from_ref(&data), &broken, &all, Some(&cameras), &|event| {
            assert!(!matches!(event, TrainEvent::Step { steps: [8, _], .. }));
        })
    });
    assert!(catch_panic::catch_panic(resumed).is_err());
    train(from_ref(&data), &broken, &all, Some(&cameras), &|_| {}).unwrap();
    let again = RunFolder::at(&broken).best_network(&file.settings).unwrap();
    assert!(again.0.parameters == network.parameters);
    let error = train(from_ref(&data), &broken, &all, None, &|_| {}).unwrap_err();
    assert!(error.to_string().contains("cameras"), "{error}");
    let error = train(from_ref(&data), &refused, &all, Some(&touch), &|_| {}).unwrap_err();
    assert!(
        error.to_string().contains("no encoder of colour images"),
        "{error}"
    );
}
