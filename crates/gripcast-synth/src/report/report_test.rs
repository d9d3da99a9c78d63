use std::fs;
use std::path::Path;

use super::sample::Sample;
use super::{SynthReport, SynthReportSettings, report};
use crate::curate::CurationSettings;
use crate::plan::Plan;
use crate::store::{ResultStore, SimulationResult};
use crate::{MergeSettings, merge};
use gripcast_base::error::{ErrorKind, Result};
use gripcast_dataset::shard::{SplitFractions, to_bytes};

/// Lost ones are touched only at 40 N.
const HELD: [bool; 10] = [
    true, true, false, false, true, false, false, true, true, false,
];

fn settings(dataset: Option<&Path>) -> SynthReportSettings {
    SynthReportSettings {
        dataset: dataset.map(Path::to_owned),
        examples: 3,
        seed: 0,
        jobs: 2,
    }
}

/// Results of the first simulations of a plan of twelve; the eleventh failed, the last is open.
fn finished(folder: &Path) -> Sample {
    let sample = Sample::new(12);
    let store = ResultStore::beside(folder);
    for (k, held) in HELD.into_iter().enumerate() {
        let row = sample.row(k, held, held || k % 2 == 1);
        let bytes = to_bytes(vec![row], "{}").unwrap();
        let samples = Some((1, &*bytes));
        store.keep(sample.result(k, held), samples).unwrap();
    }
    let mut failed = SimulationResult::of(&sample.plan, &sample.plan.simulations[10]);
    failed.detail = Some("defect 7".to_owned());
    store.keep(failed, None).unwrap();
    sample
}

fn reported(plan: &Plan, folder: &Path, dataset: Option<&Path>) -> Result<SynthReport> {
    report(plan, folder, &settings(dataset), &|_, _| ())
}

/// A dataset with all labelled results but what balance takes.
fn merged(plan: &Plan, folder: &Path, out: &Path) {
    let settings = MergeSettings {
        curation: CurationSettings {
            parts: SplitFractions::single("train").unwrap(),
            category_cap: None,
            ..CurationSettings::default()
        },
        is_partial_allowed: true,
    };
    merge(plan, folder, out, &settings, &|_, _| ()).unwrap();
}

#[test]
fn a_plan_is_reported_as_far_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let found = reported(&sample.plan, folder.path(), None).unwrap();
    let progress = &found.progress;
    assert_eq!((progress.done, progress.open, progress.failed), (11, 1, 1));
    assert_eq!((progress.labels.held, progress.labels.lost), (5, 5));
    assert_eq!(progress.rows, 10);
    assert!(progress.damaged.is_empty());
    assert_eq!(found.plan.stop_forces_n, [10.0, 40.0]);
    assert_eq!((found.plan.simulations, found.plan.categories), (12, 2));
    assert_eq!(found.costs.simulations, 10, "a failure has no times");
    let reasons: Vec<_> = found.unlabelled.iter().map(|g| &*g.reason).collect();
    assert_eq!(reasons, ["defect #"]);
    let boxes = &found.categories["box"];
    assert_eq!((boxes.objects, boxes.grasps, boxes.labels.all()), (1, 5, 5));
    assert_eq!(found.dataset, None);
}

#[test]
fn images_are_looked_at_and_some_are_shown() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let found = reported(&sample.plan, folder.path(), None).unwrap();
    let without: Vec<_> = found
        .contact
        .groups
        .iter()
        .map(|g| (g.stop_force_n, g.held, g.pairs, g.without))
        .collect();
    let expected = [
        (10.0, true, 6, 0),
        (10.0, false, 4, 4),
        (40.0, true, 4, 0),
        (40.0, false, 6, 0),
    ];
    assert_eq!(without, expected);
    let told: Vec<_> = found.contact.separation.iter().map(|s| s.auroc).collect();
    assert_eq!(told, [Some(1.0), Some(0.5)]);
    let held: Vec<bool> = found.examples.iter().map(|one| one.held).collect();
    assert_eq!(held, [true, true, true, false, false, false]);
    for example in &found.examples {
        let images = &example.images;
        let all = [&images.colour].into_iter();
        let all = all.chain(&images.grasp).chain(&images.change);
        assert!(all.clone().all(|uri| uri.starts_with("data:image/jpeg;")));
        assert!(all.map(String::len).sum::<usize>() < 20_000);
    }
}

#[test]
fn the_same_files_give_the_same_report() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let text = |jobs: usize, seed: u64| {
        let settings = SynthReportSettings {
            jobs,
            seed,
            ..settings(None)
        };
        let found = report(&sample.plan, folder.path(), &settings, &|_, _| ()).unwrap();
        let text = serde_json::to_string(&found).unwrap();
        let read: SynthReport = serde_json::from_str(&text).unwrap();
        assert_eq!(read, found);
        text
    };
    assert_eq!(text(1, 0), text(2, 0));
    assert_ne!(text(1, 0), text(1, 1));
}

#[test]
fn a_dataset_is_reported_beside_all_results() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let out = folder.path().join("D");
    merged(&sample.plan, folder.path(), &out);
    let found = reported(&sample.plan, folder.path(), Some(&out)).unwrap();
    let dataset = found.dataset.unwrap();
    let part = &dataset.merge.parts["train"];
    assert_eq!((part.stable, part.slip, dataset.later_results), (4, 4, 0));
    // Three held and two were lost at 10 N.
    let force = &found.balance[0].groups[0];
    let kept = force.dataset.unwrap();
    assert_eq!((force.results.held, kept.held, kept.lost), (3, 2, 2));
    // A result that came later is said.
    let late = sample.row(11, false, true);
    let bytes = to_bytes(vec![late], "{}").unwrap();
    let store = ResultStore::beside(folder.path());
    let result = sample.result(11, false);
    store.keep(result, Some((1, &*bytes))).unwrap();
    let found = reported(&sample.plan, folder.path(), Some(&out)).unwrap();
    assert_eq!(found.dataset.unwrap().later_results, 1);
    let strong = &found.balance[0].groups[1];
    assert_eq!(strong.results.lost, strong.dataset.unwrap().lost + 2);
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let out = folder.path().join("D");
    let refused = |plan: &Plan, words: &str| {
        let error = reported(plan, folder.path(), Some(&out)).unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
        error.kind()
    };
    let missing = refused(&sample.plan, "cannot read the facts of the dataset");
    assert_eq!(missing, ErrorKind::NotFound);
    merged(&sample.plan, folder.path(), &out);
    refused(&Sample::new(3).plan, "the result is of another plan");
    let elsewhere = folder.path().join("elsewhere");
    let error = reported(&Sample::new(3).plan, &elsewhere, Some(&out)).unwrap_err();
    assert!(error.to_string().contains("the dataset is of another plan"));
    let shard = out.join("data/train-00000-of-00001.parquet");
    let bytes = fs::read(&shard).unwrap();
    fs::write(&shard, &bytes[1..]).unwrap();
    refused(&sample.plan, "not the one that was merged");
    fs::remove_file(&shard).unwrap();
    let missing = refused(&sample.plan, "cannot read a file of the dataset");
    assert_eq!(missing, ErrorKind::NotFound);
    fs::write(out.join("synth.json"), "{}").unwrap();
    refused(&sample.plan, "no facts of a dataset");
}

#[test]
fn files_of_a_dataset_outside_of_its_folder_are_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let out = folder.path().join("D");
    merged(&sample.plan, folder.path(), &out);
    let shard = "data/train-00000-of-00001.parquet";
    let secret = folder.path().join("secret.parquet");
    fs::copy(out.join(shard), &secret).unwrap();
    let facts = fs::read_to_string(out.join("synth.json")).unwrap();
    for name in [
        "../secret.parquet",
        secret.to_str().unwrap(),
        "link.parquet",
    ] {
        let _ = std::os::unix::fs::symlink(&secret, out.join("link.parquet"));
        fs::write(out.join("synth.json"), facts.replace(shard, name)).unwrap();
        let error = reported(&sample.plan, folder.path(), Some(&out)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        assert!(error.to_string().contains("leads out of"), "{error}");
    }
    // Nor are links written through.
    fs::write(out.join("synth.json"), facts).unwrap();
    for name in ["README.md", shard] {
        fs::remove_file(out.join(name)).unwrap();
        std::os::unix::fs::symlink(&secret, out.join(name)).unwrap();
    }
    let kept = fs::read(&secret).unwrap();
    merged(&sample.plan, folder.path(), &out);
    assert_eq!(fs::read(&secret).unwrap(), kept);
    fs::remove_dir_all(out.join("data")).unwrap();
    std::os::unix::fs::symlink(folder.path(), out.join("data")).unwrap();
    let settings = MergeSettings {
        curation: CurationSettings {
            parts: SplitFractions::single("train").unwrap(),
            category_cap: None,
            ..CurationSettings::default()
        },
        is_partial_allowed: true,
    };
    let error = merge(&sample.plan, folder.path(), &out, &settings, &|_, _| ()).unwrap_err();
    assert!(
        error.to_string().contains("cannot make the folder"),
        "{error}"
    );
    assert!(!folder.path().join("train-00000-of-00001.parquet").exists());
}

#[test]
fn damage_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let store = ResultStore::beside(folder.path());
    let id = |k: usize| &sample.plan.simulations[k].id;
    // Cut off: the result counts as open and is named.
    let path = store.samples(id(3)).shown();
    fs::write(&path, b"cut").unwrap();
    let found = reported(&sample.plan, folder.path(), None).unwrap();
    assert_eq!(found.progress.open, 2);
    assert_eq!(found.progress.damaged, [id(3).as_str()]);
    // Altered: nothing can be said of the images.
    let path = store.samples(id(4)).shown();
    let mut bytes = fs::read(&path).unwrap();
    bytes[200] ^= 1;
    fs::write(&path, bytes).unwrap();
    let error = reported(&sample.plan, folder.path(), None).unwrap_err();
    let text = error.to_string();
    assert_eq!(error.kind(), ErrorKind::Input);
    assert!(
        text.contains("not those of the result") && text.contains(&**id(4)),
        "{text}"
    );
}

#[test]
fn a_plan_without_results_is_a_report() {
    let folder = tempfile::tempdir().unwrap();
    let sample = Sample::new(4);
    let found = reported(&sample.plan, folder.path(), None).unwrap();
    assert_eq!((found.progress.done, found.progress.open), (0, 4));
    let page = super::page(&found).unwrap();
    assert!(page.contains("Nothing was simulated yet.") && !page.contains("NaN"));
}
