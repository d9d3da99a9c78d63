//! The files of a training run.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::settings::TrainSettings;
use super::state;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, Root};
use gripcast_nn::Network;
use gripcast_nn::predict::contract::RgbNormalisation;

/// Settings of earlier versions, which did nothing at zero.
pub(super) const RETIRED: [&str; 3] = ["mix", "quantity_weight", "average"];

/// What `run.json` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunFile {
    /// Of this file.
    pub version: u32,
    /// Of gripcast.
    pub software: String,
    /// What the run is made by.
    pub settings: TrainSettings,
    /// [`dataset_sha256`] of the dataset.
    pub dataset_sha256: String,
    /// Mean and deviation of the colour images.
    pub rgb_mean: [f32; 3],
    /// Deviation.
    pub rgb_std: [f32; 3],
    /// Crop profile of the tactile images.
    pub crop_profile: String,
    /// Objects that are trained on.
    pub objects: Vec<String>,
}

impl RunFile {
    /// Mean and deviation of the colour images.
    pub fn normalisation(&self) -> RgbNormalisation {
        RgbNormalisation {
            mean: self.rgb_mean,
            std: self.rgb_std,
        }
    }
}

/// One line of `metrics.jsonl`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpochFigures {
    /// From 1.
    pub epoch: u32,
    /// Mean loss over its steps, nats.
    pub train_loss: f64,
    /// On the validation part: mean loss of balanced labels, nats.
    pub validation_loss: f64,
    /// Balanced accuracy there at a probability of one half.
    pub validation_accuracy: f64,
    /// Area under the ROC curve there.
    pub validation_auroc: Option<f64>,
    /// Samples learned from in a second of wall time.
    pub samples_per_s: f64,
}

impl EpochFigures {
    /// Whether it is a better checkpoint than one of this accuracy and loss on the validation part.
    pub fn beats(&self, [accuracy, loss]: [f64; 2]) -> bool {
        self.validation_accuracy > accuracy
            || (self.validation_accuracy == accuracy && self.validation_loss < loss)
    }
}

/// Files of a run.
#[derive(Clone, Debug)]
pub struct RunFolder(BeneathPath);

impl RunFolder {
    /// The run in a folder.
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        Self(Root::new(folder).top())
    }

    /// Its settings and origin.
    pub fn run(&self) -> BeneathPath {
        self.0.join("run.json")
    }

    /// Figures of its epochs.
    pub fn metrics(&self) -> BeneathPath {
        self.0.join("metrics.jsonl")
    }

    /// The last checkpoint.
    pub fn state(&self) -> BeneathPath {
        self.0.join("state.bin")
    }

    /// The best one.
    pub fn best(&self) -> BeneathPath {
        self.0.join("best.bin")
    }

    /// The model that came out.
    pub fn model(&self) -> BeneathPath {
        self.0.join("model.onnx")
    }

    /// Reads `run.json`; none where there is no run.
    ///
    /// # Errors
    /// `Input`: the file is damaged. Those of reading it.
    pub fn read(&self) -> Result<Option<RunFile>> {
        let place = self.run();
        let text = match place.read(FileKind::List) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io("cannot read the run", e).at(place.display())),
        };
        let unreadable = |e| {
            Error::input("the run's description cannot be read")
                .because(e)
                .at(place.display())
        };
        let mut found: Value = serde_json::from_slice(&text).map_err(unreadable)?;
        for name in RETIRED {
            let settings = found["settings"].as_object_mut();
            let value = settings.and_then(|settings| settings.remove(name));
            if let Some(value) = value.filter(|value| value.as_f64() != Some(0.0)) {
                let what =
                    format!("the run was begun with `{name}` {value}, which is no longer there");
                let error = Error::usage(what).at(place.display());
                return Err(error.remedy(
                    "go on with the gripcast that began it (`software`), or name another folder",
                ));
            }
        }
        serde_json::from_value(found).map(Some).map_err(unreadable)
    }

    /// The network of the best checkpoint, and what was measured there.
    ///
    /// # Errors
    /// `Input`: it is damaged, or of other settings. Those of reading it.
    pub fn best_network(&self, settings: &TrainSettings) -> Result<(Network, EpochFigures)> {
        let place = self.best();
        let (figures, arrays): (EpochFigures, _) = state::load(&place)?;
        let mut network = untrained(settings, || 0.5);
        let sizes = [network.parameters.len(), network.running_stats.len()];
        let [parameters, moments] =
            state::of_sizes(arrays, sizes).ok_or_else(|| foreign_checkpoint(&place))?;
        network.parameters = parameters;
        network.running_stats = moments;
        Ok((network, figures))
    }
}

pub(super) fn untrained(settings: &TrainSettings, uniform: impl FnMut() -> f64) -> Network {
    Network::new(&settings.architecture, settings.variant, uniform)
}

pub(super) fn foreign_checkpoint(place: &BeneathPath) -> Error {
    let what = "the checkpoint is of a network with other sizes";
    let error = Error::input(what).at(place.display());
    error.remedy("name another folder for the run")
}
