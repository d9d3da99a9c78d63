//! Batches of samples, decoded and changed on all cores.

use rayon::prelude::*;

use super::augment::{FLOATS, InputWriter, SamplePictures};
use super::quantities::QuantityScale;
use super::samples::{SampleReader, Samples};
use crate::error::Result;
use crate::imaging::Decoder;
use crate::nn::{Batch, Senses};
use crate::predict::contract::RgbNormalisation;

/// Samples from which mean and deviation of the colour picture are taken.
const NORMALISATION_SAMPLES: usize = 256;

/// Makes batches of a part of a dataset.
#[derive(Debug)]
pub(super) struct Batches<'a> {
    samples: &'a Samples,
    reader: SampleReader<'a>,
    senses: Senses,
    writer: InputWriter,
    /// What a lost and a stable sample count.
    weights: [f32; 2],
    /// Scale of the quantities beside the label, where they are wanted.
    scale: Option<QuantityScale>,
}

impl<'a> Batches<'a> {
    /// Batches for a network with these senses; `memory` bytes of encoded pictures are kept.
    pub(super) fn new(
        samples: &'a Samples,
        senses: Senses,
        writer: InputWriter,
        memory: usize,
    ) -> Self {
        Self {
            samples,
            reader: SampleReader::new(samples, memory),
            senses,
            writer,
            weights: [1.0; 2],
            scale: None,
        }
    }

    /// With the quantities beside the label, where a scale is given.
    #[must_use]
    pub(super) fn with_quantities(mut self, scale: Option<QuantityScale>) -> Self {
        self.scale = scale;
        self
    }

    /// Lets both labels count the same in sum.
    #[must_use]
    pub(super) fn balanced(mut self) -> Self {
        let counts = self.samples.by_label();
        let all = counts[0] + counts[1];
        self.weights = counts.map(|count| all as f32 / (2 * count.max(1)) as f32);
        self
    }

    /// The batch of some samples, changed at random where seeds are given.
    ///
    /// # Errors
    /// Those of reading and decoding, with the sample.
    pub(super) fn batch(&mut self, samples: &[usize], seeds: Option<&[u64]>) -> Result<Batch> {
        let rows = self.reader.rows(samples)?;
        let count = samples.len();
        let floats = |is_seen, pictures: usize| vec![0.0; usize::from(is_seen) * pictures * FLOATS];
        let mut touch = floats(self.senses.touch, 2 * count);
        let mut vision = floats(self.senses.vision, count);
        let (left, right) = touch.split_at_mut(usize::from(self.senses.touch) * count * FLOATS);
        let mut slots: Vec<[&mut [f32]; 3]> = Vec::with_capacity(count);
        let mut vision_slots = vision.chunks_exact_mut(FLOATS);
        let (mut left, mut right) = (
            left.chunks_exact_mut(FLOATS),
            right.chunks_exact_mut(FLOATS),
        );
        for _ in 0..count {
            slots.push([
                left.next().unwrap_or_default(),
                right.next().unwrap_or_default(),
                vision_slots.next().unwrap_or_default(),
            ]);
        }
        let senses = [self.senses.touch, self.senses.vision];
        let seen = slots
            .into_par_iter()
            .zip(rows)
            .enumerate()
            .map_init(
                || None,
                |decoder, (at, ([left, right, rgb], (rows, row)))| {
                    let decoder = match decoder {
                        Some(decoder) => decoder,
                        none => none.insert(Decoder::new()?),
                    };
                    let row = &rows[row];
                    let pictures = SamplePictures::decode(decoder, &row.images, senses)
                        .map_err(|e| e.at(&row.facts.id))?;
                    let seed = seeds.and_then(|seeds| seeds.get(at)).copied();
                    Ok(self.writer.write(&pictures, seed, [left, right], rgb))
                },
            )
            .collect::<Result<Vec<_>>>()?;
        let facts: Vec<_> = samples
            .iter()
            .map(|at| &self.samples.facts()[*at])
            .collect();
        let of = |is_stable: bool| self.weights[usize::from(is_stable)];
        let quantities = self.scale.iter().flat_map(|scale| {
            let samples = facts.iter().zip(&seen);
            samples.flat_map(|(facts, seen)| {
                scale.seen(&facts.quantities, seen.is_swapped, seen.is_turned)
            })
        });
        Ok(Batch {
            touch,
            vision,
            targets: facts
                .iter()
                .map(|f| f32::from(u8::from(f.is_stable)))
                .collect(),
            weights: facts.iter().map(|f| of(f.is_stable)).collect(),
            quantities: quantities.collect(),
        })
    }
}

/// Mean and deviation of the colour pictures, from evenly spread samples.
///
/// # Errors
/// Those of reading and decoding.
pub fn colour_normalisation(samples: &Samples) -> Result<RgbNormalisation> {
    let step = samples.facts().len().div_ceil(NORMALISATION_SAMPLES).max(1);
    let some: Vec<usize> = (0..samples.facts().len()).step_by(step).collect();
    let mut reader = SampleReader::new(samples, 0);
    let mut decoder = Decoder::new()?;
    let (mut sums, mut squares, mut count) = ([0_u64; 3], [0_u64; 3], 0_u64);
    for at in some {
        for (rows, row) in reader.rows(&[at])? {
            let row = &rows[row];
            let pictures = SamplePictures::decode(&mut decoder, &row.images, [false, true])
                .map_err(|e| e.at(&row.facts.id))?;
            for pixel in pictures.rgb.pixels() {
                for c in 0..3 {
                    let level = u64::from(pixel.0[c]);
                    sums[c] += level;
                    squares[c] += level * level;
                }
                count += 1;
            }
        }
    }
    let count = count.max(1) as f64;
    let mean = sums.map(|sum| sum as f64 / count / 255.0);
    let std: [f64; 3] = std::array::from_fn(|c| {
        let square = squares[c] as f64 / count / (255.0 * 255.0);
        // Pictures of one colour have no deviation.
        (square - mean[c] * mean[c]).max(1e-4).sqrt()
    });
    Ok(RgbNormalisation {
        mean: mean.map(|x| x as f32),
        std: std.map(|x| x as f32),
    })
}
