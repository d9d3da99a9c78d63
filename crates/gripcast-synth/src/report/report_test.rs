use std::fs;
use std::path::Path;

use super::sample::Sample;
use super::{SynthReport, SynthReportSettings, report};
use crate::curate::{CurationSettings, LabelBalance};
use crate::plan::Plan;
use crate::store::{ResultStore, SimulationResult};
use crate::{MergeSettings, merge};
use gripcast_base::error::{ErrorKind, Result};
use gripcast_dataset::shard::{SplitFractions, to_bytes};

/// Slips have contact only at 40 N.
const STABLE: [bool; 10] = [
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

/// A plan of twelve simulations: ten have a label, the eleventh failed, the last is open.
fn finished(folder: &Path) -> Sample {
    let sample = Sample::new(12);
    let store = ResultStore::new(folder);
    for (k, stable) in STABLE.into_iter().enumerate() {
        let row = sample.row(k, stable, stable || k % 2 == 1);
        let bytes = to_bytes(vec![row], "{}").unwrap();
        let samples = Some((1, &*bytes));
        store.save(sample.result(k, stable), samples).unwrap();
    }
    let mut failed = SimulationResult::new(&sample.plan, &sample.plan.simulations[10]);
    failed.detail = Some("defect 7".to_owned());
    store.save(failed, None).unwrap();
    sample
}

fn reported(plan: &Plan, folder: &Path, dataset: Option<&Path>) -> Result<SynthReport> {
    report(plan, folder, &settings(dataset), &|_, _| ())
}

/// Merges the labelled results, balanced at each force.
fn merged(plan: &Plan, folder: &Path, out: &Path) {
    let settings = MergeSettings {
        curation: CurationSettings {
            splits: SplitFractions::single("train").unwrap(),
            category_cap: None,
            balance: LabelBalance::Category,
            ..CurationSettings::default()
        },
        allow_partial: true,
    };
    merge(plan, folder, out, &settings, &|_, _| ()).unwrap();
}

#[test]
fn unfinished_plan_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let found = reported(&sample.plan, folder.path(), None).unwrap();
    let progress = &found.progress;
    assert_eq!((progress.done, progress.open, progress.failed), (11, 1, 1));
    assert_eq!((progress.labels.stable, progress.labels.slip), (5, 5));
    assert_eq!(progress.rows, 10);
    assert!(progress.damaged.is_empty());
    assert_eq!(found.plan.stop_forces_n, [10.0, 40.0]);
    assert_eq!((found.plan.simulations, found.plan.categories), (12, 2));
    assert_eq!(found.costs.simulations, 10, "failures have no CPU time");
    let reasons: Vec<_> = found.unlabelled.iter().map(|g| &*g.reason).collect();
    assert_eq!(reasons, ["defect #"]);
    let boxes = &found.categories["box"];
    assert_eq!(
        (boxes.objects, boxes.grasps, boxes.labels.total()),
        (1, 5, 5)
    );
    assert_eq!(found.dataset, None);
}

#[test]
fn images_are_inspected_and_examples_shown() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let found = reported(&sample.plan, folder.path(), None).unwrap();
    let without: Vec<_> = found
        .contact
        .groups
        .iter()
        .map(|g| (g.stop_force_n, g.stable, g.pairs, g.without))
        .collect();
    let expected = [
        (10.0, true, 6, 0),
        (10.0, false, 4, 4),
        (40.0, true, 4, 0),
        (40.0, false, 6, 0),
    ];
    assert_eq!(without, expected);
    let auroc: Vec<_> = found.contact.separation.iter().map(|s| s.auroc).collect();
    assert_eq!(auroc, [Some(1.0), Some(0.5)]);
    let stable: Vec<bool> = found.examples.iter().map(|one| one.stable).collect();
    assert_eq!(stable, [true, true, true, false, false, false]);
    for example in &found.examples {
        let images = &example.images;
        let all = [&images.colour].into_iter();
        let all = all.chain(&images.grasp).chain(&images.change);
        assert!(all.clone().all(|uri| uri.starts_with("data:image/jpeg;")));
        assert!(all.map(String::len).sum::<usize>() < 20_000);
    }
}

#[test]
fn equal_files_give_identical_reports() {
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
fn dataset_is_reported_beside_all_results() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let out = folder.path().join("D");
    merged(&sample.plan, folder.path(), &out);
    let found = reported(&sample.plan, folder.path(), Some(&out)).unwrap();
    let dataset = found.dataset.unwrap();
    let split = &dataset.merge.splits["train"];
    assert_eq!((split.stable, split.slip, dataset.later_results), (4, 4, 0));
    // Three stable grasps and two slips at 10 N.
    let force = &found.balance[0].groups[0];
    let kept = force.dataset.unwrap();
    assert_eq!((force.results.stable, kept.stable, kept.slip), (3, 2, 2));
    // A later result is reported.
    let late = sample.row(11, false, true);
    let bytes = to_bytes(vec![late], "{}").unwrap();
    let store = ResultStore::new(folder.path());
    let result = sample.result(11, false);
    store.save(result, Some((1, &*bytes))).unwrap();
    let found = reported(&sample.plan, folder.path(), Some(&out)).unwrap();
    assert_eq!(found.dataset.unwrap().later_results, 1);
    let strong = &found.balance[0].groups[1];
    assert_eq!(strong.results.slip, strong.dataset.unwrap().slip + 2);
}

#[test]
fn mismatched_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let out = folder.path().join("D");
    let refused = |plan: &Plan, words: &str| {
        let error = reported(plan, folder.path(), Some(&out)).unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
        error.kind()
    };
    let missing = refused(&sample.plan, "cannot read the description of the dataset");
    assert_eq!(missing, ErrorKind::NotFound);
    merged(&sample.plan, folder.path(), &out);
    refused(&Sample::new(3).plan, "the result belongs to another plan");
    let elsewhere = folder.path().join("elsewhere");
    let error = reported(&Sample::new(3).plan, &elsewhere, Some(&out)).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("the dataset belongs to another plan")
    );
    let shard = out.join("data/train-00000-of-00001.parquet");
    let bytes = fs::read(&shard).unwrap();
    fs::write(&shard, &bytes[1..]).unwrap();
    refused(&sample.plan, "not the one that was merged");
    fs::remove_file(&shard).unwrap();
    let missing = refused(&sample.plan, "cannot read a file of the dataset");
    assert_eq!(missing, ErrorKind::NotFound);
    fs::write(out.join("synth.json"), "{}").unwrap();
    refused(&sample.plan, "not a description of a dataset");
}

#[test]
fn dataset_files_outside_of_the_folder_are_not_read() {
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
    // Links are not written through either.
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
            splits: SplitFractions::single("train").unwrap(),
            category_cap: None,
            balance: LabelBalance::Category,
            ..CurationSettings::default()
        },
        allow_partial: true,
    };
    let error = merge(&sample.plan, folder.path(), &out, &settings, &|_, _| ()).unwrap_err();
    assert!(
        error.to_string().contains("cannot create the folder"),
        "{error}"
    );
    assert!(!folder.path().join("train-00000-of-00001.parquet").exists());
}

#[test]
fn damaged_files_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let sample = finished(folder.path());
    let store = ResultStore::new(folder.path());
    let id = |k: usize| &sample.plan.simulations[k].id;
    // Truncated: the result counts as open and is listed.
    let path = store.samples(id(3)).shown();
    fs::write(&path, b"cut").unwrap();
    let found = reported(&sample.plan, folder.path(), None).unwrap();
    assert_eq!(found.progress.open, 2);
    assert_eq!(found.progress.damaged, [id(3).as_str()]);
    // Altered: the report fails.
    let path = store.samples(id(4)).shown();
    let mut bytes = fs::read(&path).unwrap();
    bytes[200] ^= 1;
    fs::write(&path, bytes).unwrap();
    let error = reported(&sample.plan, folder.path(), None).unwrap_err();
    let text = error.to_string();
    assert_eq!(error.kind(), ErrorKind::Input);
    assert!(
        text.contains("do not belong to the result") && text.contains(&**id(4)),
        "{text}"
    );
}

#[test]
fn plan_without_results_has_a_report() {
    let folder = tempfile::tempdir().unwrap();
    let sample = Sample::new(4);
    let found = reported(&sample.plan, folder.path(), None).unwrap();
    assert_eq!((found.progress.done, found.progress.open), (0, 4));
    let page = super::page(&found).unwrap();
    assert!(page.contains("No simulation has finished yet.") && !page.contains("NaN"));
}
