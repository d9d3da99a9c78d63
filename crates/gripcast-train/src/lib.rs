//! Training and evaluation of the stability classifier.
//!
//! [`train`] writes a run: a folder with settings, metrics per epoch and checkpoints. A run can be
//! resumed at any time and ends with the same bytes. [`finish`] calibrates the best checkpoint and
//! writes the model file. [`fine_tune`] starts from a
//! trained model instead of random parameters. [`evaluate`] computes metrics of model files on a labelled dataset.

mod augment;
mod batches;
mod boosting;
mod comparison;
mod conformal;
mod duplicates;
mod evaluate;
mod experiment;
mod extents;
mod finish;
mod grasp_head;
mod lift;
mod logistic;
pub mod metrics;
mod ood;
mod page;
mod resampled;
mod run;
mod run_folder;
#[cfg(test)]
mod sample_dataset;
mod samples;
mod settings;
mod start;
mod state;
mod validate;

pub use augment::Augmentation;
pub use batches::colour_normalisation;
pub use comparison::{Comparison, Verdict};
pub use conformal::{ConformalEvaluation, ConformalLabel, conformal_scores, trained_objects};
pub use evaluate::{
    Difference, EvalReport, Mistake, ModelEvaluation, ScoredSample, evaluate, sample_images,
};
pub use experiment::{
    Condition, ConditionDifference, ConditionResult, ExperimentEvent, ExperimentReport,
    ExperimentSettings, TestSet, experiment,
};
pub use finish::{Finished, finish};
pub use lift::{LiftEvaluation, LiftPoint};
pub use page::page;
pub use resampled::SeedResult;
pub use run::{RunStart, SplitCounts, TrainEvent, Trained, fine_tune, train};
pub use run_folder::{EpochMetrics, RunFile, RunFolder};
pub use samples::{SampleFacts, Samples, dataset_sha256};
pub use settings::{FineTuning, TrainSettings};
pub use start::StartModel;
pub use validate::{Logit, SplitLogits, logits};
