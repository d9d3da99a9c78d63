//! Calibration of a run and export of its model.

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::comparison::Comparison;
use super::conformal::add_conformal_scores;
use super::grasp_head;
use super::lift;
use super::metrics::{Summary, even_odds_threshold, fit_temperature};
use super::ood::fit_tactile_reference;
use super::run_folder::{EpochMetrics, RunFile, RunFolder};
use super::samples::Samples;
use super::settings::SourceModel;
use super::start::StartModel;
use super::state::write;
use super::validate::{Logit, SplitLogits, logits};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::CropProfile;
use gripcast_nn::predict::contract::{InputName, InputSpec, Modality, Origin, OutputSpec};
use gripcast_nn::predict::grasp_head::METADATA as GRASP;
use gripcast_nn::predict::lift::METADATA as LIFT;
use gripcast_nn::predict::{BASE_RATE, GraspHead, ModelContract, ood};
use gripcast_nn::{Network, to_onnx};

/// Metadata key of the training objects.
pub(super) const OBJECTS: &str = "gripcast.train.objects";

/// Metadata key of the network architecture.
pub(super) const ARCHITECTURE: &str = "gripcast.arch";

/// Temperature and threshold are rounded to multiples of its inverse.
const ROUNDING: f64 = 1e4;

/// A calibrated model.
#[derive(Clone, Debug, PartialEq)]
pub struct Finished {
    /// Temperature of the logits.
    pub temperature: f64,
    /// Decision threshold.
    pub threshold: f64,
    /// Metrics on the validation split, on which both were fitted.
    pub validation: Summary,
    /// Comparison with the start model of fine-tuning.
    pub comparison: Option<Comparison>,
    /// Bytes of the model file.
    pub onnx: Vec<u8>,
}

/// Fits temperature and threshold on the validation split and the OOD reference on the training
/// split of the datasets `data`, and writes the run's `model.onnx`.
///
/// # Errors
/// `Busy`: another program trains the run. Errors of reading dataset and checkpoint and of writing
/// the file.
pub fn finish(
    folder: &RunFolder,
    file: &RunFile,
    data: &[PathBuf],
    name: &str,
    on_progress: &dyn Fn(usize),
) -> Result<Finished> {
    let _lock = folder.lock()?;
    let validation = Samples::open_all(data, "validation")?;
    let (network, best) = folder.best_network(&file.settings)?;
    let logits_of = |network: &Network, samples: &Samples| {
        let (settings, normalisation) = (&file.settings, file.normalisation());
        logits(network, samples, settings, normalisation, on_progress)
    };
    let mut logits = logits_of(&network, &validation)?;
    let known = start_of(folder, file)?;
    let outputs = network
        .heads()
        .map(|inputs| calibrated(inputs, &logits, known.as_ref()));
    let mut outputs: Vec<OutputSpec> = outputs.collect();
    let train = Samples::open_all(data, "train")?;
    let grasp_head = match &known {
        Some(start) => grasp_head::refit(start.grasp_head(), &outputs, &logits),
        None if file.settings.contact_epochs() > 0 => {
            let of_train = logits_of(&network, &train)?;
            grasp_head::fit(&outputs, &of_train, &logits, file.settings.seed)
        }
        None => GraspHead::default(),
    };
    logits.set_grasp_head(&grasp_head, &outputs);
    for output in &mut outputs {
        let logits = logits.of(output.modality);
        if grasp_head.of(output.modality).is_some() && !logits.is_empty() {
            output.threshold = threshold(logits, output.temperature);
        }
    }
    // The inputs that all samples have.
    let used = logits.complete();
    let used = used.and_then(|inputs| outputs.iter().find(|o| o.modality == inputs));
    let used = *used.ok_or_else(|| missing_inputs(&validation))?;
    let scored = logits.best().iter().map(|x| x.scored(used.temperature));
    let scored: Vec<_> = scored.collect();
    let summary = Summary::new(&scored, used.threshold);
    let mut contract = contract(file, name, &best, &outputs, &summary)?;
    if used.modality == contract.modality {
        add_conformal_scores(&mut contract, &validation, &scored);
    }
    let lift_head = lift::fit(
        &train,
        &validation,
        logits.best(),
        used.temperature,
        file.settings.seed,
    );
    // Few own lifts do not make a head of their own.
    let kept = known.as_ref().and_then(StartModel::lift_head);
    if let Some(head) = lift_head.as_ref().or(kept) {
        let metadata = head.to_metadata();
        contract.other.insert(LIFT.to_owned(), metadata);
    }
    if !grasp_head.estimators.is_empty() {
        let metadata = grasp_head.to_metadata();
        contract.other.insert(GRASP.to_owned(), metadata);
        contract.contact = vec![InputName::TactileLeft, InputName::TactileRight];
    }
    let start = known;
    let compared = |start: &StartModel| -> Result<Comparison> {
        let mut before = logits_of(start.network(), &validation)?;
        // The temperature of the file is in the weights of its network.
        let outputs = start.contract().outputs();
        let outputs = outputs.map(|output| OutputSpec {
            temperature: 1.0,
            ..output
        });
        before.set_grasp_head(start.grasp_head(), &outputs.collect::<Vec<_>>());
        Ok(Comparison::new(
            start,
            used.modality,
            before.of(used.modality),
            logits.best(),
            &validation,
        ))
    };
    let mut comparison = start.as_ref().map(compared).transpose()?;
    let known = start.as_ref().and_then(StartModel::ood_detector);
    let reference = fit_tactile_reference(&train, &validation, file, known)?;
    if let Some(reference) = &reference {
        let metadata = reference.to_metadata();
        contract.other.insert(ood::METADATA.to_owned(), metadata);
    }
    if let (Some(start), Some(comparison)) = (&start, &mut comparison) {
        let scored = reference.as_ref().zip(known);
        comparison.ood_score_of_start = scored.map(|(own, start)| own.score_of_mean(start));
        add_start(&mut contract, start, comparison);
    }
    let onnx = to_onnx(&network, &contract)?;
    write(&folder.model(), &onnx)?;
    Ok(Finished {
        temperature: used.temperature,
        threshold: used.threshold,
        validation: summary,
        comparison,
        onnx,
    })
}

/// Reads the start model of a fine-tuning run.
fn start_of(folder: &RunFolder, file: &RunFile) -> Result<Option<StartModel>> {
    let fine_tuning = file.settings.fine_tuning.as_ref();
    fine_tuning.map(|_| StartModel::of_run(folder)).transpose()
}

fn missing_inputs(samples: &Samples) -> Error {
    let what = "the samples lack inputs that the model needs";
    Error::input(what)
        .at(samples.location())
        .remedy("fine-tune a model of fewer inputs")
}

/// Calibrates the predictions from some inputs. Where a sample lacks them those of the start model
/// stay; its temperature is in its weights.
fn calibrated(inputs: Modality, logits: &SplitLogits, start: Option<&StartModel>) -> OutputSpec {
    let logits = logits.of(inputs);
    let of_start = start.and_then(|start| {
        let mut outputs = start.contract().outputs();
        outputs.find(|output| output.modality == inputs)
    });
    let (temperature, threshold) = match of_start {
        Some(output) if logits.is_empty() => (1.0, output.threshold),
        _ => calibrate(logits),
    };
    OutputSpec {
        modality: inputs,
        threshold,
        temperature,
    }
}

/// Fits temperature and threshold, rounded as they are written.
pub(super) fn calibrate(logits: &[Logit]) -> (f64, f64) {
    let (values, stable): (Vec<f64>, Vec<bool>) =
        logits.iter().map(|x| (x.logit, x.is_stable)).unzip();
    let temperature = fit_temperature(&values, &stable).map_or(1.0, |fit| fit.temperature);
    let temperature = rounded(temperature);
    (temperature, threshold(logits, temperature))
}

/// Threshold of logits at a temperature, rounded as it is written.
fn threshold(logits: &[Logit], temperature: f64) -> f64 {
    let scored: Vec<_> = logits.iter().map(|x| x.scored(temperature)).collect();
    let threshold = rounded(even_odds_threshold(&scored).unwrap_or(0.5));
    threshold.clamp(1.0 / ROUNDING, 1.0 - 1.0 / ROUNDING)
}

fn rounded(x: f64) -> f64 {
    (x * ROUNDING).round() / ROUNDING
}

fn contract(
    file: &RunFile,
    name: &str,
    best: &EpochMetrics,
    outputs: &[OutputSpec],
    validation: &Summary,
) -> Result<ModelContract> {
    let settings = &file.settings;
    let inputs = settings.modality.inputs().into_iter();
    let cameras = inputs.clone().filter(|input| {
        settings.architecture.geometry && matches!(input, InputName::Rgb | InputName::Depth)
    });
    let inputs = inputs.map(|input| match input {
        InputName::Rgb => InputSpec::rgb(file.normalisation()),
        InputName::Depth => InputSpec::depth(),
        touch => InputSpec::tactile(touch),
    });
    let (all, fallbacks) = outputs
        .split_first()
        .ok_or_else(|| Error::internal("the network has no output"))?;
    let text = |value: Option<f64>| value.map_or("none".to_owned(), |x| format!("{x:.4}"));
    let mut other = BTreeMap::from(
        [
            ("gripcast.licence", "MIT OR Apache-2.0".to_owned()),
            (ARCHITECTURE, settings.architecture.name.clone()),
            ("gripcast.software", file.software.clone()),
            ("gripcast.epoch", best.epoch.to_string()),
            // Both labels have equal weight.
            (BASE_RATE, "0.5".to_owned()),
            (
                OBJECTS,
                serde_json::to_string(&file.objects).unwrap_or_default(),
            ),
            ("gripcast.val.n", validation.n.to_string()),
            ("gripcast.val.accuracy", text(validation.accuracy)),
            (
                "gripcast.val.balanced_accuracy",
                text(validation.balanced_accuracy),
            ),
            ("gripcast.val.auroc", text(validation.auroc)),
            ("gripcast.val.ece", text(validation.ece)),
            (
                "gripcast.val.geometry_error_m",
                text(best.validation_geometry_error_m),
            ),
        ]
        .map(|(key, value)| (key.to_owned(), value)),
    );
    if let Some(SourceModel { name, sha256 }) = &settings.cameras {
        other.insert("gripcast.cameras.name".to_owned(), name.clone());
        other.insert("gripcast.cameras.sha256".to_owned(), sha256.clone());
    }
    Ok(ModelContract {
        name: name.to_owned(),
        origin: Origin::Trained {
            seed: settings.seed,
            manifest_sha256: file.dataset_sha256.clone(),
        },
        modality: settings.modality,
        inputs: inputs.collect(),
        threshold: all.threshold,
        temperature: all.temperature,
        fallbacks: fallbacks.to_vec(),
        geometry: cameras.collect(),
        contact: Vec::new(),
        crop_profile: Some(CropProfile::by_name(&file.crop_profile)?),
        card: card(file, best, validation),
        other,
    })
}

/// Adds the start model of fine-tuning to the metadata and the card.
fn add_start(contract: &mut ModelContract, start: &StartModel, comparison: &Comparison) {
    let mut objects = start.objects();
    let own = contract
        .other
        .get(OBJECTS)
        .map(|names| serde_json::from_str(names));
    objects.extend(
        own.and_then(Result::<Vec<String>, _>::ok)
            .unwrap_or_default(),
    );
    let mut add = |key: &str, value: String| contract.other.insert(key.to_owned(), value);
    add(OBJECTS, serde_json::to_string(&objects).unwrap_or_default());
    add("gripcast.start.name", comparison.start.clone());
    add("gripcast.start.sha256", comparison.start_sha256.clone());
    let ood = comparison.ood_score_of_start.map(|score| {
        format!(" The mean of the start model's tactile images has OOD score {score:.2}.")
    });
    contract.card = format!(
        "{}- Start: fine-tuned from `{}` (sha256 {}): {}.{}\n",
        contract.card,
        comparison.start,
        comparison.start_sha256,
        comparison.advice,
        ood.unwrap_or_default()
    );
}

fn card(file: &RunFile, best: &EpochMetrics, validation: &Summary) -> String {
    let figure = |value: Option<f64>| value.map_or("–".to_owned(), |x| format!("{x:.3}"));
    let [trained, also, limits] = if file.settings.fine_tuning.is_some() {
        [
            "Fine-tuned on labelled grasps",
            "",
            "it was measured on this validation split alone",
        ]
    } else {
        [
            "Trained on simulated grasps with known outcomes",
            ", also simulated",
            "it has never been measured on the outcomes of real lifts",
        ]
    };
    let cameras = file.settings.cameras.as_ref();
    let cameras = cameras.map(|SourceModel { name, sha256 }| {
        format!("- Encoders of camera images: those of `{name}` (sha256 {sha256}).\n")
    });
    format!(
        "# Grasp stability from {modality}\n\n\
         Probability that a grasp holds when it is lifted, from images taken before the lift. \
         {trained}.\n\n\
         - Data: dataset {dataset}, seed {seed}, {arch} network, epoch {epoch}.\n\
         {cameras}\
         - Validation split (other objects{also}; checkpoint, temperature and threshold \
         were chosen on it): n = {n}, accuracy {accuracy}, AUROC {auroc}, ECE {ece}.\n\
         - Limits: {limits}. It knows neither mass \
         nor friction but from what images show of them.\n\
         - Licence: MIT OR Apache-2.0.\n",
        cameras = cameras.unwrap_or_default(),
        modality = file.settings.modality.words(),
        dataset = file.dataset_sha256,
        seed = file.settings.seed,
        arch = file.settings.architecture.name,
        epoch = best.epoch,
        n = validation.n,
        accuracy = figure(validation.accuracy),
        auroc = figure(validation.auroc),
        ece = figure(validation.ece),
    )
}
