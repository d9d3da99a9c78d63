//! Measuring model files on a part of a dataset whose outcomes are known.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::augment::SampleImages;
use super::finish::OBJECTS;
use super::metrics::{
    BaseRateCalibration, Bootstrap, ChanceCalibration, GroupSummary, Interval, Ranking,
    ReliabilityTable, Scored, SeedSummary, Summary, resampled_mean, summarise_groups,
};
use super::samples::{SampleFacts, SampleReader, Samples};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{Decoder, TactileDifference};
use gripcast_nn::predict::contract::{InputName, Modality, Origin};
use gripcast_nn::predict::{Model, ModelInput};

/// Samples that are read together.
const CHUNK: usize = 64;
/// Bytes of encoded images that are kept.
const MEMORY: usize = 1 << 25;
/// Change of a pixel's strongest colour that counts as touched, grey levels.
const TOUCHED_LEVELS: i16 = 25;
/// Fraction of touched pixels from which an image shows a contact.
const TOUCHED_FRACTION: f64 = 0.004;
/// Mistakes of each kind that a report shows.
const MISTAKES: usize = 12;
/// Of the bootstrap.
const SEED: u64 = 0;

/// What was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvalReport {
    /// `gripcast-eval`.
    pub format: String,
    /// Of the format.
    pub version: u32,
    /// Of gripcast.
    pub software: String,
    /// Folder of the dataset.
    pub dataset: String,
    /// SHA-256 of its files, see [`dataset_sha256`](super::dataset_sha256).
    pub dataset_sha256: String,
    /// Part that was measured on.
    pub split: String,
    /// Objects of it.
    pub objects: usize,
    /// The models, in the order that they were named.
    pub models: Vec<ModelEvaluation>,
    /// Mean and deviation over the models, where there are several.
    pub over_models: Option<SeedSummary>,
    /// How much better the first model is than each other one, over objects.
    pub differences: Vec<Difference>,
    /// What may make the figures better than they are.
    pub warnings: Vec<String>,
}

/// One model's figures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelEvaluation {
    /// Its name.
    pub name: String,
    /// Its file.
    pub file: String,
    /// SHA-256 of the file.
    pub sha256: String,
    /// Senses: `V`, `T` or `VT`.
    pub variant: Modality,
    /// All samples, at the model's threshold.
    pub summary: Summary,
    /// AUROC with its 95 % interval over objects.
    pub auroc: Option<Interval>,
    /// Balanced accuracy with its 95 % interval over objects.
    pub balanced_accuracy: Option<Interval>,
    /// Only samples in which both sensors' images show a contact.
    pub in_contact: Summary,
    /// Calibration, 15 bins.
    pub reliability: ReliabilityTable,
    /// The calibration error that so few lifts show by chance alone.
    pub ece_by_chance: Option<ChanceCalibration>,
    /// Calibration for the fraction of these grasps that held.
    #[serde(default)]
    pub at_base_rate: Option<BaseRateCalibration>,
    /// By category.
    pub categories: Vec<GroupSummary>,
    /// By object.
    pub per_object: Vec<GroupSummary>,
    /// By stopping force, N.
    pub forces: Vec<GroupSummary>,
    /// The most confident mistakes: of stable grasps, then of lost ones.
    pub mistakes: Vec<Mistake>,
    /// Every prediction.
    pub predictions: Vec<ScoredSample>,
}

/// One prediction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScoredSample {
    /// Id of the sample.
    pub id: String,
    /// Its object.
    pub object: String,
    /// What the model says.
    pub p_stable: f64,
    /// What happened.
    pub stable: bool,
    /// Whether both sensors' images show a contact.
    pub in_contact: bool,
}

/// A confident mistake.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mistake {
    /// Number of the sample in its part.
    pub sample: usize,
    /// Its id.
    pub id: String,
    /// Its object.
    pub object: String,
    /// What the model says.
    pub p_stable: f64,
    /// What happened.
    pub stable: bool,
}

/// A paired comparison on the same samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// The better one, if the differences are above zero.
    pub first: String,
    /// The other one.
    pub second: String,
    /// Of the AUROC.
    pub auroc: Option<Interval>,
    /// Of the balanced accuracy.
    pub balanced_accuracy: Option<Interval>,
}

/// Measures models on a part of a dataset. `training` is the dataset's part that models of the same
/// dataset were trained on, if there is one.
///
/// # Errors
/// `Input`: a model for images that are cropped in another way, or damaged images. Those of
/// reading the dataset.
pub fn evaluate(
    models: &[(String, Model)],
    samples: &Samples,
    training: Option<&Samples>,
    dataset_sha256: &str,
    on_progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<EvalReport> {
    for (file, model) in models {
        model
            .contract()
            .check_crop_profile(samples.crop_profile())
            .map_err(|e| e.at(file))?;
    }
    let all = models.len() * samples.facts().len();
    let mut evaluated = Vec::new();
    for (at, (file, model)) in models.iter().enumerate() {
        let before = at * samples.facts().len();
        let found = predictions(model, samples, &|done| on_progress(before + done, all))?;
        evaluated.push(ModelEvaluation::new(file, model, samples, found));
    }
    let summaries: Vec<Summary> = evaluated.iter().map(|e| e.summary.clone()).collect();
    let differences = evaluated.iter().skip(1);
    let differences = differences
        .map(|other| Difference::between(&evaluated[0], other))
        .collect();
    Ok(EvalReport {
        format: "gripcast-eval".to_owned(),
        version: 1,
        software: concat!("gripcast ", env!("CARGO_PKG_VERSION")).to_owned(),
        dataset: samples.root().display().to_string(),
        dataset_sha256: dataset_sha256.to_owned(),
        split: samples.split().to_owned(),
        objects: samples.objects().len(),
        over_models: (summaries.len() > 1).then(|| SeedSummary::new(&summaries)),
        differences,
        warnings: warnings(models, samples, training, dataset_sha256),
        models: evaluated,
    })
}

/// What may make figures better than they are.
fn warnings(
    models: &[(String, Model)],
    samples: &Samples,
    training: Option<&Samples>,
    dataset_sha256: &str,
) -> Vec<String> {
    let mut found = Vec::new();
    if samples.by_label().contains(&0) {
        found.push("all samples have the same label: most figures are undefined".to_owned());
    }
    for (file, model) in models {
        let Origin::Trained {
            manifest_sha256, ..
        } = &model.contract().origin
        else {
            continue;
        };
        let is_same = manifest_sha256 == dataset_sha256;
        if is_same && matches!(samples.split(), "train" | "validation") {
            found.push(format!(
                "{file} was made with the part `{}` of this dataset: its figures here say nothing \
                 about other objects",
                samples.split()
            ));
        }
        let shared = training.map_or(0, |training| {
            let ours = samples.objects();
            training.objects().intersection(&ours).count()
        });
        if is_same && shared > 0 && samples.split() != "train" {
            found.push(format!(
                "{file} was trained on {shared} objects of this part"
            ));
        }
        if !is_same {
            let names = model.contract().other.get(OBJECTS);
            let seen: BTreeSet<String> = names
                .and_then(|names| serde_json::from_str(names).ok())
                .unwrap_or_default();
            let ours = samples.objects().into_iter();
            let shared = ours.filter(|object| seen.contains(*object)).count();
            if shared > 0 {
                found.push(format!(
                    "{file} was trained on another dataset, with {shared} objects of the same name; \
                     if they are the same objects, its figures are too good"
                ));
            }
        }
    }
    found
}

/// A prediction before it is counted.
struct Found {
    p_stable: f64,
    in_contact: bool,
}

fn predictions(
    model: &Model,
    samples: &Samples,
    on_progress: &(dyn Fn(usize) + Sync),
) -> Result<Vec<Found>> {
    let mut reader = SampleReader::new(samples, MEMORY);
    let all: Vec<usize> = (0..samples.facts().len()).collect();
    let mut found = Vec::with_capacity(all.len());
    for some in all.chunks(CHUNK) {
        let rows = reader.rows(some)?;
        let of_chunk: Vec<Found> = rows
            .par_iter()
            .map_init(
                || None,
                |kept: &mut Option<(Decoder, ModelInput)>, (rows, row)| {
                    let (decoder, input) = match kept {
                        Some(kept) => kept,
                        none => {
                            none.insert((Decoder::new()?, ModelInput::zeros(model.contract())?))
                        }
                    };
                    let row = &rows[*row];
                    let images = SampleImages::decode(decoder, &row.images, [true, true])
                        .map_err(|e| e.at(&row.facts.id))?;
                    let in_contact = show(&images, input)?;
                    let p_stable = model.predict(input)?.p_stable;
                    Ok(Found {
                        p_stable,
                        in_contact,
                    })
                },
            )
            .collect::<Result<_>>()?;
        found.extend(of_chunk);
        on_progress(found.len());
    }
    Ok(found)
}

/// Shows the images to a model; whether both tactile ones show a contact.
fn show(images: &SampleImages, input: &mut ModelInput) -> Result<bool> {
    let mut in_contact = true;
    let names = [InputName::TactileLeft, InputName::TactileRight];
    for (name, [initial, grasp]) in names.into_iter().zip(&images.tactile) {
        let difference = TactileDifference::between(initial, grasp)?;
        let pixels = difference.levels().as_chunks::<3>().0;
        let is_touched = |pixel: &&[i16; 3]| pixel.iter().any(|x| x.abs() > TOUCHED_LEVELS);
        let touched = pixels.iter().filter(is_touched).count();
        in_contact &= touched as f64 >= TOUCHED_FRACTION * pixels.len() as f64;
        input.set_tactile(name, &difference)?;
    }
    input.set_rgb(&images.rgb)?;
    Ok(in_contact)
}

impl ModelEvaluation {
    fn new(file: &str, model: &Model, samples: &Samples, found: Vec<Found>) -> Self {
        let threshold = model.contract().threshold;
        let facts = samples.facts();
        let scored: Vec<Scored> = found
            .iter()
            .zip(facts)
            .map(|(found, facts)| Scored {
                p_stable: found.p_stable,
                stable: facts.is_stable,
            })
            .collect();
        let touched = scored.iter().zip(&found);
        let touched: Vec<Scored> = touched
            .filter(|(_, found)| found.in_contact)
            .map(|(scored, _)| *scored)
            .collect();
        let by = |name: &dyn Fn(&SampleFacts) -> String| {
            let (names, groups) = numbered(facts, name);
            summarise_groups(&scored, &groups, &names, threshold)
        };
        let (_, objects) = numbered(facts, |facts| facts.object.clone());
        let (_, lifts) = numbered(facts, |facts| facts.lift.clone());
        let figures = Figures::new(&scored, threshold);
        let bootstrap = Bootstrap::new(SEED);
        Self {
            name: model.contract().name.clone(),
            file: file.to_owned(),
            sha256: model.sha256().to_owned(),
            variant: model.contract().modality,
            summary: Summary::new(&scored, threshold),
            auroc: bootstrap.interval(&objects, |times| figures.auroc(times)),
            balanced_accuracy: bootstrap
                .interval(&objects, |times| figures.balanced_accuracy(times)),
            in_contact: Summary::new(&touched, threshold),
            reliability: ReliabilityTable::new(&scored),
            ece_by_chance: ChanceCalibration::new(&scored, &lifts, SEED),
            at_base_rate: BaseRateCalibration::new(&scored),
            categories: by(&|facts| facts.category.clone()),
            per_object: by(&|facts| facts.object.clone()),
            forces: by(&|facts| match facts.stop_force_n {
                Some(force_n) => format!("{force_n:>4} N"),
                None => "unknown".to_owned(),
            }),
            mistakes: mistakes(&scored, samples, threshold),
            predictions: found
                .iter()
                .zip(facts)
                .map(|(found, facts)| ScoredSample {
                    id: facts.id.clone(),
                    object: facts.object.clone(),
                    p_stable: found.p_stable,
                    stable: facts.is_stable,
                    in_contact: found.in_contact,
                })
                .collect(),
        }
    }

    fn scored(&self) -> Vec<Scored> {
        let scored = self.predictions.iter().map(|sample| Scored {
            p_stable: sample.p_stable,
            stable: sample.stable,
        });
        scored.collect()
    }
}

impl Difference {
    fn between(first: &ModelEvaluation, second: &ModelEvaluation) -> Self {
        let [one, other] = [first, second].map(|e| Resampled::new(std::slice::from_ref(e)));
        let [auroc, balanced_accuracy] = one.better_than(&other);
        let names = |e: &ModelEvaluation| format!("{} ({})", e.name, e.file);
        Self {
            first: names(first),
            second: names(second),
            auroc,
            balanced_accuracy,
        }
    }
}

/// Figures of models on resamples of the same samples, for intervals over objects.
pub(super) struct Resampled {
    objects: Vec<usize>,
    models: Vec<Figures>,
}

impl Resampled {
    pub(super) fn new(models: &[ModelEvaluation]) -> Self {
        let mut numbers: BTreeMap<&str, usize> = BTreeMap::new();
        let first = models.first().map_or(&[][..], |e| &e.predictions);
        let objects = first.iter().map(|sample| {
            let next = numbers.len();
            *numbers.entry(&sample.object).or_insert(next)
        });
        Self {
            objects: objects.collect(),
            models: models
                .iter()
                .map(|e| Figures::new(&e.scored(), e.summary.threshold))
                .collect(),
        }
    }

    fn mean(&self, of: impl Fn(&Figures) -> Option<f64>) -> Option<f64> {
        let values: Option<Vec<f64>> = self.models.iter().map(of).collect();
        let values = values.filter(|values| !values.is_empty())?;
        Some(values.iter().sum::<f64>() / values.len() as f64)
    }

    fn auroc(&self, times: &[u32]) -> Option<f64> {
        self.mean(|figures| figures.auroc(times))
    }

    fn balanced_accuracy(&self, times: &[u32]) -> Option<f64> {
        self.mean(|figures| figures.balanced_accuracy(times))
    }

    /// Intervals of the models' mean AUROC and balanced accuracy.
    pub(super) fn intervals(&self) -> [Option<Interval>; 2] {
        let bootstrap = Bootstrap::new(SEED);
        [
            bootstrap.interval(&self.objects, |times| self.auroc(times)),
            bootstrap.interval(&self.objects, |times| self.balanced_accuracy(times)),
        ]
    }

    /// Intervals of how much better these models are than others, by AUROC and balanced accuracy.
    pub(super) fn better_than(&self, other: &Self) -> [Option<Interval>; 2] {
        let bootstrap = Bootstrap::new(SEED);
        [
            bootstrap.paired_interval(
                &self.objects,
                |times| self.auroc(times),
                |times| other.auroc(times),
            ),
            bootstrap.paired_interval(
                &self.objects,
                |times| self.balanced_accuracy(times),
                |times| other.balanced_accuracy(times),
            ),
        ]
    }
}

/// Figures of resamples.
struct Figures {
    ranking: Ranking,
    /// 1 for right, 0 for wrong, no number for the other label: of lost and of stable grasps.
    right: [Vec<f64>; 2],
}

impl Figures {
    fn new(scored: &[Scored], threshold: f64) -> Self {
        let right = [false, true].map(|label| {
            let of = scored.iter().map(|sample| {
                let is_right = (sample.p_stable >= threshold) == sample.stable;
                if sample.stable == label {
                    f64::from(u8::from(is_right))
                } else {
                    f64::NAN
                }
            });
            of.collect()
        });
        Self {
            ranking: Ranking::new(scored),
            right,
        }
    }

    fn auroc(&self, times: &[u32]) -> Option<f64> {
        self.ranking.resampled_auroc(times)
    }

    fn balanced_accuracy(&self, times: &[u32]) -> Option<f64> {
        let [lost, stable] = &self.right;
        Some(0.5 * (resampled_mean(lost, times)? + resampled_mean(stable, times)?))
    }
}

/// All names, sorted, and the number of each sample's.
fn numbered(
    facts: &[SampleFacts],
    name: impl Fn(&SampleFacts) -> String,
) -> (Vec<String>, Vec<usize>) {
    let mut names: Vec<String> = facts.iter().map(&name).collect();
    names.sort_unstable();
    names.dedup();
    let number = |facts| names.binary_search(&name(facts)).unwrap_or(0);
    let numbers = facts.iter().map(number).collect();
    (names, numbers)
}

/// The most confident mistakes of each label, the worst first; one of each object at most.
fn mistakes(scored: &[Scored], samples: &Samples, threshold: f64) -> Vec<Mistake> {
    let mut found = Vec::new();
    for label in [true, false] {
        let mut wrong: Vec<usize> = (0..scored.len())
            .filter(|&at| scored[at].stable == label && (scored[at].p_stable >= threshold) != label)
            .collect();
        wrong.sort_by(|&a, &b| {
            let order = scored[a].p_stable.total_cmp(&scored[b].p_stable);
            if label { order } else { order.reverse() }
        });
        let mut objects = BTreeSet::new();
        wrong.retain(|&at| objects.insert(&samples.facts()[at].object));
        found.extend(wrong.into_iter().take(MISTAKES).map(|at| Mistake {
            sample: at,
            id: samples.facts()[at].id.clone(),
            object: samples.facts()[at].object.clone(),
            p_stable: scored[at].p_stable,
            stable: label,
        }));
    }
    found
}

/// The images of a sample for a report: left and right tactile change, brightened around grey,
/// and the colour image.
///
/// # Errors
/// Those of reading and decoding.
pub fn sample_images(samples: &Samples, sample: usize) -> Result<[image::RgbImage; 3]> {
    let rows = SampleReader::new(samples, 0).rows(&[sample])?;
    let Some((rows, row)) = rows.first() else {
        return Err(Error::internal("there is no such sample"));
    };
    let mut decoder = Decoder::new()?;
    let images = SampleImages::decode(&mut decoder, &rows[*row].images, [true, true])?;
    let [left, right] = &images.tactile;
    let change = |[initial, grasp]: &[image::RgbImage; 2]| {
        TactileDifference::between(initial, grasp).map(|change| change.to_image(2.0))
    };
    Ok([change(left)?, change(right)?, images.rgb])
}

#[cfg(test)]
#[path = "evaluate_test.rs"]
mod tests;
