//! The paper's comparison (§5.2, Figure 6): what each sense adds, and what the finite elements add
//! to training data over a rigid-body simulator.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::evaluate::{ModelEvaluation, Resampled, evaluate};
use super::finish::finish;
use super::metrics::plot::{Bar, BarChart, BarGroup, Reference, bars};
use super::metrics::{Interval, SeedSummary, Summary};
use super::run::{TrainEvent, train};
use super::run_folder::RunFolder;
use super::samples::{Samples, dataset_sha256};
use super::settings::TrainSettings;
use super::state::write;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Root};
use gripcast_base::workers::par_map_single_threaded;
use gripcast_nn::predict::Model;
use gripcast_nn::predict::contract::Modality;

/// What is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Condition {
    /// The colour image alone, finite elements.
    Vision,
    /// Touch alone, finite elements.
    Touch,
    /// Both, finite elements.
    Both,
    /// Both, rigid-body simulator.
    BothRigid,
}

impl Condition {
    /// All, in the order of the figure.
    pub const ALL: [Self; 4] = [Self::Vision, Self::Touch, Self::Both, Self::BothRigid];

    /// What the figure calls it.
    pub fn title(self) -> &'static str {
        match self {
            Self::Vision => "V",
            Self::Touch => "T",
            Self::Both => "V+T",
            Self::BothRigid => "V+T, rigid",
        }
    }

    /// Its folder.
    pub fn folder(self) -> &'static str {
        match self {
            Self::Vision => "v",
            Self::Touch => "t",
            Self::Both => "vt",
            Self::BothRigid => "vt-rigid",
        }
    }

    fn variant(self) -> Modality {
        match self {
            Self::Vision => Modality::V,
            Self::Touch => Modality::T,
            Self::Both | Self::BothRigid => Modality::Vt,
        }
    }
}

/// A part of a dataset that all are tested on.
#[derive(Clone, Debug)]
pub struct TestSet {
    /// What the figure calls it.
    pub title: String,
    /// Name in files.
    pub name: &'static str,
    /// Folder of the dataset.
    pub data: PathBuf,
    /// Its part.
    pub split: String,
}

/// What the experiment is made by.
#[derive(Clone, Debug)]
pub struct ExperimentSettings {
    /// Dataset of the finite elements.
    pub fem: PathBuf,
    /// The same plan with the rigid-body simulator; without it that condition is left out.
    pub rigid: Option<PathBuf>,
    /// What is tested on.
    pub tests: Vec<TestSet>,
    /// Seeds of each condition, from 0.
    pub seeds: u64,
    /// How all are trained; variant and seed are those of the condition.
    pub training: TrainSettings,
}

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExperimentReport {
    /// `gripcast-fig6`.
    pub format: String,
    /// Of the format.
    pub version: u32,
    /// Of gripcast.
    pub software: String,
    /// SHA-256 of the datasets by their names.
    pub datasets: BTreeMap<String, String>,
    /// How all were trained.
    pub training: TrainSettings,
    /// Figures of each condition on each test.
    pub results: Vec<ConditionResult>,
    /// Differences between conditions.
    pub differences: Vec<ConditionDifference>,
}

/// One condition on one test.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConditionResult {
    /// What was trained.
    pub condition: Condition,
    /// Name of the test.
    pub test: String,
    /// Samples.
    pub n: usize,
    /// Stable ones.
    pub stable: usize,
    /// Of each seed.
    pub seeds: Vec<Summary>,
    /// Mean and deviation over seeds.
    pub over_seeds: SeedSummary,
    /// Mean over seeds, with its 95 % interval over objects.
    pub balanced_accuracy: Option<Interval>,
    /// The same of the AUROC.
    pub auroc: Option<Interval>,
}

/// How much better a condition is than another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConditionDifference {
    /// One.
    pub first: Condition,
    /// The other.
    pub second: Condition,
    /// Name of the test.
    pub test: String,
    /// Difference of the means over seeds, with its 95 % interval over objects.
    pub balanced_accuracy: Option<Interval>,
    /// The same of the AUROC.
    pub auroc: Option<Interval>,
}

/// Where the experiment is.
#[derive(Clone, Debug, PartialEq)]
pub enum ExperimentEvent {
    /// A condition and a seed are begun.
    Run(Condition, u64),
    /// Their training goes on.
    Train(Condition, u64, TrainEvent),
}

/// Trains, tests and compares all conditions, `jobs` models at a time, which is quicker than all
/// cores on one. What is done is kept in `out` and not done again.
///
/// # Errors
/// Those of [`train`] and [`evaluate`].
pub fn experiment(
    settings: &ExperimentSettings,
    out: &Path,
    jobs: usize,
    on_progress: &(dyn Fn(ExperimentEvent) + Sync),
) -> Result<ExperimentReport> {
    // Before hours of training, not after them.
    for (data, split) in settings.parts() {
        Samples::open(data, split)?;
    }
    // An experiment that is stopped has all conditions of some seeds.
    let runs: Vec<(u64, Condition)> = (0..settings.seeds)
        .flat_map(|seed| {
            settings
                .conditions()
                .map(move |condition| (seed, condition))
        })
        .collect();
    let evaluations = par_map_single_threaded(
        jobs,
        &runs,
        &|&(seed, condition)| {
            on_progress(ExperimentEvent::Run(condition, seed));
            let folder = out.join(condition.folder()).join(format!("seed-{seed}"));
            let model = trained(settings, condition, seed, &folder, on_progress)?;
            let tests = settings.tests.iter();
            tests.map(|test| tested(&model, &folder, test)).collect()
        },
        &|_| {},
    )?;
    let mut found: BTreeMap<(&str, Condition), Vec<ModelEvaluation>> = BTreeMap::new();
    for ((_, condition), evaluations) in runs.iter().zip::<Vec<Vec<ModelEvaluation>>>(evaluations) {
        for (test, evaluation) in settings.tests.iter().zip(evaluations) {
            let key = (test.name, *condition);
            found.entry(key).or_default().push(evaluation);
        }
    }
    let report = settings.report(&found)?;
    let text = serde_json::to_vec_pretty(&report)
        .map_err(|e| Error::internal("cannot write the report").because(e))?;
    let top = Root::new(out).top();
    write(&top.join("fig6.json"), &text)?;
    for (name, chart) in charts(&report, settings) {
        write(&top.join(name), bars(&chart).to_svg().as_bytes())?;
    }
    Ok(report)
}

/// The model of a condition and a seed.
fn trained(
    settings: &ExperimentSettings,
    condition: Condition,
    seed: u64,
    folder: &Path,
    on_progress: &(dyn Fn(ExperimentEvent) + Sync),
) -> Result<PathBuf> {
    let data = settings.data(condition)?;
    let training = TrainSettings {
        variant: condition.variant(),
        seed,
        ..settings.training.clone()
    };
    train(data, folder, &training, &|event| {
        on_progress(ExperimentEvent::Train(condition, seed, event));
    })?;
    let run = RunFolder::at(folder);
    if run.model().is_file() {
        return Ok(run.model().shown());
    }
    let file = run
        .read()?
        .ok_or_else(|| Error::internal("the run has no description").at(folder.display()))?;
    let name = format!("fig6-{}-{seed}", condition.folder());
    finish(&run, &file, data, &name, &|_| {})?;
    Ok(run.model().shown())
}

/// The evaluation of a model on a test, read again if it is of the same files.
fn tested(model: &Path, folder: &Path, test: &TestSet) -> Result<ModelEvaluation> {
    let place = Root::new(folder)
        .top()
        .join_affixed("eval-", &test.name, ".json");
    let sha256 = dataset_sha256(&test.data)?;
    let model_file = model.display().to_string();
    let loaded = Model::load(model)?;
    let kept = place.read(FileKind::List).ok();
    let kept = kept.and_then(|text| serde_json::from_slice::<Tested>(&text).ok());
    if let Some(kept) = kept
        && kept.dataset_sha256 == sha256
        && kept.split == test.split
        && kept.evaluation.sha256 == loaded.sha256()
    {
        return Ok(kept.evaluation);
    }
    let samples = Samples::open(&test.data, &test.split)?;
    let mut report = evaluate(&[(model_file, loaded)], &samples, None, &sha256, &|_, _| {})?;
    let evaluation = report
        .models
        .pop()
        .ok_or_else(|| Error::internal("the model was not measured").at(model.display()))?;
    let tested = Tested {
        dataset_sha256: sha256,
        split: test.split.clone(),
        evaluation,
    };
    let text = serde_json::to_vec(&tested)
        .map_err(|e| Error::internal("cannot write the figures").because(e))?;
    write(&place, &text)?;
    Ok(tested.evaluation)
}

/// What is kept of a test.
#[derive(Serialize, Deserialize)]
struct Tested {
    dataset_sha256: String,
    split: String,
    evaluation: ModelEvaluation,
}

impl ExperimentSettings {
    /// The conditions for which there are data, in the order of the figure.
    fn conditions(&self) -> impl Iterator<Item = Condition> + '_ {
        let has_data =
            |condition: &Condition| *condition != Condition::BothRigid || self.rigid.is_some();
        Condition::ALL.into_iter().filter(has_data)
    }

    /// All parts of datasets that are read, with their folders.
    fn parts(&self) -> impl Iterator<Item = (&Path, &str)> {
        let trained_on = [Some(&self.fem), self.rigid.as_ref()].into_iter().flatten();
        let tests = self.tests.iter();
        trained_on
            .flat_map(|data| ["train", "validation"].map(|split| (data.as_path(), split)))
            .chain(tests.map(|test| (test.data.as_path(), test.split.as_str())))
    }

    /// What a condition is trained on.
    fn data(&self, condition: Condition) -> Result<&Path> {
        match (condition, &self.rigid) {
            (Condition::BothRigid, None) => {
                Err(Error::internal("there is no dataset of rigid bodies"))
            }
            (Condition::BothRigid, Some(rigid)) => Ok(rigid),
            _ => Ok(&self.fem),
        }
    }

    fn report(
        &self,
        found: &BTreeMap<(&str, Condition), Vec<ModelEvaluation>>,
    ) -> Result<ExperimentReport> {
        let mut results = Vec::new();
        let mut differences = Vec::new();
        for test in &self.tests {
            let mut of_test: BTreeMap<Condition, Resampled> = BTreeMap::new();
            for condition in self.conditions() {
                let key = (test.name, condition);
                let Some(evaluations) = found.get(&key) else {
                    continue;
                };
                let over = Resampled::new(evaluations);
                let [auroc, balanced_accuracy] = over.intervals();
                let summaries: Vec<Summary> =
                    evaluations.iter().map(|e| e.summary.clone()).collect();
                results.push(ConditionResult {
                    condition,
                    test: test.name.to_owned(),
                    n: summaries.first().map_or(0, |s| s.n),
                    stable: summaries.first().map_or(0, |s| s.stable),
                    over_seeds: SeedSummary::new(&summaries),
                    seeds: summaries,
                    balanced_accuracy,
                    auroc,
                });
                of_test.insert(condition, over);
            }
            let pairs = [
                (Condition::Both, Condition::Touch),
                (Condition::Both, Condition::Vision),
                (Condition::Touch, Condition::Vision),
                (Condition::Both, Condition::BothRigid),
            ];
            for (first, second) in pairs {
                let (Some(one), Some(other)) = (of_test.get(&first), of_test.get(&second)) else {
                    continue;
                };
                let [auroc, balanced_accuracy] = one.better_than(other);
                differences.push(ConditionDifference {
                    first,
                    second,
                    test: test.name.to_owned(),
                    balanced_accuracy,
                    auroc,
                });
            }
        }
        let mut datasets = BTreeMap::new();
        datasets.insert("fem".to_owned(), dataset_sha256(&self.fem)?);
        if let Some(rigid) = &self.rigid {
            datasets.insert("rigid".to_owned(), dataset_sha256(rigid)?);
        }
        for test in &self.tests {
            datasets.insert(test.name.to_owned(), dataset_sha256(&test.data)?);
        }
        Ok(ExperimentReport {
            format: "gripcast-fig6".to_owned(),
            version: 1,
            software: concat!("gripcast ", env!("CARGO_PKG_VERSION")).to_owned(),
            datasets,
            training: self.training.clone(),
            results,
            differences,
        })
    }
}

/// A figure of a seed.
type OfSeed = fn(&Summary) -> Option<f64>;
/// What stands for it over seeds.
type OverAll = fn(&ConditionResult) -> Option<Interval>;

/// The bar charts with their file names.
fn charts(
    report: &ExperimentReport,
    settings: &ExperimentSettings,
) -> Vec<(&'static str, BarChart)> {
    let kinds: [(&str, &str, OfSeed, OverAll); 2] = [
        (
            "fig6.svg",
            "Balanced accuracy",
            |s| s.balanced_accuracy,
            |r| r.balanced_accuracy,
        ),
        ("fig6-auroc.svg", "AUROC", |s| s.auroc, |r| r.auroc),
    ];
    let by = match settings.rigid {
        Some(_) => "sense and simulator",
        None => "sense",
    };
    kinds
        .into_iter()
        .map(|(file, label, of_seed, over)| {
            let bar = |test: &TestSet, condition: Condition| {
                let mut of = report.results.iter();
                let found = of.find(|r| r.test == test.name && r.condition == condition)?;
                let interval = over(found)?;
                Some(Bar {
                    mean: interval.estimate,
                    interval: Some([interval.low, interval.high]),
                    seeds: found.seeds.iter().filter_map(of_seed).collect(),
                })
            };
            let groups = settings.tests.iter().map(|test| BarGroup {
                name: test.title.clone(),
                bars: settings.conditions().map(|c| bar(test, c)).collect(),
            });
            let chart = BarChart {
                title: format!("{label} by {by}"),
                y_label: label.to_owned(),
                y_range: [0.4, 1.0],
                series: settings
                    .conditions()
                    .map(|c| c.title().to_owned())
                    .collect(),
                groups: groups.collect(),
                interval_meaning: "95 % over objects; dots are seeds".to_owned(),
                reference: Some(Reference {
                    name: "Chance".to_owned(),
                    value: 0.5,
                }),
            };
            (file, chart)
        })
        .collect()
}

#[cfg(test)]
#[path = "experiment_test.rs"]
mod tests;
