//! Evaluation of model files on a labelled split.

use std::collections::BTreeSet;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::augment::SampleImages;
use super::conformal::{ConformalEvaluation, trained_objects};
use super::duplicates::duplicates;
use super::finish::ARCHITECTURE;
use super::lift::LiftEvaluation;
use super::metrics::{
    BaseRateCalibration, Bootstrap, ChanceCalibration, GroupSummary, Interval, ReliabilityTable,
    Scored, Summary, summarise_groups,
};
use super::resampled::{Resampled, ResampledMetrics, SeedResult};
use super::samples::{SampleFacts, SampleReader, Samples};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{Decoder, TactileDifference};
use gripcast_nn::predict::contract::{InputName, Modality, Origin, OutputSpec};
use gripcast_nn::predict::{LiftHead, Model, ModelInput};

/// Samples read together.
const CHUNK: usize = 64;
/// Cached bytes of encoded images.
const MEMORY: usize = 1 << 25;
/// Change of a pixel's strongest channel that counts as contact, grey levels.
const CONTACT_LEVELS: i16 = 25;
/// Minimum fraction of such pixels in an image in contact.
const MIN_CONTACT_FRACTION: f64 = 0.004;
/// Maximum number of reported mistakes per label.
const MAX_MISTAKES: usize = 12;
/// Seed of the bootstrap.
pub(super) const SEED: u64 = 0;

/// Evaluation of models on a split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvalReport {
    /// `gripcast-eval`.
    pub format: String,
    /// Version of the format.
    pub version: u32,
    /// Version of gripcast.
    pub software: String,
    /// Folder of the dataset.
    pub dataset: String,
    /// SHA-256 of its files, see [`dataset_sha256`](super::dataset_sha256).
    pub dataset_sha256: String,
    /// Split.
    pub split: String,
    /// Number of objects.
    pub objects: usize,
    /// The models, in the given order.
    pub models: Vec<ModelEvaluation>,
    /// Means over several models that differ in their seed alone, by inputs; of one model the same
    /// figures.
    pub over_models: Vec<SeedResult>,
    /// Differences of the first entry of `models` to the others.
    pub differences: Vec<Difference>,
    /// Possible causes of biased metrics.
    pub warnings: Vec<String>,
}

/// Metrics of a model's predictions from some of its inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelEvaluation {
    /// Model name.
    pub name: String,
    /// Model file.
    pub file: String,
    /// SHA-256 of the file.
    pub sha256: String,
    /// The inputs.
    pub modality: Modality,
    /// Metrics of all samples at the model's threshold.
    pub summary: Summary,
    /// AUROC with its 95 % interval over objects.
    pub auroc: Option<Interval>,
    /// Balanced accuracy with its 95 % interval over objects.
    pub balanced_accuracy: Option<Interval>,
    /// Metrics of the samples in which both tactile images show contact.
    pub in_contact: Summary,
    /// Reliability diagram, 15 bins.
    pub reliability: ReliabilityTable,
    /// ECE that a perfectly calibrated model would show on so few grasps.
    pub ece_by_chance: Option<ChanceCalibration>,
    /// Calibration after correction for the base rate of these grasps.
    #[serde(default)]
    pub at_base_rate: Option<BaseRateCalibration>,
    /// Prediction sets at an error rate, where the model has conformal scores.
    #[serde(default)]
    pub conformal: Option<ConformalEvaluation>,
    /// Metrics by category.
    pub categories: Vec<GroupSummary>,
    /// Metrics by object.
    pub per_object: Vec<GroupSummary>,
    /// Metrics by stopping force, N.
    pub forces: Vec<GroupSummary>,
    /// Verdict in the lift that follows from this prediction.
    #[serde(default)]
    pub lift: Option<LiftEvaluation>,
    /// The same without the motion of the object, where it was used.
    #[serde(default)]
    pub lift_from_gels: Option<LiftEvaluation>,
    /// The most confident mistakes: stable grasps, then slips.
    pub mistakes: Vec<Mistake>,
    /// All predictions.
    pub predictions: Vec<ScoredSample>,
}

/// A prediction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScoredSample {
    /// Sample id.
    pub id: String,
    /// Object name.
    pub object: String,
    /// Predicted probability of stable.
    pub p_stable: f64,
    /// Label.
    pub stable: bool,
    /// Whether both tactile images show contact.
    pub in_contact: bool,
}

/// A confident mistake.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mistake {
    /// Index of the sample in its split.
    pub sample: usize,
    /// Sample id.
    pub id: String,
    /// Object name.
    pub object: String,
    /// Predicted probability of stable.
    pub p_stable: f64,
    /// Label.
    pub stable: bool,
}

/// Paired difference of two models on the same samples, first minus second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// First model.
    pub first: String,
    /// Second model.
    pub second: String,
    /// Difference in AUROC.
    pub auroc: Option<Interval>,
    /// Difference in balanced accuracy.
    pub balanced_accuracy: Option<Interval>,
}

/// Evaluates models on a split. `training` is the training split of the same dataset, if any.
///
/// # Errors
/// `Input`: a model with another crop profile, or damaged images. Errors of reading the dataset.
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
    let mut warnings = warnings(models, samples, training, dataset_sha256);
    let training_split = training.filter(|training| training.split() != samples.split());
    let splits: Vec<&Samples> = training_split.into_iter().chain([samples]).collect();
    warnings.extend(duplicates(&splits)?);
    let available = samples.modality()?;
    let mut outputs = Vec::new();
    for (file, model) in models {
        let contract = model.contract();
        let before = outputs.len();
        let usable = contract
            .outputs()
            .filter(|o| available.includes(o.modality));
        outputs.extend(usable.map(|output| (file, model, output)));
        if outputs.len() == before {
            let what = format!("the model needs {}", contract.modality.words());
            return Err(
                Error::input(format!("{what}, the dataset has {}", available.words()))
                    .at(file)
                    .remedy("evaluate it on a dataset with depth images"),
            );
        }
        if !available.includes(contract.modality) {
            warnings.push(format!(
                "{file} also uses {}, which the dataset lacks: its predictions from fewer inputs \
                 are evaluated",
                contract.modality.words()
            ));
        }
    }
    let total = outputs.len() * samples.facts().len();
    let mut evaluated = Vec::new();
    for (i, (file, model, output)) in outputs.into_iter().enumerate() {
        let before = i * samples.facts().len();
        let on_progress = |done| on_progress(before + done, total);
        let predictions = predict(model, output.modality, samples, &on_progress)?;
        evaluated.push(ModelEvaluation::new(
            file,
            model,
            output,
            samples,
            predictions,
        ));
    }
    let differences = evaluated.iter().skip(1);
    let differences = differences
        .map(|other| Difference::between(&evaluated[0], other))
        .collect();
    Ok(EvalReport {
        format: "gripcast-eval".to_owned(),
        version: 2,
        software: concat!("gripcast ", env!("CARGO_PKG_VERSION")).to_owned(),
        dataset: samples.location().to_owned(),
        dataset_sha256: dataset_sha256.to_owned(),
        split: samples.split().to_owned(),
        objects: samples.objects().len(),
        over_models: match are_alike(models) {
            true => SeedResult::all(&evaluated),
            false => Vec::new(),
        },
        differences,
        warnings,
        models: evaluated,
    })
}

impl EvalReport {
    /// Evaluates the prediction sets of the models at an error rate. Models without conformal
    /// scores are refused if `is_required`, else omitted. `models` and `samples` are those of
    /// [`evaluate`].
    ///
    /// # Errors
    /// `Input` for a model without scores.
    pub fn add_sets(
        &mut self,
        models: &[(String, Model)],
        samples: &Samples,
        error_rate: f64,
        is_required: bool,
    ) -> Result<()> {
        for (file, model) in models {
            // The scores are those of the prediction from all inputs.
            let all = model.contract().modality;
            let mut evaluated = self.models.iter_mut();
            let evaluated = evaluated.find(|e| e.file == *file && e.modality == all);
            let Some(evaluated) = evaluated else { continue };
            if model.conformal_scores().is_some() || is_required {
                let scored = evaluated.scored();
                let sets = ConformalEvaluation::new(model, error_rate, samples.facts(), &scored);
                evaluated.conformal = Some(sets.map_err(|e| e.at(file))?);
            }
        }
        Ok(())
    }
}

/// Whether the models are several seeds of one training; a mean over others has no meaning.
fn are_alike(models: &[(String, Model)]) -> bool {
    let mut seeds = BTreeSet::new();
    let mut trainings = BTreeSet::new();
    let all_trained = models.iter().all(|(_, model)| {
        let contract = model.contract();
        let Origin::Trained {
            seed,
            manifest_sha256,
        } = &contract.origin
        else {
            return false;
        };
        trainings.insert((
            manifest_sha256,
            contract.modality.name(),
            contract.crop_profile_name(),
            contract.other.get(ARCHITECTURE),
        ));
        seeds.insert(seed)
    });
    all_trained && trainings.len() == 1 && seeds.len() == models.len()
}

/// Lists possible causes of biased metrics.
fn warnings(
    models: &[(String, Model)],
    samples: &Samples,
    training: Option<&Samples>,
    dataset_sha256: &str,
) -> Vec<String> {
    let mut warnings = Vec::new();
    if samples.by_label().contains(&0) {
        warnings.push("all samples have the same label: most metrics are undefined".to_owned());
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
            warnings.push(format!(
                "{file} was trained or tuned on the split `{}` of this dataset: its metrics do not \
                 hold for other objects",
                samples.split()
            ));
        }
        let shared = training.map_or(0, |training| {
            let ours = samples.objects();
            training.objects().intersection(&ours).count()
        });
        if is_same && shared > 0 && samples.split() != "train" {
            warnings.push(format!(
                "{file} was trained on {shared} objects of this split"
            ));
        }
        if !is_same {
            let trained = trained_objects(model.contract());
            let shared = samples.count_named(&trained);
            if shared > 0 {
                warnings.push(format!(
                    "{file} was trained on another dataset with {shared} objects of the same name; \
                     if they are the same objects, its metrics are biased"
                ));
            }
        }
    }
    warnings
}

/// Predicts all samples from some inputs; returns the probability of stable and whether the sample
/// is in contact.
pub(super) fn predict(
    model: &Model,
    inputs: Modality,
    samples: &Samples,
    on_progress: &(dyn Fn(usize) + Sync),
) -> Result<Vec<(f64, bool)>> {
    let mut reader = SampleReader::new(samples, MEMORY);
    let all: Vec<usize> = (0..samples.facts().len()).collect();
    let mut predictions = Vec::with_capacity(all.len());
    for indices in all.chunks(CHUNK) {
        let rows = reader.rows(indices)?;
        let chunk: Vec<(f64, bool)> = rows
            .par_iter()
            .map_init(
                || None,
                |buffers: &mut Option<(Decoder, ModelInput)>, (rows, row)| {
                    let (decoder, input) = match buffers {
                        Some(buffers) => buffers,
                        none => none.insert((Decoder::new()?, ModelInput::new(model.contract())?)),
                    };
                    let row = &rows[*row];
                    let used = Modality::of(|name| name.role().is_tactile() || inputs.has(name));
                    let images = SampleImages::decode(decoder, &row.images, used.unwrap_or(inputs))
                        .map_err(|e| e.at(&row.facts.id))?;
                    let in_contact = set_input(&images, inputs, input)?;
                    let prediction = model.predict(input)?;
                    if prediction.modality != inputs {
                        return Err(lacks_input(inputs, prediction.modality).at(&row.facts.id));
                    }
                    Ok((prediction.p_stable, in_contact))
                },
            )
            .collect::<Result<_>>()?;
        predictions.extend(chunk);
        on_progress(predictions.len());
    }
    Ok(predictions)
}

fn lacks_input(expected: Modality, found: Modality) -> Error {
    Error::input(format!(
        "expected {} as in the first sample of the split, found {}",
        expected.words(),
        found.words()
    ))
    .remedy("evaluate samples with and without depth images as separate splits")
}

/// Sets some inputs of a model; returns whether both tactile images show contact.
fn set_input(images: &SampleImages, inputs: Modality, input: &mut ModelInput) -> Result<bool> {
    let mut in_contact = true;
    input.clear();
    let names = [InputName::TactileLeft, InputName::TactileRight];
    for (name, [initial, grasp]) in names.into_iter().zip(&images.tactile) {
        let difference = TactileDifference::between(initial, grasp)?;
        let pixels = difference.levels().as_chunks::<3>().0;
        let is_contact = |pixel: &&[i16; 3]| pixel.iter().any(|x| x.abs() > CONTACT_LEVELS);
        let contact = pixels.iter().filter(is_contact).count();
        in_contact &= contact as f64 >= MIN_CONTACT_FRACTION * pixels.len() as f64;
        if inputs.has_touch() {
            input.set_tactile(name, &difference)?;
        }
    }
    if inputs.has_vision() {
        input.set_rgb(&images.rgb)?;
    }
    if let (true, Some(points)) = (inputs.has_depth(), &images.depth) {
        input.set_depth(points)?;
    }
    Ok(in_contact)
}

impl ModelEvaluation {
    fn new(
        file: &str,
        model: &Model,
        output: OutputSpec,
        samples: &Samples,
        predictions: Vec<(f64, bool)>,
    ) -> Self {
        let threshold = output.threshold;
        let facts = samples.facts();
        let scored = predictions.iter().zip(facts);
        let scored: Vec<Scored> = scored
            .map(|(&(p_stable, _), facts)| Scored {
                p_stable,
                stable: facts.is_stable,
            })
            .collect();
        let in_contact = scored.iter().zip(&predictions);
        let in_contact: Vec<Scored> = in_contact
            .filter(|(_, (_, in_contact))| *in_contact)
            .map(|(scored, _)| *scored)
            .collect();
        let by = |name: &dyn Fn(&SampleFacts) -> String| {
            let (names, groups) = grouped(facts, name);
            summarise_groups(&scored, &groups, &names, threshold)
        };
        let (_, objects) = grouped(facts, |facts| facts.object.clone());
        let (_, lifts) = grouped(facts, |facts| facts.lift.clone());
        let metrics = ResampledMetrics::new(&scored, threshold);
        let p_before: Vec<f64> = scored.iter().map(|sample| sample.p_stable).collect();
        let head = model.lift_head();
        // Fitted to the prediction from all inputs.
        let head = head.filter(|_| output.modality == model.contract().modality);
        let lift = head.and_then(|head| LiftEvaluation::new(head, samples, &p_before));
        let uses_object = lift.as_ref().is_some_and(|lift| lift.with_object > 0.0);
        let from_gels = head.filter(|_| uses_object).map(|head| LiftHead {
            with_object: None,
            ..head.clone()
        });
        let bootstrap = Bootstrap::new(SEED);
        Self {
            name: model.contract().name.clone(),
            file: file.to_owned(),
            sha256: model.sha256().to_owned(),
            modality: output.modality,
            summary: Summary::new(&scored, threshold),
            auroc: bootstrap.interval(&objects, |times| metrics.auroc(times)),
            balanced_accuracy: bootstrap
                .interval(&objects, |times| metrics.balanced_accuracy(times)),
            in_contact: Summary::new(&in_contact, threshold),
            reliability: ReliabilityTable::new(&scored),
            ece_by_chance: ChanceCalibration::new(&scored, &lifts, SEED),
            at_base_rate: BaseRateCalibration::new(&scored),
            conformal: None,
            categories: by(&|facts| facts.category.clone()),
            per_object: by(&|facts| facts.object.clone()),
            forces: by(&|facts| match facts.stop_force_n {
                Some(force_n) => format!("{force_n:>4} N"),
                None => "unknown".to_owned(),
            }),
            lift,
            lift_from_gels: from_gels
                .and_then(|head| LiftEvaluation::new(&head, samples, &p_before)),
            mistakes: mistakes(&scored, samples, threshold),
            predictions: predictions
                .into_iter()
                .zip(facts)
                .map(|((p_stable, in_contact), facts)| ScoredSample {
                    id: facts.id.clone(),
                    object: facts.object.clone(),
                    p_stable,
                    stable: facts.is_stable,
                    in_contact,
                })
                .collect(),
        }
    }

    pub(super) fn scored(&self) -> Vec<Scored> {
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
        let [auroc, balanced_accuracy] = one.minus(&other);
        let names = |e: &ModelEvaluation| format!("{} {} ({})", e.name, e.modality, e.file);
        Self {
            first: names(first),
            second: names(second),
            auroc,
            balanced_accuracy,
        }
    }
}

/// Returns the sorted group names and the group index of each sample.
pub(super) fn grouped(
    facts: &[SampleFacts],
    name: impl Fn(&SampleFacts) -> String,
) -> (Vec<String>, Vec<usize>) {
    let mut names: Vec<String> = facts.iter().map(&name).collect();
    names.sort_unstable();
    names.dedup();
    let group = |facts| names.binary_search(&name(facts)).unwrap_or(0);
    let groups = facts.iter().map(group).collect();
    (names, groups)
}

/// Returns the most confident mistakes of each label, the worst first; at most one per object.
fn mistakes(scored: &[Scored], samples: &Samples, threshold: f64) -> Vec<Mistake> {
    let mut mistakes = Vec::new();
    for label in [true, false] {
        let mut incorrect: Vec<usize> = (0..scored.len())
            .filter(|&i| scored[i].stable == label && (scored[i].p_stable >= threshold) != label)
            .collect();
        incorrect.sort_by(|&a, &b| {
            let order = scored[a].p_stable.total_cmp(&scored[b].p_stable);
            if label { order } else { order.reverse() }
        });
        let mut objects = BTreeSet::new();
        incorrect.retain(|&i| objects.insert(&samples.facts()[i].object));
        mistakes.extend(incorrect.into_iter().take(MAX_MISTAKES).map(|i| Mistake {
            sample: i,
            id: samples.facts()[i].id.clone(),
            object: samples.facts()[i].object.clone(),
            p_stable: scored[i].p_stable,
            stable: label,
        }));
    }
    mistakes
}

/// Returns the images of a sample for a report: left and right tactile difference, amplified
/// around grey, and the colour image.
///
/// # Errors
/// Errors of reading and decoding.
pub fn sample_images(samples: &Samples, sample: usize) -> Result<[image::RgbImage; 3]> {
    let rows = SampleReader::new(samples, 0).rows(&[sample])?;
    let Some((rows, row)) = rows.first() else {
        return Err(Error::internal("sample not found"));
    };
    let mut decoder = Decoder::new()?;
    let images = SampleImages::decode(&mut decoder, &rows[*row].images, Modality::Vt)?;
    let [left, right] = &images.tactile;
    let difference = |[initial, grasp]: &[image::RgbImage; 2]| {
        TactileDifference::between(initial, grasp).map(|difference| difference.to_image(2.0))
    };
    Ok([difference(left)?, difference(right)?, images.rgb])
}

#[cfg(test)]
#[path = "evaluate_test.rs"]
mod tests;
