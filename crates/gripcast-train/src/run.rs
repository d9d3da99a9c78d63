//! A training run: a folder that can be left and gone on with at any time.

use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::time::Instant;

use super::augment::InputWriter;
use super::batches::{Batches, colour_normalisation};
use super::look::{Scores, logits};
use super::run_folder::{EpochFigures, RunFile, RunFolder, foreign_checkpoint, untrained};
use super::samples::{Samples, dataset_sha256};
use super::settings::TrainSettings;
use super::state::{self, Position};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind};
use gripcast_base::random::SeedStream;
use gripcast_imaging::CropProfile;
use gripcast_nn::predict::contract::RgbNormalisation;
use gripcast_nn::{Adam, Batch, Network, Step, linear_schedule};

/// Parts of a dataset that a run reads.
const TRAIN: &str = "train";
const VALIDATION: &str = "validation";
/// Steps between checkpoints.
const CHECKPOINT_STEPS: u64 = 100;

/// How much there is of a part of a dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PartCounts {
    /// Samples.
    pub samples: usize,
    /// Those whose lift held.
    pub stable: usize,
    /// Objects.
    pub objects: usize,
}

impl PartCounts {
    fn of(samples: &Samples) -> Self {
        let [lost, stable] = samples.by_label();
        Self {
            samples: lost + stable,
            stable,
            objects: samples.objects().len(),
        }
    }
}

/// What a run begins with, or goes on from.
#[derive(Clone, Debug, PartialEq)]
pub struct RunStart {
    /// What is trained on.
    pub train: PartCounts,
    /// What epochs are compared on.
    pub validation: PartCounts,
    /// Steps of an epoch.
    pub steps_per_epoch: u64,
    /// Steps done earlier and all.
    pub at: [u64; 2],
    /// Epochs that were done earlier.
    pub epochs: Vec<EpochFigures>,
}

/// What a run tells while it goes on.
#[derive(Clone, Debug, PartialEq)]
pub enum TrainEvent {
    /// The run begins or goes on.
    Begun(RunStart),
    /// A step is done.
    Step {
        /// Steps done and all.
        at: [u64; 2],
        /// Loss of the step.
        loss: f64,
        /// Learning rate of the step.
        learning_rate: f64,
    },
    /// The validation part is being looked at: samples done and all.
    Look([usize; 2]),
    /// An epoch is done.
    Epoch(EpochFigures),
}

/// Where a run ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Trained {
    /// Epochs that were done.
    pub epochs: u32,
    /// Epoch of the best validation accuracy, from 1.
    pub best_epoch: u32,
    /// What was measured there.
    pub best: EpochFigures,
}

/// Trains a classifier, or goes on with it where it was stopped.
///
/// # Errors
/// `Usage`: settings that cannot be, or that are not those of the run in the folder. `Input`: a
/// dataset without both labels, with objects in two parts, or with images of another size; a loss
/// that is no number (the best checkpoint stays). Those of reading and writing.
pub fn train(
    data: &Path,
    out: &Path,
    settings: &TrainSettings,
    on_progress: &(dyn Fn(TrainEvent) + Sync),
) -> Result<Trained> {
    settings.check()?;
    let train = Samples::open(data, TRAIN)?;
    let validation = Samples::open(data, VALIDATION)?;
    // Else the model could not be written after hours of training.
    CropProfile::by_name(train.crop_profile()).map_err(|e| e.at(data.display()))?;
    train.check_apart(&validation)?;
    for samples in [&train, &validation] {
        check_labels(samples)?;
    }
    if train.facts().len() < settings.batch {
        let what = format!(
            "the dataset has {} samples to train on, a batch {}",
            train.facts().len(),
            settings.batch
        );
        return Err(Error::usage(what).remedy("choose a smaller `--batch`"));
    }
    let folder = RunFolder::at(out);
    let file = begun(&folder, out, data, settings, &train)?;
    Training::new(&folder, &file, &train, &validation)?.go_on(on_progress)
}

fn check_labels(samples: &Samples) -> Result<()> {
    let [lost, stable] = samples.by_label();
    if lost > 0 && stable > 0 {
        return Ok(());
    }
    let what = format!(
        "the part `{}` has {stable} stable and {lost} lost samples; both labels are needed",
        samples.split()
    );
    Err(Error::input(what)
        .at(samples.root().display())
        .remedy("make a larger dataset, or split it in another way"))
}

/// The run's file: the one that is there, if it is of the same settings, or a new one.
fn begun(
    folder: &RunFolder,
    out: &Path,
    data: &Path,
    settings: &TrainSettings,
    train: &Samples,
) -> Result<RunFile> {
    let dataset_sha256 = dataset_sha256(data)?;
    if let Some(found) = folder.read()? {
        let other = |what: &str| {
            Error::usage(format!("the run was begun with {what}"))
                .at(folder.run().display())
                .remedy("go on with the same command, or name another folder for a new run")
        };
        if found.dataset_sha256 != dataset_sha256 {
            return Err(other("another dataset"));
        }
        if found.settings != *settings {
            return Err(other(&format!(
                "other settings: {}",
                differing(&found.settings, settings)
            )));
        }
        return Ok(found);
    }
    fs::create_dir_all(out)
        .map_err(|e| Error::io("cannot make the folder of the run", e).at(out.display()))?;
    let normalisation = if settings.variant.has_vision() {
        colour_normalisation(train)?
    } else {
        RgbNormalisation {
            mean: [0.0; 3],
            std: [1.0; 3],
        }
    };
    let file = RunFile {
        version: 1,
        software: concat!("gripcast ", env!("CARGO_PKG_VERSION")).to_owned(),
        settings: settings.clone(),
        dataset_sha256,
        rgb_mean: normalisation.mean,
        rgb_std: normalisation.std,
        crop_profile: train.crop_profile().to_owned(),
        objects: train.objects().into_iter().map(str::to_owned).collect(),
    };
    let text = serde_json::to_vec_pretty(&file)
        .map_err(|e| Error::internal("cannot write the run").because(e))?;
    state::write(&folder.run(), &text)?;
    Ok(file)
}

/// The settings that differ, with both values.
fn differing(found: &TrainSettings, wanted: &TrainSettings) -> String {
    let [found, wanted] = [found, wanted].map(|s| serde_json::to_value(s).unwrap_or_default());
    let Some(fields) = found.as_object() else {
        return String::new();
    };
    let differing = fields
        .iter()
        .filter(|(name, value)| wanted[name.as_str()] != **value);
    let texts: Vec<String> = differing
        .map(|(name, value)| format!("{name} {value}, not {}", wanted[name.as_str()]))
        .collect();
    texts.join("; ")
}

/// A run under way.
struct Training<'a> {
    folder: &'a RunFolder,
    settings: &'a TrainSettings,
    normalisation: RgbNormalisation,
    train: &'a Samples,
    validation: &'a Samples,
    network: Network,
    adam: Adam,
    position: Position,
}

impl<'a> Training<'a> {
    fn new(
        folder: &'a RunFolder,
        file: &'a RunFile,
        train: &'a Samples,
        validation: &'a Samples,
    ) -> Result<Self> {
        let settings = &file.settings;
        let mut draw = SeedStream::named(settings.seed, "parameters");
        let network = untrained(settings, || draw.uniform());
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
                loss: 0.0,
                steps: 0,
                best_epoch: None,
                best: None,
            },
        };
        let place = folder.state();
        if place.is_taken() {
            training.restore(&place)?;
        }
        training.cut_metrics()?;
        Ok(training)
    }

    fn restore(&mut self, place: &BeneathPath) -> Result<()> {
        let (position, arrays): (Position, _) = state::load(place)?;
        let network = &self.network;
        let [all, moments] = [network.parameters.len(), network.running_stats.len()];
        let [parameters, moments, first, second] =
            state::of_sizes(arrays, [all, moments, all, all])
                .ok_or_else(|| foreign_checkpoint(place))?;
        self.network.parameters = parameters;
        self.network.running_stats = moments;
        self.position = position;
        self.adam = Adam {
            first,
            second,
            steps: self.position.steps,
        };
        Ok(())
    }

    fn save(&mut self) -> Result<()> {
        self.position.steps = self.adam.steps;
        let arrays: [&[f32]; 4] = [
            &self.network.parameters,
            &self.network.running_stats,
            &self.adam.first,
            &self.adam.second,
        ];
        state::save(&self.folder.state(), &self.position, &arrays)
    }

    /// Takes away what was written of epochs after the checkpoint.
    fn cut_metrics(&self) -> Result<()> {
        let place = self.folder.metrics();
        let text = place.read_to_string(FileKind::List).unwrap_or_default();
        let whole = text.lines().filter(|line| {
            serde_json::from_str::<EpochFigures>(line)
                .is_ok_and(|figures| figures.epoch <= self.position.epoch)
        });
        let kept: String = whole.flat_map(|line| [line, "\n"]).collect();
        if kept == text {
            return Ok(());
        }
        state::write(&place, kept.as_bytes())
    }

    /// What there is before the first step.
    fn start(&self) -> RunStart {
        let metrics = self.folder.metrics();
        let text = metrics.read_to_string(FileKind::List).unwrap_or_default();
        let figures = text.lines().map(serde_json::from_str);
        let steps = self.steps_per_epoch();
        let epochs = u64::from(self.settings.epochs);
        let done = u64::from(self.position.epoch) * steps + self.position.step;
        RunStart {
            train: PartCounts::of(self.train),
            validation: PartCounts::of(self.validation),
            steps_per_epoch: steps,
            at: [done, epochs * steps],
            epochs: figures.filter_map(serde_json::Result::ok).collect(),
        }
    }

    fn note(&self, figures: &EpochFigures) -> Result<()> {
        let place = self.folder.metrics();
        let line = serde_json::to_string(figures)
            .map_err(|e| Error::internal("cannot write the figures").because(e))?;
        place
            .append()
            .and_then(|mut file| writeln!(file, "{line}"))
            .map_err(|e| Error::io("cannot write the figures", e).at(place.display()))
    }

    fn steps_per_epoch(&self) -> u64 {
        (self.train.facts().len() / self.settings.batch) as u64
    }

    fn go_on(mut self, on_progress: &(dyn Fn(TrainEvent) + Sync)) -> Result<Trained> {
        on_progress(TrainEvent::Begun(self.start()));
        while self.position.epoch < self.settings.epochs && !self.is_out_of_patience() {
            let figures = self.epoch(on_progress)?;
            let accuracy = [figures.validation_accuracy, figures.validation_loss];
            if self.position.best.is_none_or(|best| figures.beats(best)) {
                let arrays: [&[f32]; 2] = [&self.network.parameters, &self.network.running_stats];
                state::save(&self.folder.best(), &figures, &arrays)?;
                self.position.best = Some(accuracy);
                self.position.best_epoch = Some(figures.epoch);
            }
            self.position.epoch = figures.epoch;
            self.position.step = 0;
            self.position.loss = 0.0;
            // The line first: after a kill between the two it is cut again.
            self.note(&figures)?;
            self.save()?;
            on_progress(TrainEvent::Epoch(figures));
        }
        let (_, best) = self.folder.best_network(self.settings)?;
        Ok(Trained {
            epochs: self.position.epoch,
            best_epoch: best.epoch,
            best,
        })
    }

    fn is_out_of_patience(&self) -> bool {
        let since = self.position.epoch - self.position.best_epoch.unwrap_or(self.position.epoch);
        self.settings.patience > 0 && since >= self.settings.patience
    }

    fn epoch(&mut self, on_progress: &(dyn Fn(TrainEvent) + Sync)) -> Result<EpochFigures> {
        let settings = self.settings;
        let epoch = self.position.epoch;
        let (train, variant) = (self.train, settings.variant);
        let of_epoch = SeedStream::named(settings.seed, &format!("epoch {epoch}")).bits();
        let order = train.shuffled(of_epoch, settings.memory);
        let writer = InputWriter::new(settings.augmentation, self.normalisation);
        let mut batches = Batches::new(train, variant, writer, settings.memory).balanced();
        let mut read = |step: u64| -> Result<Batch> {
            let first = step as usize * settings.batch;
            let samples = &order[first..first + settings.batch];
            let seed = |at: &usize| SeedStream::named(of_epoch, &train.facts()[*at].id).bits();
            let seeds: Vec<u64> = samples.iter().map(seed).collect();
            batches.batch(samples, Some(&seeds))
        };
        let steps = self.steps_per_epoch();
        let all = steps * u64::from(settings.epochs);
        let begun = Instant::now();
        let first = self.position.step;
        let mut gradient = vec![0.0; self.network.parameters.len()];
        let mut next = if first < steps {
            Some(read(first)?)
        } else {
            None
        };
        while let Some(batch) = next.take() {
            let step = self.position.step;
            let drop = self.dropped(of_epoch, step);
            gradient.fill(0.0);
            let network = &mut self.network;
            let (loss, read) = rayon::join(
                || network.train_step(&batch, &drop, &mut gradient),
                || (step + 1 < steps).then(|| read(step + 1)).transpose(),
            );
            next = read?;
            self.check_loss(loss, &gradient, epoch, step)?;
            let fraction = linear_schedule(self.adam.steps, settings.warm_up, all);
            let learning_rate = fraction * settings.learning_rate as f32;
            let layout = self.network.layout().clone();
            self.adam.step(
                &layout,
                &mut self.network.parameters,
                &gradient,
                learning_rate,
                settings.weight_decay as f32,
            );
            self.position.loss += loss;
            self.position.step += 1;
            on_progress(TrainEvent::Step {
                at: [u64::from(epoch) * steps + step + 1, all],
                loss,
                learning_rate: f64::from(learning_rate),
            });
            if self.position.step.is_multiple_of(CHECKPOINT_STEPS) {
                self.save()?;
            }
        }
        let seconds = begun.elapsed().as_secs_f64();
        let done = (steps - first) * settings.batch as u64;
        let scores = self.look(on_progress)?;
        Ok(EpochFigures {
            epoch: epoch + 1,
            train_loss: self.position.loss / steps.max(1) as f64,
            validation_loss: scores.loss,
            validation_accuracy: scores.accuracy,
            validation_auroc: scores.auroc,
            samples_per_s: done as f64 / seconds.max(1e-9),
        })
    }

    /// Which hidden floats are left out in a step.
    fn dropped(&self, of_epoch: u64, step: u64) -> Step {
        let fraction = self.settings.dropout;
        let mut draw = SeedStream::named(of_epoch, &format!("dropout {step}"));
        let kept = (1.0 / (1.0 - fraction)) as f32;
        let count = self.settings.batch * self.settings.architecture.hidden;
        let count = if fraction > 0.0 { count } else { 0 };
        let hidden = (0..count).map(|_| if draw.uniform() < fraction { 0.0 } else { kept });
        Step {
            number: self.adam.steps,
            dropout: hidden.collect(),
        }
    }

    fn check_loss(&self, loss: f64, gradient: &[f32], epoch: u32, step: u64) -> Result<()> {
        // A ReLU hides what is no number from the loss, but not from the gradient.
        if loss.is_finite() && gradient.iter().all(|slope| slope.is_finite()) {
            return Ok(());
        }
        let kept = match self.position.best_epoch {
            Some(best) => format!("the best checkpoint, of epoch {best}, is kept"),
            None => "no epoch was finished".to_owned(),
        };
        Err(Error::input(format!(
            "loss {loss} or its gradient is no number in epoch {}, step {step}; {kept}",
            epoch + 1
        ))
        .remedy("train anew with a lower `--learning-rate`"))
    }

    /// How the network does on the validation part.
    fn look(&self, on_progress: &(dyn Fn(TrainEvent) + Sync)) -> Result<Scores> {
        let all = self.validation.facts().len();
        let scored = logits(
            &self.network,
            self.validation,
            self.settings,
            self.normalisation,
            &|done| on_progress(TrainEvent::Look([done, all])),
        )?;
        Ok(Scores::of(&scored))
    }
}

#[cfg(test)]
#[path = "run_test.rs"]
mod tests;
