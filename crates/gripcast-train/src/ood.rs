//! Out-of-distribution reference of a model: the tactile images of its training split.

use rayon::prelude::*;

use super::augment::{FLOATS, InputWriter};
use super::batches::Batches;
use super::run_folder::RunFile;
use super::samples::Samples;
use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_nn::predict::OodDetector;
use gripcast_nn::predict::contract::Modality;
use gripcast_nn::predict::ood::{Features, features};

/// Maximum number of samples, evenly spaced; with two sensors each, enough for a 0.1 % quantile.
const MAX_SAMPLES: usize = 2000;
const BATCH_SIZE: usize = 32;
/// Cached bytes of images; samples are read in order.
const MEMORY: usize = 1 << 25;

/// Minimum number of differences in fine-tuning: few grasps are augmented several times.
const MIN_DIFFERENCES: usize = 256;

/// Fits the reference to the augmented tactile differences of a run's training split; in
/// fine-tuning adapts that of the start model, see [`OodDetector::adapted`]. None without touch, or
/// with too few samples.
///
/// # Errors
/// Errors of reading and decoding.
pub(super) fn fit_tactile_reference(
    train: &Samples,
    validation: &Samples,
    file: &RunFile,
    start: Option<&OodDetector>,
) -> Result<Option<OodDetector>> {
    if !file.settings.modality.has_touch() {
        return Ok(None);
    }
    let Some(start) = start else {
        return Ok(OodDetector::fit(&augmented(train, file, 1)?));
    };
    let own = 2 * train.facts().len();
    let rounds = MIN_DIFFERENCES.div_ceil(own);
    let held_out = augmented(validation, file, rounds)?;
    Ok(start.adapted(&augmented(train, file, rounds)?, own, &held_out))
}

/// Returns the features of a split's tactile differences, each augmented `rounds` times.
fn augmented(samples: &Samples, file: &RunFile, rounds: usize) -> Result<Vec<Features>> {
    let settings = &file.settings;
    let writer = InputWriter::new(settings.augmentation, file.normalisation());
    let mut batches = Batches::new(samples, Modality::T, writer, MEMORY);
    let step = samples.facts().len().div_ceil(MAX_SAMPLES).max(1);
    let selected: Vec<usize> = (0..samples.facts().len()).step_by(step).collect();
    let mut draw = SeedStream::named(settings.seed, "known touch");
    let mut rows: Vec<Features> = Vec::with_capacity(2 * rounds * selected.len());
    for _ in 0..rounds {
        for indices in selected.chunks(BATCH_SIZE) {
            let seeds: Vec<u64> = indices.iter().map(|_| draw.bits()).collect();
            let batch = batches.batch(indices, Some(&seeds))?;
            let features = batch.touch.par_chunks_exact(FLOATS).filter_map(features);
            rows.extend(features.collect::<Vec<_>>());
        }
    }
    Ok(rows)
}
