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

/// Fits the reference to the augmented tactile differences of a run's training split. None
/// without touch, or with too few samples.
///
/// # Errors
/// Errors of reading and decoding.
pub(super) fn fit_tactile_reference(
    samples: &Samples,
    file: &RunFile,
) -> Result<Option<OodDetector>> {
    let settings = &file.settings;
    if !settings.modality.has_touch() {
        return Ok(None);
    }
    let writer = InputWriter::new(settings.augmentation, file.normalisation());
    let mut batches = Batches::new(samples, Modality::T, writer, MEMORY);
    let step = samples.facts().len().div_ceil(MAX_SAMPLES).max(1);
    let selected: Vec<usize> = (0..samples.facts().len()).step_by(step).collect();
    let mut draw = SeedStream::named(settings.seed, "known touch");
    let mut reference: Vec<Features> = Vec::with_capacity(2 * selected.len());
    for indices in selected.chunks(BATCH_SIZE) {
        let seeds: Vec<u64> = indices.iter().map(|_| draw.bits()).collect();
        let batch = batches.batch(indices, Some(&seeds))?;
        let features = batch.touch.par_chunks_exact(FLOATS).filter_map(features);
        reference.extend(features.collect::<Vec<_>>());
    }
    Ok(OodDetector::fit(&reference))
}
