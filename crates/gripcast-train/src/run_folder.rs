//! Files of a training run.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::settings::TrainSettings;
use super::state;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{BeneathPath, FileKind, NotLocked, OwnerLock, Root};
use gripcast_nn::Network;
use gripcast_nn::predict::contract::RgbNormalisation;

/// Version of `run.json` and of the checkpoints.
pub(super) const VERSION: u64 = 4;
/// Lock file of a run.
const LOCK: &str = ".lock";

/// Contents of `run.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunFile {
    /// Version of this file.
    pub version: u64,
    /// Version of gripcast.
    pub software: String,
    /// Settings.
    pub settings: TrainSettings,
    /// [`dataset_sha256`](super::dataset_sha256) of the dataset.
    pub dataset_sha256: String,
    /// Mean of the colour images.
    pub rgb_mean: [f32; 3],
    /// Standard deviation of the colour images.
    pub rgb_std: [f32; 3],
    /// Crop profile of the tactile images.
    pub crop_profile: String,
    /// Objects of the training split.
    pub objects: Vec<String>,
}

impl RunFile {
    /// Returns mean and standard deviation of the colour images.
    pub fn normalisation(&self) -> RgbNormalisation {
        RgbNormalisation {
            mean: self.rgb_mean,
            std: self.rgb_std,
        }
    }
}

/// Metrics of an epoch, a line of `metrics.jsonl`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpochMetrics {
    /// Epoch, from 1.
    pub epoch: u32,
    /// Mean training loss, nats.
    pub train_loss: f64,
    /// Class-balanced mean loss on the validation split, nats.
    pub validation_loss: f64,
    /// Balanced accuracy on the validation split at a probability of 0.5.
    pub validation_accuracy: f64,
    /// AUROC on the validation split.
    pub validation_auroc: Option<f64>,
    /// Mean absolute error of the object's extents on the validation split, m; none without camera
    /// images or known extents.
    #[serde(default)]
    pub validation_geometry_error_m: Option<f64>,
    /// Training throughput, samples/s.
    pub samples_per_s: f64,
}

impl EpochMetrics {
    /// AUROC and loss on the validation split, by which epochs are compared.
    pub fn score(&self) -> [f64; 2] {
        let auroc = self.validation_auroc.unwrap_or(f64::NEG_INFINITY);
        [auroc, self.validation_loss]
    }

    /// Returns whether it is better than an epoch with this AUROC and loss.
    pub fn beats(&self, [auroc, loss]: [f64; 2]) -> bool {
        let own = self.score();
        own[0] > auroc || (own[0] == auroc && own[1] < loss)
    }
}

/// Files of a run.
#[derive(Clone, Debug)]
pub struct RunFolder(BeneathPath);

impl RunFolder {
    /// Returns the run in a folder.
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        Self(Root::new(folder).top())
    }

    /// Path of `run.json`: settings and dataset.
    pub fn run(&self) -> BeneathPath {
        self.0.join("run.json")
    }

    /// Path of `metrics.jsonl`: metrics of its epochs.
    pub fn metrics(&self) -> BeneathPath {
        self.0.join("metrics.jsonl")
    }

    /// Path of the last checkpoint.
    pub fn state(&self) -> BeneathPath {
        self.0.join("state.bin")
    }

    /// Path of the best checkpoint.
    pub fn best(&self) -> BeneathPath {
        self.0.join("best.bin")
    }

    /// Path of a copy of the model that fine-tuning starts from.
    pub fn start(&self) -> BeneathPath {
        self.0.join("start.onnx")
    }

    /// Path of the exported model.
    pub fn model(&self) -> BeneathPath {
        self.0.join("model.onnx")
    }

    /// Locks the run, so that one program at a time writes it. The folder must exist.
    ///
    /// # Errors
    /// `Busy`, naming the process that holds the lock. Errors of creating the lock file.
    pub fn lock(&self) -> Result<OwnerLock> {
        let path = self.0.shown().join(LOCK);
        OwnerLock::acquire(&path).map_err(|why| match why {
            NotLocked::Held(owner) => Error::new(
                ErrorKind::Busy,
                format!("the run is being trained by {owner}"),
            )
            .at(self.0.display())
            .remedy("wait for it or end it, or name another folder with `--out`"),
            NotLocked::Open(e) | NotLocked::Refused(e) | NotLocked::Lock(e) => {
                Error::io("cannot lock the run", e).at(path.display())
            }
        })
    }

    /// Reads `run.json`; none if there is no run.
    ///
    /// # Errors
    /// `Input`: the file is damaged. `Usage`: it has another version. Errors of reading it.
    pub fn read(&self) -> Result<Option<RunFile>> {
        let path = self.run();
        let text = match path.read(FileKind::List) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io("cannot read the run", e).at(path.display())),
        };
        let invalid = |e| {
            Error::input("invalid run description")
                .because(e)
                .at(path.display())
        };
        let value: Value = serde_json::from_slice(&text).map_err(invalid)?;
        if let Some(version) = value["version"].as_u64().filter(|v| *v != VERSION) {
            let what = format!("expected a run of version {VERSION}, found version {version}");
            return Err(Error::usage(what).at(path.display()).remedy(
                "resume it with the gripcast that started it (`software`), or name another folder",
            ));
        }
        serde_json::from_value(value).map(Some).map_err(invalid)
    }

    /// Loads the network and the metrics of the best checkpoint.
    ///
    /// # Errors
    /// `Input`: it is damaged, or of other settings. Errors of reading it.
    pub fn best_network(&self, settings: &TrainSettings) -> Result<(Network, EpochMetrics)> {
        let path = self.best();
        let (metrics, arrays): (EpochMetrics, _) = state::load(&path)?;
        let mut network = untrained(settings, || 0.5);
        let sizes = [network.parameters.len(), network.running_stats.len()];
        let [parameters, moments] =
            state::with_sizes(arrays, sizes).ok_or_else(|| foreign_checkpoint(&path))?;
        network.parameters = parameters;
        network.running_stats = moments;
        Ok((network, metrics))
    }
}

pub(super) fn untrained(settings: &TrainSettings, uniform: impl FnMut() -> f64) -> Network {
    Network::new(&settings.architecture, settings.modality, uniform)
}

pub(super) fn foreign_checkpoint(path: &BeneathPath) -> Error {
    Error::input("the checkpoint has other array sizes than the network")
        .at(path.display())
        .remedy("name another folder for the run")
}
