//! What the tactile images of a training part look like.

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

/// Most samples that are looked at, evenly spread: two sensors each, enough for one in a thousand.
const MAX_SAMPLES: usize = 2000;
/// Samples that are decoded together.
const BATCH: usize = 32;
/// Bytes of images that are kept; samples are looked at in their order.
const MEMORY: usize = 1 << 25;

/// Describes the tactile differences of a run's training part, changed at random as in training:
/// what the network was shown is what it knows. None without touch, or for a handful of samples.
///
/// # Errors
/// Those of reading and decoding.
pub(super) fn known_touch(samples: &Samples, file: &RunFile) -> Result<Option<OodDetector>> {
    let settings = &file.settings;
    if !settings.variant.has_touch() {
        return Ok(None);
    }
    let writer = InputWriter::new(settings.augmentation, file.normalisation());
    let mut batches = Batches::new(samples, Modality::T, writer, MEMORY);
    let step = samples.facts().len().div_ceil(MAX_SAMPLES).max(1);
    let some: Vec<usize> = (0..samples.facts().len()).step_by(step).collect();
    let mut draw = SeedStream::named(settings.seed, "known touch");
    let mut known: Vec<Features> = Vec::with_capacity(2 * some.len());
    for some in some.chunks(BATCH) {
        let seeds: Vec<u64> = some.iter().map(|_| draw.bits()).collect();
        let batch = batches.batch(some, Some(&seeds))?;
        let found = batch.touch.par_chunks_exact(FLOATS).filter_map(features);
        known.extend(found.collect::<Vec<_>>());
    }
    Ok(OodDetector::fit(&known))
}
