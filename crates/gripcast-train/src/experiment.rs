//! The paper's comparison (§5.2, Figure 6) of input modalities and of FEM with rigid-body training
//! data.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::slice;

use serde::{Deserialize, Serialize};

use super::evaluate::{ModelEvaluation, evaluate};
use super::finish::finish;
use super::lift::LiftEvaluation;
use super::metrics::plot::{Bar, BarChart, BarGroup, Reference, bars};
use super::metrics::{Interval, SeedSummary, Summary};
use super::resampled::Resampled;
use super::run::{TrainEvent, train};
use super::run_folder::RunFolder;
use super::samples::{Samples, dataset_sha256};
use super::settings::TrainSettings;
use super::start::StartModel;
use super::state::write;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Root};
use gripcast_base::workers::par_map_single_threaded;
use gripcast_nn::predict::Model;
use gripcast_nn::predict::contract::Modality;

/// Condition of the experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Condition {
    /// Vision, FEM data.
    Vision,
    /// Touch, FEM data.
    Touch,
    /// Both, FEM data.
    Both,
    /// Both and depth, FEM data.
    All,
    /// Both, rigid-body data.
    BothRigid,
}

impl Condition {
    /// All conditions, in the order of the figure.
    pub const ALL: [Self; 5] = [
        Self::Vision,
        Self::Touch,
        Self::Both,
        Self::All,
        Self::BothRigid,
    ];

    /// Returns its name in the figure.
    pub fn title(self) -> &'static str {
        match self {
            Self::Vision => "V",
            Self::Touch => "T",
            Self::Both => "V+T",
            Self::All => "V+T+D",
            Self::BothRigid => "V+T, rigid",
        }
    }

    /// Returns the name of its folder.
    pub fn folder(self) -> &'static str {
        match self {
            Self::Vision => "v",
            Self::Touch => "t",
            Self::Both => "vt",
            Self::All => "vtd",
            Self::BothRigid => "vt-rigid",
        }
    }

    fn modality(self) -> Modality {
        match self {
            Self::Vision => Modality::V,
            Self::Touch => Modality::T,
            Self::Both | Self::BothRigid => Modality::Vt,
            Self::All => Modality::Vtd,
        }
    }
}

/// A test set of the experiment.
#[derive(Clone, Debug)]
pub struct TestSet {
    /// Name in the figure.
    pub title: String,
    /// Name in files.
    pub name: &'static str,
    /// Folder of the dataset.
    pub data: PathBuf,
    /// Split of the dataset.
    pub split: String,
}

/// Settings of the experiment.
#[derive(Clone, Debug)]
pub struct ExperimentSettings {
    /// Dataset of the FEM engine.
    pub fem: PathBuf,
    /// Dataset of the same plan by the rigid engine; without it, that condition is omitted.
    pub rigid: Option<PathBuf>,
    /// Whether there is a condition with depth images, which the FEM data and the test sets need
    /// for it.
    pub with_depth: bool,
    /// Test sets.
    pub tests: Vec<TestSet>,
    /// Number of seeds per condition, from 0.
    pub seeds: u64,
    /// Training settings; the condition sets modality and seed.
    pub training: TrainSettings,
    /// Model whose encoders of camera images are used; none to train them.
    pub cameras: Option<StartModel>,
}

/// Results of the experiment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExperimentReport {
    /// `gripcast-fig6`.
    pub format: String,
    /// Version of the format.
    pub version: u32,
    /// Version of gripcast.
    pub software: String,
    /// SHA-256 of the datasets by name.
    pub datasets: BTreeMap<String, String>,
    /// Training settings.
    pub training: TrainSettings,
    /// Metrics of each condition on each test set.
    pub results: Vec<ConditionResult>,
    /// Differences between conditions.
    pub differences: Vec<ConditionDifference>,
}

/// Metrics of a condition on a test set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConditionResult {
    /// Condition.
    pub condition: Condition,
    /// Name of the test set.
    pub test: String,
    /// Number of samples.
    pub n: usize,
    /// Number of stable samples.
    pub stable: usize,
    /// Metrics per seed.
    pub seeds: Vec<Summary>,
    /// Mean and standard deviation over seeds.
    pub over_seeds: SeedSummary,
    /// Mean balanced accuracy over seeds with its 95 % interval over objects.
    pub balanced_accuracy: Option<Interval>,
    /// Mean AUROC over seeds with its 95 % interval over objects.
    pub auroc: Option<Interval>,
    /// Verdict in the lift per seed; none without motion in the data.
    pub lift: Vec<LiftEvaluation>,
}

/// Difference between two conditions, first minus second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConditionDifference {
    /// First condition.
    pub first: Condition,
    /// Second condition.
    pub second: Condition,
    /// Name of the test set.
    pub test: String,
    /// Difference in mean balanced accuracy with its 95 % interval over objects.
    pub balanced_accuracy: Option<Interval>,
    /// Difference in mean AUROC with its 95 % interval over objects.
    pub auroc: Option<Interval>,
}

/// Progress of the experiment.
#[derive(Clone, Debug, PartialEq)]
pub enum ExperimentEvent {
    /// A run of a condition and a seed is started.
    Run(Condition, u64),
    /// Progress of its training.
    Train(Condition, u64, TrainEvent),
}

/// Trains, tests and compares all conditions, `jobs` models in parallel (faster than one model on
/// all cores). Finished runs in `out` are reused.
///
/// # Errors
/// Errors of [`train`] and [`evaluate`].
pub fn experiment(
    settings: &ExperimentSettings,
    out: &Path,
    jobs: usize,
    on_progress: &(dyn Fn(ExperimentEvent) + Sync),
) -> Result<ExperimentReport> {
    // Fails before hours of training.
    for (data, split) in settings.splits() {
        Samples::open(data, split)?;
    }
    // Ordered by seed: an interrupted experiment has all conditions of some seeds.
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
            let model = train_model(settings, condition, seed, &folder, on_progress)?;
            let tests = settings.tests.iter();
            tests
                .map(|test| test_model(&model, &folder, test))
                .collect()
        },
        &|_| {},
    )?;
    let mut by_test: BTreeMap<(&str, Condition), Vec<ModelEvaluation>> = BTreeMap::new();
    for ((_, condition), evaluations) in runs.iter().zip::<Vec<Vec<ModelEvaluation>>>(evaluations) {
        for (test, evaluation) in settings.tests.iter().zip(evaluations) {
            let key = (test.name, *condition);
            by_test.entry(key).or_default().push(evaluation);
        }
    }
    let report = settings.report(&by_test)?;
    let text = serde_json::to_vec_pretty(&report)
        .map_err(|e| Error::internal("cannot write the report").because(e))?;
    let top = Root::new(out).top();
    write(&top.join("fig6.json"), &text)?;
    for (name, chart) in charts(&report, settings) {
        write(&top.join(name), bars(&chart).to_svg().as_bytes())?;
    }
    Ok(report)
}

/// Trains the model of a condition and a seed, unless it exists.
fn train_model(
    settings: &ExperimentSettings,
    condition: Condition,
    seed: u64,
    folder: &Path,
    on_progress: &(dyn Fn(ExperimentEvent) + Sync),
) -> Result<PathBuf> {
    let data = &[settings.data(condition)?.to_owned()];
    let training = TrainSettings {
        modality: condition.modality(),
        seed,
        ..settings.training.clone()
    };
    let cameras = settings.cameras.as_ref();
    train(data, folder, &training, cameras, &|event| {
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

/// Evaluates a model on a test set, unless an evaluation of the same files is cached.
fn test_model(model: &Path, folder: &Path, test: &TestSet) -> Result<ModelEvaluation> {
    let cache = Root::new(folder)
        .top()
        .join_affixed("eval-", &test.name, ".json");
    let sha256 = dataset_sha256(slice::from_ref(&test.data))?;
    let model_file = model.display().to_string();
    let loaded = Model::load(model)?;
    let all = loaded.contract().modality;
    let cached = cache.read(FileKind::List).ok();
    let cached = cached.and_then(|text| serde_json::from_slice::<CachedTest>(&text).ok());
    if let Some(cached) = cached
        && cached.dataset_sha256 == sha256
        && cached.split == test.split
        && cached.evaluation.sha256 == loaded.sha256()
    {
        return Ok(cached.evaluation);
    }
    let samples = Samples::open(&test.data, &test.split)?;
    let report = evaluate(&[(model_file, loaded)], &samples, None, &sha256, &|_, _| {})?;
    // Of the predictions of a model the one from all of its inputs.
    let mut evaluated = report.models.into_iter();
    let evaluation = evaluated
        .find(|evaluation| evaluation.modality == all)
        .ok_or_else(|| Error::internal("the model was not evaluated").at(model.display()))?;
    let test = CachedTest {
        dataset_sha256: sha256,
        split: test.split.clone(),
        evaluation,
    };
    let text = serde_json::to_vec(&test)
        .map_err(|e| Error::internal("cannot write the evaluation").because(e))?;
    write(&cache, &text)?;
    Ok(test.evaluation)
}

#[derive(Serialize, Deserialize)]
struct CachedTest {
    dataset_sha256: String,
    split: String,
    evaluation: ModelEvaluation,
}

impl ExperimentSettings {
    /// Returns the conditions with data, in the order of the figure.
    pub fn conditions(&self) -> impl Iterator<Item = Condition> + '_ {
        let has_data = |condition: &Condition| match condition {
            Condition::All => self.with_depth,
            Condition::BothRigid => self.rigid.is_some(),
            _ => true,
        };
        Condition::ALL.into_iter().filter(has_data)
    }

    /// Returns all splits that are read, with their datasets.
    fn splits(&self) -> impl Iterator<Item = (&Path, &str)> {
        let training = [Some(&self.fem), self.rigid.as_ref()].into_iter().flatten();
        let tests = self.tests.iter();
        training
            .flat_map(|data| ["train", "validation"].map(|split| (data.as_path(), split)))
            .chain(tests.map(|test| (test.data.as_path(), test.split.as_str())))
    }

    /// Returns the training dataset of a condition.
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
        by_test: &BTreeMap<(&str, Condition), Vec<ModelEvaluation>>,
    ) -> Result<ExperimentReport> {
        let mut results = Vec::new();
        let mut differences = Vec::new();
        for test in &self.tests {
            let mut of_test: BTreeMap<Condition, Resampled> = BTreeMap::new();
            for condition in self.conditions() {
                let key = (test.name, condition);
                let Some(evaluations) = by_test.get(&key) else {
                    continue;
                };
                let resampled = Resampled::new(evaluations);
                let [auroc, balanced_accuracy] = resampled.intervals();
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
                    lift: evaluations.iter().filter_map(|e| e.lift.clone()).collect(),
                });
                of_test.insert(condition, resampled);
            }
            let pairs = [
                (Condition::All, Condition::Touch),
                (Condition::Both, Condition::Touch),
                (Condition::Both, Condition::Vision),
                (Condition::Touch, Condition::Vision),
                (Condition::Both, Condition::BothRigid),
            ];
            for (first, second) in pairs {
                let (Some(one), Some(other)) = (of_test.get(&first), of_test.get(&second)) else {
                    continue;
                };
                let [auroc, balanced_accuracy] = one.minus(other);
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
        datasets.insert(
            "fem".to_owned(),
            dataset_sha256(slice::from_ref(&self.fem))?,
        );
        if let Some(rigid) = &self.rigid {
            datasets.insert("rigid".to_owned(), dataset_sha256(slice::from_ref(rigid))?);
        }
        for test in &self.tests {
            datasets.insert(
                test.name.to_owned(),
                dataset_sha256(slice::from_ref(&test.data))?,
            );
        }
        Ok(ExperimentReport {
            format: "gripcast-fig6".to_owned(),
            version: 2,
            software: concat!("gripcast ", env!("CARGO_PKG_VERSION")).to_owned(),
            datasets,
            training: self.training.clone(),
            results,
            differences,
        })
    }
}

/// Metric of a seed.
type SeedMetric = fn(&Summary) -> Option<f64>;
/// Metric over all seeds.
type MeanMetric = fn(&ConditionResult) -> Option<Interval>;

/// Returns the bar charts with their file names.
fn charts(
    report: &ExperimentReport,
    settings: &ExperimentSettings,
) -> Vec<(&'static str, BarChart)> {
    let kinds: [(&str, &str, SeedMetric, MeanMetric); 2] = [
        (
            "fig6.svg",
            "Balanced accuracy",
            |s| s.balanced_accuracy,
            |r| r.balanced_accuracy,
        ),
        ("fig6-auroc.svg", "AUROC", |s| s.auroc, |r| r.auroc),
    ];
    let by = match settings.rigid {
        Some(_) => "modality and simulator",
        None => "modality",
    };
    kinds
        .into_iter()
        .map(|(file, label, seed_metric, mean_metric)| {
            let bar = |test: &TestSet, condition: Condition| {
                let mut results = report.results.iter();
                let result = results.find(|r| r.test == test.name && r.condition == condition)?;
                let interval = mean_metric(result)?;
                Some(Bar {
                    mean: interval.estimate,
                    interval: Some([interval.low, interval.high]),
                    seeds: result.seeds.iter().filter_map(seed_metric).collect(),
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
