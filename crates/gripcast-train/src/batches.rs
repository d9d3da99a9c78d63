//! Batches of samples, decoded and augmented on all cores.

use rayon::prelude::*;

use super::augment::{FLOATS, InputWriter, SampleImages, Slots, Written};
use super::samples::{SampleReader, Samples};
use gripcast_base::error::Result;
use gripcast_imaging::Decoder;
use gripcast_nn::predict::contract::{GEOMETRY_UNIT_M, Modality, RgbNormalisation};
use gripcast_nn::{Batch, CONTACT_CHANNELS, GEOMETRY};
use gripcast_shear::ContactMaps;

/// Samples used for the mean and standard deviation of the colour image.
const NORMALISATION_SAMPLES: usize = 256;

/// Loads batches of a split.
#[derive(Debug)]
pub(super) struct Batches<'a> {
    samples: &'a Samples,
    reader: SampleReader<'a>,
    modality: Modality,
    writer: InputWriter,
    /// Loss weight of each sample.
    weights: Vec<f32>,
}

impl<'a> Batches<'a> {
    /// Creates batches for a modality; about `memory` bytes of encoded images are cached.
    pub(super) fn new(
        samples: &'a Samples,
        modality: Modality,
        writer: InputWriter,
        memory: usize,
    ) -> Self {
        Self {
            samples,
            reader: SampleReader::new(samples, memory),
            modality,
            writer,
            weights: vec![1.0; samples.facts().len()],
        }
    }

    /// Balances the labels by loss weights.
    #[must_use]
    pub(super) fn balanced(mut self) -> Self {
        let [slip, stable] = self.samples.by_label().map(|count| count.max(1) as f32);
        let half = 0.5 * (slip + stable);
        let facts = self.samples.facts().iter();
        let weights = facts.map(|facts| half / if facts.is_stable { stable } else { slip });
        self.weights = weights.collect();
        self
    }

    /// Loads a batch, augmented if seeds are given.
    ///
    /// # Errors
    /// Errors of reading and decoding, with the sample.
    pub(super) fn batch(&mut self, samples: &[usize], seeds: Option<&[u64]>) -> Result<Batch> {
        let rows = self.reader.rows(samples)?;
        let count = samples.len();
        let modality = self.modality;
        let floats = |is_used, images: usize| vec![0.0; usize::from(is_used) * images * FLOATS];
        let mut touch = floats(modality.has_touch(), 2 * count);
        let mut vision = floats(modality.has_vision(), count);
        let mut depth = floats(modality.has_depth(), count);
        let half = touch.len() / 2;
        let (left, right) = touch.split_at_mut(half);
        let [mut left, mut right, mut rgb, mut points] =
            [left, right, &mut vision[..], &mut depth[..]].map(|all| all.chunks_exact_mut(FLOATS));
        let slots: Vec<Slots<'_>> = (0..count)
            .map(|_| Slots {
                touch: [
                    left.next().unwrap_or_default(),
                    right.next().unwrap_or_default(),
                ],
                rgb: rgb.next().unwrap_or_default(),
                depth: points.next().unwrap_or_default(),
            })
            .collect();
        let written: Vec<Written> = slots
            .into_par_iter()
            .zip(rows)
            .enumerate()
            .map_init(
                || None,
                |decoder, (i, (slots, (rows, row)))| {
                    let decoder = match decoder {
                        Some(decoder) => decoder,
                        none => none.insert(Decoder::new()?),
                    };
                    let row = &rows[row];
                    let images = SampleImages::decode(decoder, &row.images, modality)
                        .map_err(|e| e.at(&row.facts.id))?;
                    let seed = seeds.and_then(|seeds| seeds.get(i)).copied();
                    Ok(self.writer.write(&images, seed, slots))
                },
            )
            .collect::<Result<_>>()?;
        let facts = || samples.iter().map(|i| &self.samples.facts()[*i]);
        let geometry = facts().zip(&written).flat_map(|(facts, written)| {
            let geometry = facts.geometry.map(|geometry| match written.is_mirrored {
                true => geometry.mirrored(),
                false => geometry,
            });
            geometry.map_or([f32::NAN; GEOMETRY], |geometry| {
                geometry.to_array().map(|m| (m / GEOMETRY_UNIT_M) as f32)
            })
        });
        let with_touch = || {
            let written = facts().zip(&written);
            written.filter(|_| modality.has_touch())
        };
        let is_known = with_touch().any(|(facts, _)| facts.contact.is_some());
        let sides = [0, 1].into_iter().filter(|_| is_known);
        let contact = sides.flat_map(|side| {
            with_touch().flat_map(move |(facts, written)| {
                let gel = if written.is_swapped { 1 - side } else { side };
                let gel = facts.contact.as_ref().map(|maps| maps.gels()[gel]);
                contact_target(gel, written.is_mirrored)
            })
        });
        Ok(Batch {
            contact: contact.collect(),
            geometry: geometry.collect(),
            // A sample without any input has at least no weight.
            available: written
                .iter()
                .map(|written| written.available.unwrap_or(Modality::T))
                .collect(),
            targets: facts()
                .map(|facts| f32::from(u8::from(facts.is_stable)))
                .collect(),
            weights: samples.iter().map(|i| self.weights[*i]).collect(),
            touch,
            vision,
            depth,
        })
    }
}

/// Units of the contact maps: displacement into the gel, and other values, m.
const CONTACT_UNITS_M: [f64; 2] = [2.5e-4, 1.25e-4];

/// Contact map of a gel as its encoder learns it: at each cell the displacement into the gel, half
/// its difference to the cells on both sides, to the right and down, and the displacement to the
/// right and down. NaN for an unknown one.
fn contact_target(gel: Option<&[f64]>, is_mirrored: bool) -> Vec<f32> {
    let [rows, columns] = ContactMaps::CELLS;
    let Some(gel) = gel else {
        return vec![f32::NAN; rows * columns * CONTACT_CHANNELS];
    };
    let (cells, _) = gel.as_chunks::<{ ContactMaps::COMPONENTS }>();
    let at = |row: usize, column: usize| {
        let row = if is_mirrored { rows - 1 - row } else { row };
        let [right, down, inward] = cells[row * columns + column];
        [right, if is_mirrored { -down } else { down }, inward]
    };
    let inward = |row: usize, column: usize| at(row, column)[2];
    let mut target = Vec::with_capacity(rows * columns * CONTACT_CHANNELS);
    for row in 0..rows {
        for column in 0..columns {
            let [left, right] = [column.saturating_sub(1), (column + 1).min(columns - 1)];
            let [above, below] = [row.saturating_sub(1), (row + 1).min(rows - 1)];
            let [x, y, depth] = at(row, column);
            let values = [
                depth,
                0.5 * (inward(row, right) - inward(row, left)),
                0.5 * (inward(below, column) - inward(above, column)),
                x,
                y,
            ];
            let [of_depth, of_others] = CONTACT_UNITS_M;
            let units = [of_depth, of_others, of_others, of_others, of_others];
            target.extend(values.iter().zip(units).map(|(m, unit)| (m / unit) as f32));
        }
    }
    target
}

/// Computes mean and standard deviation of the colour images from evenly spaced samples.
///
/// # Errors
/// Errors of reading and decoding.
pub fn colour_normalisation(samples: &Samples) -> Result<RgbNormalisation> {
    let step = samples.facts().len().div_ceil(NORMALISATION_SAMPLES).max(1);
    let mut reader = SampleReader::new(samples, 0);
    let mut decoder = Decoder::new()?;
    let (mut sums, mut squares, mut count) = ([0_u64; 3], [0_u64; 3], 0_u64);
    for sample in (0..samples.facts().len()).step_by(step) {
        for (rows, row) in reader.rows(&[sample])? {
            let row = &rows[row];
            let images = SampleImages::decode(&mut decoder, &row.images, Modality::V)
                .map_err(|e| e.at(&row.facts.id))?;
            for pixel in images.rgb.pixels() {
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
        // Avoids a zero for uniform images.
        (square - mean[c] * mean[c]).max(1e-4).sqrt()
    });
    Ok(RgbNormalisation {
        mean: mean.map(|x| x as f32),
        std: std.map(|x| x as f32),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::augment::Augmentation;
    use crate::sample_dataset::{row, write_split};

    #[test]
    fn target_of_a_mirrored_gel_is_that_of_the_mirrored_image() {
        let [rows, columns] = ContactMaps::CELLS;
        let cell = |row: usize, column: usize| {
            let (x, y) = (column as f64, row as f64);
            [1e-5 * x, 1e-5 * (y + x * y), 1e-5 * (3.0 * x + y * y)]
        };
        let cells = (0..rows * columns).map(|i| cell(i / columns, i % columns));
        let gel: Vec<f64> = cells.flatten().collect();
        let target = contact_target(Some(&gel), false);
        let at = |target: &[f32], row: usize, column: usize| -> Vec<f32> {
            let first = (row * columns + column) * CONTACT_CHANNELS;
            target[first..first + CONTACT_CHANNELS].to_vec()
        };
        // 3·2 + 4², 3, (5² − 3²) / 2, 2, 4 + 2·4, each 1e-5 m.
        let expected = [22.0 / 25.0, 3.0 / 12.5, 8.0 / 12.5, 2.0 / 12.5, 12.0 / 12.5];
        for (found, expected) in at(&target, 4, 2).into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
        let mirrored = contact_target(Some(&gel), true);
        for row in 0..rows {
            for column in 0..columns {
                let mut other = at(&target, rows - 1 - row, column);
                (other[2], other[4]) = (-other[2], -other[4]);
                assert_eq!(at(&mirrored, row, column), other);
            }
        }
        assert!(contact_target(None, false).iter().all(|x| x.is_nan()));
    }

    #[test]
    fn both_labels_have_the_same_weight() {
        let folder = tempfile::tempdir().unwrap();
        // One slip for two stable samples.
        let rows = (0..24)
            .filter(|number| number % 4 != 2)
            .map(|number| row("train", number));
        write_split(folder.path(), "train", rows);
        let samples = Samples::open(folder.path(), "train").unwrap();
        let [slip, stable] = samples.by_label();
        assert!(0 < slip && slip != stable, "{slip} {stable}");
        let writer = InputWriter::new(Augmentation::NONE, RgbNormalisation::NONE);
        let batches = Batches::new(&samples, Modality::T, writer, 0).balanced();
        let sum = |is_stable: bool| -> f32 {
            let weighed = samples.facts().iter().zip(&batches.weights);
            let of = weighed.filter(|(facts, _)| facts.is_stable == is_stable);
            of.map(|(_, weight)| weight).sum()
        };
        let [slip, stable] = [false, true].map(sum);
        assert!((slip - stable).abs() < 1e-4 && (slip + stable - 18.0).abs() < 1e-4);
    }
}
