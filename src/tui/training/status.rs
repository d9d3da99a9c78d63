//! State of a training for the dashboard.

use std::collections::VecDeque;
use std::time::Duration;

use gripcast_train::{EpochMetrics, RunStart, TrainEvent, TrainSettings};

/// Maximum kept lines.
const LINES: usize = 100;
/// Steps over which the speed is averaged.
const SPEED_STEPS: usize = 20;
/// Maximum points of the training loss within an epoch.
const TRACE_POINTS: u64 = 32;

/// News of a training.
#[derive(Clone, Debug, PartialEq)]
pub enum TrainingNews {
    /// The run of a seed has started.
    Seed(u64),
    /// Event of the training.
    Train(TrainEvent),
    /// Other stage of work.
    Stage(&'static str),
}

/// State shown by the dashboard.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingStatus {
    /// Name of the dataset.
    pub(super) data: String,
    /// Name of the run.
    pub(super) out: String,
    pub(super) settings: TrainSettings,
    /// Number of runs, and the current one from 1.
    pub(super) seeds: u64,
    pub(super) seed_number: u64,
    /// Current stage other than steps.
    pub(super) stage: Option<&'static str>,
    pub(super) start: Option<RunStart>,
    /// Finished and total steps.
    pub(super) at: [u64; 2],
    /// Finished and total samples of a running validation.
    pub(super) look: Option<[usize; 2]>,
    pub(super) epochs: Vec<EpochMetrics>,
    pub(super) learning_rate: Option<f64>,
    /// Mean training loss since the start of the epoch or process.
    pub(super) loss: Option<f64>,
    /// Mean training loss within the current epoch, over epochs.
    pub(super) trace: Vec<(f64, f64)>,
    /// Lines, newest last.
    pub(super) lines: VecDeque<String>,
    /// Time since the start of the dashboard.
    pub(super) elapsed: Duration,
    /// Time and step at the start or resumption of the run.
    begun: (Duration, u64),
    /// Time of the last step.
    last: Option<Duration>,
    /// Times and numbers of the last steps of the epoch.
    steps: VecDeque<(Duration, u64)>,
    /// Sum and number of the losses of the mean.
    losses: (f64, u64),
}

impl TrainingStatus {
    /// Creates the state before the first event.
    pub fn new(data: &str, out: &str, settings: TrainSettings, seeds: u64) -> Self {
        Self {
            data: data.to_owned(),
            out: out.to_owned(),
            settings,
            seeds,
            seed_number: 1,
            stage: Some("reading the dataset"),
            start: None,
            at: [0, 0],
            look: None,
            epochs: Vec::new(),
            learning_rate: None,
            loss: None,
            trace: Vec::new(),
            lines: VecDeque::new(),
            elapsed: Duration::ZERO,
            begun: (Duration::ZERO, 0),
            last: None,
            steps: VecDeque::new(),
            losses: (0.0, 0),
        }
    }

    /// Applies news that arrived `elapsed` after the start of the dashboard.
    pub fn apply(&mut self, news: TrainingNews, elapsed: Duration) {
        self.elapsed = elapsed;
        match news {
            TrainingNews::Seed(seed) => self.next(seed),
            TrainingNews::Stage(stage) => self.stage = Some(stage),
            TrainingNews::Train(TrainEvent::Started(start)) => self.begin(start),
            TrainingNews::Train(TrainEvent::Step {
                steps,
                loss,
                learning_rate,
            }) => self.step(steps, loss, learning_rate),
            TrainingNews::Train(TrainEvent::Validate(at)) => self.look = Some(at),
            TrainingNews::Train(TrainEvent::Epoch(figures)) => self.end_epoch(figures),
        }
    }

    /// Adds a line of text.
    pub fn line(&mut self, text: impl Into<String>) {
        if self.lines.len() == LINES {
            self.lines.pop_front();
        }
        self.lines.push_back(text.into());
    }

    /// Sets the elapsed time.
    pub fn set_elapsed(&mut self, elapsed: Duration) {
        self.elapsed = elapsed;
    }

    /// Starts the run of another seed and keeps the last result as a line.
    fn next(&mut self, seed: u64) {
        if self.start.is_some() {
            let best = self.best().map(|best| {
                let auroc = figure(best.validation_auroc);
                format!(
                    "seed {}: best epoch {} of {}, validation AUROC {auroc}, accuracy {:.3}",
                    self.settings.seed,
                    best.epoch,
                    self.epochs.len(),
                    best.validation_accuracy,
                )
            });
            let mut fresh = Self::new(&self.data, &self.out, self.settings.clone(), self.seeds);
            fresh.seed_number = self.seed_number + 1;
            fresh.lines = std::mem::take(&mut self.lines);
            fresh.elapsed = self.elapsed;
            *self = fresh;
            best.into_iter().for_each(|line| self.line(line));
        }
        self.settings.seed = seed;
    }

    fn begin(&mut self, start: RunStart) {
        self.stage = None;
        self.settings.batch_size = start.batch_size;
        for warning in &start.warnings {
            self.line(warning);
        }
        self.at = start.steps;
        self.begun = (self.elapsed, start.steps[0]);
        self.epochs.clone_from(&start.epochs);
        if start.steps[0] > 0 {
            let epochs = start.epochs.len();
            self.line(format!(
                "resumed after {epochs} epochs, {} steps",
                start.steps[0]
            ));
        }
        self.start = Some(start);
    }

    fn step(&mut self, at: [u64; 2], loss: f64, learning_rate: f64) {
        (self.stage, self.look) = (None, None);
        self.at = at;
        self.last = Some(self.elapsed);
        self.learning_rate = Some(learning_rate);
        if self.steps.len() > SPEED_STEPS {
            self.steps.pop_front();
        }
        self.steps.push_back((self.elapsed, at[0]));
        let (sum, count) = (self.losses.0 + loss, self.losses.1 + 1);
        self.losses = (sum, count);
        let mean = sum / count as f64;
        self.loss = Some(mean);
        let steps = self.start.as_ref().map_or(1, |start| start.steps_per_epoch);
        if at[0].is_multiple_of(steps.div_ceil(TRACE_POINTS).max(1)) {
            self.trace.push((at[0] as f64 / steps.max(1) as f64, mean));
        }
    }

    fn end_epoch(&mut self, figures: EpochMetrics) {
        (self.look, self.losses) = (None, (0.0, 0));
        self.trace.clear();
        // Validation does not count for the speed.
        self.steps.clear();
        self.line(epoch_line(&figures));
        self.epochs.push(figures);
    }

    /// Returns the epoch of the best checkpoint.
    pub(super) fn best(&self) -> Option<&EpochMetrics> {
        self.epochs.iter().reduce(|best, next| {
            let is_better = next.beats(best.score());
            if is_better { next } else { best }
        })
    }

    /// Returns the number of epochs of all phases: that of the run once it has started, as phases
    /// depend on what the dataset has.
    pub(super) fn total_epochs(&self) -> u64 {
        let start = self.start.as_ref();
        let of_run = start.and_then(|start| start.steps[1].checked_div(start.steps_per_epoch));
        of_run.unwrap_or_else(|| self.settings.total_epochs().into())
    }

    /// Returns the current epoch, from 1, with its finished and total steps.
    pub(super) fn epoch(&self) -> (u64, [u64; 2]) {
        let steps = self.start.as_ref().map_or(0, |start| start.steps_per_epoch);
        let done = self.epochs.len() as u64;
        let number = (done + 1).min(self.total_epochs());
        let step = self.at[0].saturating_sub((number - 1) * steps).min(steps);
        (number, [step, steps])
    }

    /// Returns the current training speed, samples/s.
    pub(super) fn samples_per_s(&self) -> Option<f64> {
        let current = || {
            let ((first, from), (last, to)) = (self.steps.front()?, self.steps.back()?);
            let seconds = last.checked_sub(*first)?.as_secs_f64();
            let samples = (to - from) as f64 * self.settings.batch_size as f64;
            (seconds > 0.0).then(|| samples / seconds)
        };
        let before = || Some(self.epochs.last()?.samples_per_s);
        current().or_else(before)
    }

    /// Returns the remaining time of all runs without early stopping.
    pub(super) fn remaining(&self) -> Option<Duration> {
        let (begun, from) = self.begun;
        let [done, all] = self.at;
        let moved = done.checked_sub(from).filter(|moved| *moved > 0)?;
        let per_step = self.last?.checked_sub(begun)?.as_secs_f64() / moved as f64;
        let rest = all.saturating_sub(done) + self.seeds.saturating_sub(self.seed_number) * all;
        Duration::try_from_secs_f64(per_step * rest as f64).ok()
    }
}

/// Formats a metric, or a dash for a missing one.
pub(super) fn figure(value: Option<f64>) -> String {
    value.map_or("–".to_owned(), |x| format!("{x:.3}"))
}

/// Formats a finished epoch in one line.
pub(crate) fn epoch_line(figures: &EpochMetrics) -> String {
    format!(
        "epoch {:>3}  loss {:.4}  validation: loss {:.4}, accuracy {:.3}, AUROC {}  {:.0} samples/s",
        figures.epoch,
        figures.train_loss,
        figures.validation_loss,
        figures.validation_accuracy,
        figure(figures.validation_auroc),
        figures.samples_per_s,
    )
}
