//! A training run: a folder from which training can be resumed at any time.

use std::collections::BTreeSet;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use super::augment::{Augmentation, InputWriter};
use super::batches::{Batches, colour_normalisation};
use super::duplicates::duplicates;
use super::extents::{Found, fit_extent_heads};
use super::run_folder::{EpochMetrics, RunFile, RunFolder, VERSION, foreign_checkpoint, untrained};
use super::samples::{Samples, dataset_sha256, location};
use super::settings::TrainSettings;
use super::start::StartModel;
use super::state::{self, Position};
use super::validate::{Scores, SplitLogits, logits};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind};
use gripcast_base::random::SeedStream;
use gripcast_dataset::shard::ShardSet;
use gripcast_imaging::CropProfile;
use gripcast_nn::predict::contract::{Modality, RgbNormalisation};
use gripcast_nn::{Adam, Batch, Network, Scope, Step, linear_schedule};

/// Splits used by a run.
const TRAIN: &str = "train";
const VALIDATION: &str = "validation";
/// Steps between checkpoints.
const CHECKPOINT_STEPS: u64 = 100;

/// Size of a split.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplitCounts {
    /// Number of samples.
    pub samples: usize,
    /// Number of stable samples.
    pub stable: usize,
    /// Number of objects.
    pub objects: usize,
}

impl SplitCounts {
    fn new(samples: &Samples) -> Self {
        let [slip, stable] = samples.by_label();
        Self {
            samples: slip + stable,
            stable,
            objects: samples.objects().len(),
        }
    }
}

/// State of a run when it is started or resumed.
#[derive(Clone, Debug, PartialEq)]
pub struct RunStart {
    /// Training split.
    pub train: SplitCounts,
    /// Validation split.
    pub validation: SplitCounts,
    /// Steps per epoch.
    pub steps_per_epoch: u64,
    /// Steps done and total.
    pub steps: [u64; 2],
    /// Metrics of the finished epochs.
    pub epochs: Vec<EpochMetrics>,
    /// Batch size, at most the number of training samples.
    pub batch_size: usize,
    /// A smaller batch size than set; samples that occur in two splits.
    pub warnings: Vec<String>,
}

/// Progress of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum TrainEvent {
    /// The run is started or resumed.
    Started(RunStart),
    /// A step is done.
    Step {
        /// Steps done and total.
        steps: [u64; 2],
        /// Loss of the step.
        loss: f64,
        /// Learning rate of the step.
        learning_rate: f64,
    },
    /// Validation is running: samples done and total.
    Validate([usize; 2]),
    /// An epoch is done.
    Epoch(EpochMetrics),
}

/// Result of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Trained {
    /// Number of epochs.
    pub epochs: u32,
    /// Epoch with the best AUROC on the validation split, from 1.
    pub best_epoch: u32,
    /// Metrics of that epoch.
    pub best: EpochMetrics,
    /// Those of [`RunStart`].
    pub warnings: Vec<String>,
}

/// Trains a classifier on the samples of one or more datasets, or resumes an interrupted run. The
/// encoders of camera images are those of `cameras` and stay as they are, or are trained too.
///
/// # Errors
/// `Usage`: settings out of range or other than those of the run in the folder. `Input`: a dataset
/// without both labels, with an object in two splits, or with images of another size; a loss that
/// is NaN or infinite (the best checkpoint is kept); a model without fitting encoders of camera
/// images. `Busy`: another program trains in the folder.
/// Errors of reading and writing.
pub fn train(
    data: &[PathBuf],
    out: &Path,
    settings: &TrainSettings,
    cameras: Option<&StartModel>,
    on_progress: &(dyn Fn(TrainEvent) + Sync),
) -> Result<Trained> {
    let settings = TrainSettings {
        cameras: None,
        fine_tuning: None,
        ..settings.clone()
    };
    let cameras = cameras.filter(|_| settings.modality.cameras().is_some());
    let settings = match cameras {
        Some(source) => settings.with_cameras(source),
        None => settings,
    };
    run(data, out, &settings, cameras, on_progress)
}

/// Fine-tunes a trained model, or resumes an interrupted run: first the head alone, then all
/// parameters for `unfreeze_epochs`, both with the stored statistics of batch normalisation.
/// Modality, architecture and normalisation of the colour images are those of the model.
///
/// # Errors
/// As [`train`]; `Input` also for a dataset with another crop profile than the model's.
pub fn fine_tune(
    data: &[PathBuf],
    out: &Path,
    settings: &TrainSettings,
    start: &StartModel,
    unfreeze_epochs: u32,
    on_progress: &(dyn Fn(TrainEvent) + Sync),
) -> Result<Trained> {
    let settings = settings.clone().fine_tuning(start, unfreeze_epochs);
    run(data, out, &settings, Some(start), on_progress)
}

fn run(
    data: &[PathBuf],
    out: &Path,
    settings: &TrainSettings,
    start: Option<&StartModel>,
    on_progress: &(dyn Fn(TrainEvent) + Sync),
) -> Result<Trained> {
    settings.check()?;
    let [train, validation] = open_splits(data)?;
    // An invalid profile would fail the export after hours of training.
    CropProfile::by_name(train.crop_profile()).map_err(|e| e.at(location(data)))?;
    train.check_disjoint(&validation)?;
    if settings.fine_tuning.is_none() {
        check_inputs(settings.modality, &train)?;
    }
    for samples in [&train, &validation] {
        check_labels(samples)?;
    }
    let mut warnings = Vec::new();
    if let Some(start) = start {
        if settings.fine_tuning.is_some() {
            start.check_crop_profile(&train)?;
            let found = train.modality()?;
            if !found.includes(settings.modality) {
                warnings.push(format!(
                    "the samples have {}, the model reads {}: its predictions from inputs that they \
                     lack stay as they are",
                    found.words(),
                    settings.modality.words()
                ));
            }
        }
        warnings.extend(start.seen(&validation));
    }
    let count = train.facts().len();
    if count < settings.batch_size {
        warnings.push(format!(
            "the split `{TRAIN}` has only {count} samples: the batch size is {count} instead of {}",
            settings.batch_size
        ));
    }
    let is_known = train.facts().iter().any(|facts| facts.geometry.is_some());
    let has_contact = train.facts().iter().any(|facts| facts.contact.is_some());
    let settings = TrainSettings {
        batch_size: settings.batch_size.min(count),
        ..settings.clone()
    };
    let settings = &match settings.fine_tuning {
        Some(_) => settings,
        None => settings.for_geometry(is_known).for_contact(has_contact),
    };
    fs::create_dir_all(out)
        .map_err(|e| Error::io("cannot create the folder of the run", e).at(out.display()))?;
    let folder = RunFolder::at(out);
    let _lock = folder.lock()?;
    let file = open_or_create(&folder, data, settings, start, &train)?;
    let test = Samples::open_all(data, "test").ok();
    let splits: Vec<&Samples> = [&train, &validation].into_iter().chain(&test).collect();
    warnings.extend(duplicates(&splits)?);
    Training::new(&folder, &file, start, &train, &validation)?.run(warnings, on_progress)
}

/// Opens both splits of the datasets.
fn open_splits(data: &[PathBuf]) -> Result<[Samples; 2]> {
    let mut splits = BTreeSet::new();
    for root in data {
        splits.extend(ShardSet::open(root)?.splits().map(str::to_owned));
    }
    if let Some(absent) = [TRAIN, VALIDATION]
        .iter()
        .find(|name| !splits.contains(**name))
    {
        let splits: Vec<String> = splits.into_iter().collect();
        let what = format!(
            "no split `{absent}`: training needs the splits `{TRAIN}` and `{VALIDATION}` with \
             different objects, found {}",
            splits.join(", ")
        );
        return Err(Error::usage(what).at(location(data)).remedy(
            "split own grasps, of three objects or more, and export them again: `gripcast dataset \
             split DATASET --name s`, `gripcast dataset export DATASET --to training --split s \
             --out SHARDS`",
        ));
    }
    Ok([
        Samples::open_all(data, TRAIN)?,
        Samples::open_all(data, VALIDATION)?,
    ])
}

fn check_inputs(modality: Modality, samples: &Samples) -> Result<()> {
    let found = samples.modality()?;
    if found.includes(modality) {
        return Ok(());
    }
    let what = format!(
        "cannot train on {}: the dataset has no depth images",
        modality.words()
    );
    Err(Error::input(what).at(samples.location()).remedy(format!(
        "train with `--modality {}`, or render or record depth",
        found.name().to_ascii_lowercase()
    )))
}

fn check_labels(samples: &Samples) -> Result<()> {
    let [slip, stable] = samples.by_label();
    if slip > 0 && stable > 0 {
        return Ok(());
    }
    let what = format!(
        "expected both labels in the split `{}`, found {stable} stable and {slip} slip samples",
        samples.split()
    );
    Err(Error::input(what)
        .at(samples.location())
        .remedy("use a dataset with more grasps of both labels, or split it with another `--seed`"))
}

/// Opens the run in the folder, which must have the same settings, or creates one.
fn open_or_create(
    folder: &RunFolder,
    data: &[PathBuf],
    settings: &TrainSettings,
    start: Option<&StartModel>,
    train: &Samples,
) -> Result<RunFile> {
    let dataset_sha256 = dataset_sha256(data)?;
    if let Some(file) = folder.read()? {
        let mismatch = |what: &str| {
            Error::usage(format!("the run was started with {what}"))
                .at(folder.run().display())
                .remedy("rerun the same command, or name another folder for a new run")
        };
        if file.dataset_sha256 != dataset_sha256 {
            return Err(mismatch("another dataset"));
        }
        if file.settings != *settings {
            let differing = differing(&file.settings, settings);
            return Err(mismatch(&format!("other settings: {differing}")));
        }
        return Ok(file);
    }
    let normalisation = match start {
        Some(start) => start.normalisation(),
        None if settings.modality.has_vision() => colour_normalisation(train)?,
        None => RgbNormalisation::NONE,
    };
    if let Some(start) = start.filter(|_| settings.fine_tuning.is_some()) {
        state::write(&folder.start(), start.bytes())?;
    }
    let file = RunFile {
        version: VERSION,
        software: concat!("gripcast ", env!("CARGO_PKG_VERSION")).to_owned(),
        settings: settings.clone(),
        dataset_sha256,
        rgb_mean: normalisation.mean,
        rgb_std: normalisation.std,
        crop_profile: train.crop_profile().to_owned(),
        objects: train.objects_in_plans().into_iter().collect(),
    };
    let text = serde_json::to_vec_pretty(&file)
        .map_err(|e| Error::internal("cannot write the run").because(e))?;
    state::write(&folder.run(), &text)?;
    Ok(file)
}

/// Lists the settings that differ, with both values.
fn differing(run: &TrainSettings, given: &TrainSettings) -> String {
    let [run, given] = [run, given].map(|s| serde_json::to_value(s).unwrap_or_default());
    let fields = [&run, &given].map(|settings| settings.as_object().into_iter().flatten());
    let names: BTreeSet<&str> = fields
        .into_iter()
        .flatten()
        .map(|(name, _)| &**name)
        .collect();
    let differing = names.into_iter().filter(|name| given[name] != run[name]);
    let texts: Vec<String> = differing
        .map(|name| format!("{name} {}, not {}", run[name], given[name]))
        .collect();
    texts.join("; ")
}

/// A running training.
struct Training<'a> {
    folder: &'a RunFolder,
    settings: &'a TrainSettings,
    normalisation: RgbNormalisation,
    train: &'a Samples,
    validation: &'a Samples,
    network: Network,
    adam: Adam,
    position: Position,
    /// Predictions of training and validation split after an epoch that left the encoders of camera
    /// images as they are.
    found: Option<[SplitLogits; 2]>,
}

impl<'a> Training<'a> {
    fn new(
        folder: &'a RunFolder,
        file: &'a RunFile,
        start: Option<&StartModel>,
        train: &'a Samples,
        validation: &'a Samples,
    ) -> Result<Self> {
        let settings = &file.settings;
        let network = match start {
            Some(start) if settings.fine_tuning.is_some() => start.network().clone(),
            cameras => {
                let mut draw = SeedStream::named(settings.seed, "parameters");
                let mut network = untrained(settings, || draw.uniform());
                if let Some(source) = cameras {
                    let copied = network.copy_cameras(source.network());
                    copied.map_err(|e| source.no_cameras(e))?;
                }
                network
            }
        };
        let mut training = Self {
            folder,
            settings,
            normalisation: file.normalisation(),
            train,
            validation,
            adam: Adam::new(network.parameters.len()),
            network,
            position: Position {
                epoch: 0,
                step: 0,
                loss_sum: 0.0,
                optimizer_steps: 0,
                best_epoch: None,
                best: None,
            },
            found: None,
        };
        let path = folder.state();
        if path.is_taken() {
            training.restore(&path)?;
        }
        training.truncate_metrics()?;
        Ok(training)
    }

    fn restore(&mut self, path: &BeneathPath) -> Result<()> {
        let (position, arrays): (Position, _) = state::load(path)?;
        let network = &self.network;
        let [all, moments] = [network.parameters.len(), network.running_stats.len()];
        let [parameters, moments, first, second] =
            state::with_sizes(arrays, [all, moments, all, all])
                .ok_or_else(|| foreign_checkpoint(path))?;
        self.network.parameters = parameters;
        self.network.running_stats = moments;
        self.position = position;
        self.adam = Adam {
            first,
            second,
            steps: self.position.optimizer_steps,
        };
        Ok(())
    }

    fn save(&mut self) -> Result<()> {
        self.position.optimizer_steps = self.adam.steps;
        let arrays: [&[f32]; 4] = [
            &self.network.parameters,
            &self.network.running_stats,
            &self.adam.first,
            &self.adam.second,
        ];
        state::save(&self.folder.state(), &self.position, &arrays)
    }

    /// Removes metrics of epochs after the checkpoint.
    fn truncate_metrics(&self) -> Result<()> {
        let path = self.folder.metrics();
        let text = path.read_to_string(FileKind::List).unwrap_or_default();
        let valid = text.lines().filter(|line| {
            serde_json::from_str::<EpochMetrics>(line)
                .is_ok_and(|metrics| metrics.epoch <= self.position.epoch)
        });
        let kept: String = valid.flat_map(|line| [line, "\n"]).collect();
        if kept == text {
            return Ok(());
        }
        state::write(&path, kept.as_bytes())
    }

    /// Returns the state before the first step.
    fn start(&self, warnings: Vec<String>) -> RunStart {
        let metrics = self.folder.metrics();
        let text = metrics.read_to_string(FileKind::List).unwrap_or_default();
        let metrics = text.lines().map(serde_json::from_str);
        let steps = self.steps_per_epoch();
        let epochs = u64::from(self.settings.total_epochs());
        let done = u64::from(self.position.epoch) * steps + self.position.step;
        RunStart {
            train: SplitCounts::new(self.train),
            validation: SplitCounts::new(self.validation),
            steps_per_epoch: steps,
            steps: [done, epochs * steps],
            epochs: metrics.filter_map(serde_json::Result::ok).collect(),
            batch_size: self.settings.batch_size,
            warnings,
        }
    }

    fn append_metrics(&self, metrics: &EpochMetrics) -> Result<()> {
        let path = self.folder.metrics();
        let line = serde_json::to_string(metrics)
            .map_err(|e| Error::internal("cannot write the metrics").because(e))?;
        path.append()
            .and_then(|mut file| writeln!(file, "{line}"))
            .map_err(|e| Error::io("cannot write the metrics", e).at(path.display()))
    }

    fn steps_per_epoch(&self) -> u64 {
        (self.train.facts().len() / self.settings.batch_size) as u64
    }

    fn run(
        mut self,
        warnings: Vec<String>,
        on_progress: &(dyn Fn(TrainEvent) + Sync),
    ) -> Result<Trained> {
        on_progress(TrainEvent::Started(self.start(warnings.clone())));
        while self.position.epoch < self.settings.total_epochs() && !self.stops_early() {
            let metrics = self.epoch(on_progress)?;
            // Before the heads are trained no epoch is the best.
            let scope = self.settings.phase(self.position.epoch).scope;
            let is_trained = !matches!(scope, Scope::Geometry | Scope::Contact);
            if is_trained && self.position.best.is_none_or(|best| metrics.beats(best)) {
                let arrays: [&[f32]; 2] = [&self.network.parameters, &self.network.running_stats];
                state::save(&self.folder.best(), &metrics, &arrays)?;
                self.position.best = Some(metrics.score());
                self.position.best_epoch = Some(metrics.epoch);
            }
            self.position.epoch = metrics.epoch;
            self.position.step = 0;
            self.position.loss_sum = 0.0;
            // Metrics first: if the run is killed before the checkpoint, the line is removed.
            self.append_metrics(&metrics)?;
            self.save()?;
            on_progress(TrainEvent::Epoch(metrics));
        }
        let (_, best) = self.folder.best_network(self.settings)?;
        Ok(Trained {
            epochs: self.position.epoch,
            best_epoch: best.epoch,
            best,
            warnings,
        })
    }

    fn stops_early(&self) -> bool {
        let since = self.position.epoch - self.position.best_epoch.unwrap_or(self.position.epoch);
        self.settings.patience > 0 && since >= self.settings.patience
    }

    fn epoch(&mut self, on_progress: &(dyn Fn(TrainEvent) + Sync)) -> Result<EpochMetrics> {
        let settings = self.settings;
        let (batch_size, buffer) = (settings.batch_size, settings.shuffle_buffer);
        let epoch = self.position.epoch;
        let phase = settings.phase(epoch);
        if epoch == phase.first && self.position.step == 0 {
            self.adam = Adam::new(self.network.parameters.len());
        }
        let train = self.train;
        let epoch_seed = SeedStream::named(settings.seed, &format!("epoch {epoch}")).bits();
        let order = train.shuffled(epoch_seed, buffer);
        let (modality, augmentation) = match (phase.scope, settings.geometry_inputs()) {
            (Scope::Geometry, Some(cameras)) => (
                cameras,
                Augmentation {
                    rotate_180: false,
                    ..settings.augmentation
                },
            ),
            (Scope::Contact | Scope::Touch, _) => (Modality::T, settings.augmentation()),
            _ => (settings.modality, settings.augmentation()),
        };
        let writer = InputWriter::new(augmentation, self.normalisation);
        let mut batches = Batches::new(train, modality, writer, buffer).balanced();
        let mut read = |step: u64| -> Result<Batch> {
            let first = step as usize * batch_size;
            let samples = &order[first..first + batch_size];
            let seed = |i: &usize| SeedStream::named(epoch_seed, &train.facts()[*i].id).bits();
            let seeds: Vec<u64> = samples.iter().map(seed).collect();
            batches.batch(samples, Some(&seeds))
        };
        // Without touch only the heads that read the extents are left.
        let steps = match phase.scope == Scope::Touch && !settings.modality.has_touch() {
            true => 0,
            false => self.steps_per_epoch(),
        };
        let total = self.steps_per_epoch() * u64::from(settings.total_epochs());
        let of_phase = steps * u64::from(phase.epochs);
        let start = Instant::now();
        let first = self.position.step;
        let mut gradient = vec![0.0; self.network.parameters.len()];
        let mut next = (first < steps).then(|| read(first)).transpose()?;
        while let Some(batch) = next.take() {
            let step = self.position.step;
            let inputs = self.step_inputs(epoch_seed, phase.scope);
            gradient.fill(0.0);
            let network = &mut self.network;
            let (loss, read) = rayon::join(
                || network.train_step(&batch, &inputs, &mut gradient),
                || (step + 1 < steps).then(|| read(step + 1)).transpose(),
            );
            next = read?;
            self.check_loss(loss, &gradient, epoch, step)?;
            let fraction = linear_schedule(self.adam.steps, settings.warm_up_steps, of_phase);
            let learning_rate = fraction * phase.learning_rate as f32;
            let layout = self.network.layout().clone();
            self.adam.step(
                phase.scope.params(&layout),
                &mut self.network.parameters,
                &gradient,
                learning_rate,
                settings.weight_decay as f32,
            );
            self.position.loss_sum += loss;
            self.position.step += 1;
            on_progress(TrainEvent::Step {
                steps: [u64::from(epoch) * steps + step + 1, total],
                loss,
                learning_rate: f64::from(learning_rate),
            });
            if self.position.step.is_multiple_of(CHECKPOINT_STEPS) {
                self.save()?;
            }
        }
        let seconds = start.elapsed().as_secs_f64();
        let done = (steps - first) * batch_size as u64;
        let (scores, geometry_error_m) = self.validate(on_progress)?;
        Ok(EpochMetrics {
            epoch: epoch + 1,
            train_loss: self.position.loss_sum / steps.max(1) as f64,
            validation_loss: scores.loss,
            validation_accuracy: scores.accuracy,
            validation_auroc: scores.auroc,
            validation_geometry_error_m: geometry_error_m,
            samples_per_s: done as f64 / seconds.max(1e-9),
        })
    }

    /// Returns the inputs of the next step; draws its dropout mask.
    fn step_inputs(&self, epoch_seed: u64, scope: Scope) -> Step {
        let (p, step) = (self.settings.dropout, self.position.step);
        let mut draw = SeedStream::named(epoch_seed, &format!("dropout {step}"));
        let scale = (1.0 / (1.0 - p)) as f32;
        let count = self.settings.batch_size * self.settings.architecture.hidden;
        let count = if p > 0.0 { count } else { 0 };
        let hidden = (0..count).map(|_| if draw.uniform() < p { 0.0 } else { scale });
        Step {
            number: self.adam.steps,
            dropout: hidden.collect(),
            scope,
        }
    }

    fn check_loss(&self, loss: f64, gradient: &[f32], epoch: u32, step: u64) -> Result<()> {
        // A ReLU can hide NaN from the loss, but not from the gradient.
        if loss.is_finite() && gradient.iter().all(|slope| slope.is_finite()) {
            return Ok(());
        }
        let kept = match self.position.best_epoch {
            Some(best) => format!("the best checkpoint, of epoch {best}, is kept"),
            None => "no epoch was finished".to_owned(),
        };
        Err(Error::input(format!(
            "loss {loss} or its gradient is NaN or infinite in epoch {}, step {step}; {kept}",
            epoch + 1
        ))
        .remedy("start a new run with a lower `--learning-rate`"))
    }

    /// Predicts the validation split. Where the heads that read the extents are fitted, not trained,
    /// it fits them first; the encoders of camera images stay as they are then, so their images are
    /// read once.
    fn predictions(&mut self, on_progress: &(dyn Fn(TrainEvent) + Sync)) -> Result<SplitLogits> {
        let (settings, normalisation) = (self.settings, self.normalisation);
        let (train, validation) = (self.train, self.validation);
        let total = validation.facts().len();
        let validating = |done| on_progress(TrainEvent::Validate([done, total]));
        let network = &mut self.network;
        let is_fitted = settings.phase(self.position.epoch).scope == Scope::Touch;
        if !is_fitted || network.extent_heads().is_empty() {
            return logits(network, validation, settings, normalisation, &validating);
        }
        let [of_train, mut found] = match self.found.take() {
            Some([mut of_train, mut found]) => {
                of_train.update_touch(network, train, &|_| {})?;
                found.update_touch(network, validation, &validating)?;
                [of_train, found]
            }
            None => [
                logits(network, train, settings, normalisation, &|_| {})?,
                logits(network, validation, settings, normalisation, &validating)?,
            ],
        };
        let of = |samples, logits| Found { samples, logits };
        let heads = fit_extent_heads(network, of(train, &of_train), of(validation, &found));
        for (inputs, head) in &heads {
            found.set_extent_head(*inputs, head);
        }
        self.found = Some([of_train, found.clone()]);
        Ok(found)
    }

    /// Evaluates the network on the validation split.
    fn validate(
        &mut self,
        on_progress: &(dyn Fn(TrainEvent) + Sync),
    ) -> Result<(Scores, Option<f64>)> {
        let logits = self.predictions(on_progress)?;
        let modality = self.settings.modality;
        let is_new = self.settings.fine_tuning.is_none();
        if is_new && logits.complete() != Some(modality) {
            let what = format!(
                "not all samples of the split `{VALIDATION}` have {}, so the predictions from them \
                 cannot be calibrated",
                modality.words()
            );
            return Err(Error::input(what)
                .at(self.validation.location())
                .remedy("train with the `--modality` that all of its samples have"));
        }
        Ok((Scores::new(logits.best()), logits.geometry_error_m))
    }
}

#[cfg(test)]
#[path = "run_test.rs"]
pub(crate) mod tests;
