//! Training the stability classifier on datasets of labelled grasps, and measuring it.
//!
//! [`train`] makes a run: a folder with settings, figures of each epoch, checkpoints, from which it
//! goes on at any time and ends with the same bytes. [`finish`] calibrates the best checkpoint and
//! writes the model file.

mod augment;
mod batches;
mod evaluate;
mod experiment;
mod finish;
mod known;
mod look;
pub mod metrics;
mod page;
mod run;
mod run_folder;
#[cfg(test)]
mod sample_dataset;
mod samples;
mod settings;
mod state;

pub use augment::Augmentation;
pub use batches::colour_normalisation;
pub use evaluate::{
    Difference, EvalReport, Mistake, ModelEvaluation, ScoredSample, evaluate, sample_images,
};
pub use experiment::{
    Condition, ConditionDifference, ConditionResult, ExperimentEvent, ExperimentReport,
    ExperimentSettings, TestSet, experiment,
};
pub use finish::{Finished, finish};
pub use look::{Logit, logits};
pub use page::page;
pub use run::{PartCounts, RunStart, TrainEvent, Trained, train};
pub use run_folder::{EpochFigures, RunFile, RunFolder};
pub use samples::{SampleFacts, Samples, dataset_sha256};
pub use settings::TrainSettings;
