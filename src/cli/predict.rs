//! `gripcast predict`: check a model, or predict the stability of one grasp from images.
//!
//! `predict check MODEL` loads an ONNX file as `collect` does, runs it once and prints its
//! contract. `predict images` predicts one grasp from image files (PNG or JPEG): both tactile
//! images of the open and of the closed gripper, and the colour image if the model uses it.
//! Tactile images are cropped with the model's crop profile unless `--already-cropped`; all are
//! resized to 320×240. `predict stamp FILE` writes the contract into an ONNX file of another
//! program. `predict conformal MODEL` adds scores for prediction sets. `predict baseline` writes the built-in contact-strength heuristic as an
//! ONNX file.
//!
//! Exit codes: 0 predicted · 1 invalid model or image · 2 usage.

use std::path::{Path, PathBuf};

use image::RgbImage;
use serde_json::{Value, json};

use super::flags::{ERROR_RATE, above_zero, depth_view, number};
use super::predict_conformal::{self, ConformalArgs};
use super::predict_stamp::{self, StampArgs};
use super::{Context, print_report};
use crate::note;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_regular, save};
use gripcast_imaging::{CropProfile, Decoder, Depth, DepthView, decode_png_grey16};
use gripcast_nn::predict::contract::{IMAGE_HEIGHT, IMAGE_WIDTH, InputName, Modality, Origin};
use gripcast_nn::predict::{
    GraspPrediction, InputImages, Model, ModelContract, PredictedLabel, SHIPPED, baseline,
};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Check a model against its contract
    Check(CheckArgs),
    /// Predict one grasp from image files
    Images(ImagesArgs),
    /// Write the contract into an ONNX file of another program
    Stamp(StampArgs),
    /// Write a model with the conformal scores of labelled grasps, for sets at an error rate
    Conformal(ConformalArgs),
    /// Write the built-in contact-strength heuristic as an ONNX file
    #[command(hide = true)]
    Baseline(BaselineArgs),
}

#[derive(Debug, clap::Args)]
struct CheckArgs {
    /// ONNX file, gripcast-vt (built-in classifier) or baseline-contact (built-in heuristic)
    #[arg(value_name = "MODEL")]
    model: String,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct ImagesArgs {
    /// Left tactile image, gripper open
    #[arg(long, value_name = "FILE")]
    initial_left: Option<PathBuf>,
    /// Right tactile image, gripper open
    #[arg(long, value_name = "FILE")]
    initial_right: Option<PathBuf>,
    /// Left tactile image, gripper closed
    #[arg(long, value_name = "FILE")]
    grasp_left: Option<PathBuf>,
    /// Right tactile image, gripper closed
    #[arg(long, value_name = "FILE")]
    grasp_right: Option<PathBuf>,
    /// Colour image, gripper closed
    #[arg(long, value_name = "FILE")]
    rgb: Option<PathBuf>,
    /// Depth image, 16-bit PNG, gripper closed
    #[arg(long, value_name = "FILE")]
    depth: Option<PathBuf>,
    /// Depth of one count of the depth image, m
    #[arg(long, value_name = "M", default_value_t = 1e-3, value_parser = above_zero)]
    depth_unit_m: f64,
    /// View of the depth image
    #[arg(long, value_name = "VIEW", default_value = DepthView::Colour.name(),
        value_parser = depth_view())]
    depth_view: DepthView,
    /// Crop profile of the tactile images [default: the model's]
    #[arg(long, value_name = "PROFILE")]
    crop: Option<String>,
    /// Do not crop the tactile images
    #[arg(long, conflicts_with = "crop")]
    already_cropped: bool,
    /// ONNX file, gripcast-vt (built-in classifier) or baseline-contact (built-in heuristic)
    #[arg(long, value_name = "MODEL", default_value = SHIPPED)]
    model: String,
    /// Predict the set of outcomes that is wrong at most at this rate: stable, slip or can't tell
    #[arg(long, value_name = "RATE", value_parser = number(ERROR_RATE))]
    error_rate: Option<f64>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct BaselineArgs {
    /// File to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.action {
        Action::Check(args) => check(context, &args),
        Action::Images(args) => predict_images(context, &args),
        Action::Stamp(args) => predict_stamp::run(context, &args),
        Action::Conformal(args) => predict_conformal::run(context, args),
        Action::Baseline(args) => write_baseline(context, &args.out),
    }
}

fn check(context: &Context, args: &CheckArgs) -> Result<()> {
    let model = Model::by_name(&args.model)?;
    let contract = model.contract();
    let (seed, manifest, origin) = match &contract.origin {
        Origin::Trained {
            seed,
            manifest_sha256,
        } => (
            json!(seed),
            json!(manifest_sha256),
            format!("trained on {manifest_sha256}, seed {seed}"),
        ),
        Origin::Heuristic => (Value::Null, Value::Null, "heuristic, not trained".into()),
    };
    let report = json!({
        "card": contract.card,
        "crop_profile": contract.crop_profile_name(),
        "file": args.model,
        "inputs": contract.inputs,
        "kind": contract.origin.name(),
        "load_ms": model.load_ms(),
        "name": contract.name,
        "fallbacks": contract.fallbacks,
        "geometry": contract.geometry,
        "other": contract.other,
        "seed": seed,
        "sha256": model.sha256(),
        "temperature": contract.temperature,
        "threshold": contract.threshold,
        "train_manifest_sha256": manifest,
        "modality": contract.modality,
    });
    print_report(args.json, &report, |_| {
        contract_text(context, &model, &origin)
    })
}

fn contract_text(context: &Context, model: &Model, origin: &str) -> String {
    let contract = model.contract();
    let mut lines = vec![
        format!("model      {} ({origin})", contract.name),
        format!("sha256     {}", model.sha256()),
        format!("modality   {}", contract.modality),
    ];
    for input in &contract.inputs {
        lines.push(format!(
            "input      {} {:?} {} {} {}, {}",
            input.name, input.shape, input.dtype, input.layout, input.colour, input.formula
        ));
    }
    for output in &contract.fallbacks {
        lines.push(format!(
            "fallback   {} ({}), threshold {}",
            output.modality,
            output.modality.words(),
            output.threshold
        ));
    }
    lines.push(format!("crop       {}", contract.crop_profile_name()));
    lines.push(format!("threshold  {}", contract.threshold));
    lines.push(format!("loaded in  {:.1} ms", model.load_ms()));
    if context.verbose > 0 {
        lines.push(format!("\n{}", contract.card.trim_end()));
    }
    lines.join("\n")
}

fn predict_images(context: &Context, args: &ImagesArgs) -> Result<()> {
    let model = Model::by_name(&args.model)?;
    let limits = args.error_rate.map(|rate| model.conformal_limits(rate));
    let limits = limits.transpose()?;
    let contract = model.contract();
    let crop = match &args.crop {
        Some(name) => {
            let crop = CropProfile::by_name(name).map_err(|error| error.at("--crop"))?;
            contract
                .check_crop_profile(crop.name())
                .map_err(|error| error.at("--crop"))?;
            crop
        }
        None if args.already_cropped => CropProfile::FULL,
        None => contract.crop_profile.unwrap_or(CropProfile::FULL),
    };
    let GraspPrediction {
        prediction,
        ood_score,
        label,
        unsure_reason,
    } = model.predict_grasp(|name| {
        let tactile = |initial: Option<&Path>, grasp: Option<&Path>| match (initial, grasp) {
            (None, None) => Ok(None),
            (Some(initial), Some(grasp)) => Ok(Some(InputImages::Tactile {
                initial: image(initial, &crop)?,
                grasp: image(grasp, &crop)?,
            })),
            (initial, _) => {
                let flag = match (name, initial.is_some()) {
                    (InputName::TactileRight, true) => "--grasp-right",
                    (InputName::TactileRight, false) => "--initial-right",
                    (_, true) => "--grasp-left",
                    (_, false) => "--initial-left",
                };
                let what = format!("`{flag} FILE` is needed beside the other images of `{name}`");
                Err(Error::usage(what))
            }
        };
        match name {
            InputName::TactileLeft => {
                tactile(args.initial_left.as_deref(), args.grasp_left.as_deref())
            }
            InputName::TactileRight => {
                tactile(args.initial_right.as_deref(), args.grasp_right.as_deref())
            }
            InputName::Rgb => {
                let rgb = args.rgb.as_deref();
                let rgb = rgb.map(|rgb| image(rgb, &CropProfile::FULL)).transpose()?;
                Ok(rgb.map(InputImages::Rgb))
            }
            InputName::Depth => {
                let depth = args.depth.as_deref();
                let depth = depth.map(|path| depth_image(path, args.depth_unit_m));
                let depth = depth.transpose()?;
                Ok(depth.map(|depth| InputImages::Depth(depth, args.depth_view)))
            }
        }
    })?;
    let missing = missing_flags(contract, prediction.modality);
    if !missing.is_empty() {
        context.warn([format!(
            "predicted from {} alone; the model also uses {}",
            prediction.modality.words(),
            missing.join(", ")
        )]);
    }
    let outcome = label.name();
    // The scores are those of the prediction from all inputs.
    let is_whole = prediction.modality == contract.modality;
    let set = limits.filter(|_| is_whole);
    let set = set.map(|limits| limits.set_of(prediction.p_stable));
    if contract.is_heuristic() {
        let name = &contract.name;
        context.warn([format!(
            "`{name}` is a contact-strength heuristic, not a trained model"
        )]);
    }
    let report = json!({
        "crop_profile": crop.name(),
        "engine_ms": prediction.engine_ms,
        "error_rate": args.error_rate,
        "geometry": prediction.geometry,
        "inputs": prediction.modality,
        "kind": contract.origin.name(),
        "model": contract.name,
        "model_sha256": model.sha256(),
        "ood_score": ood_score,
        "p_stable": prediction.p_stable,
        "predicted": outcome,
        "set": set,
        "threshold": prediction.threshold,
        "unsure_reason": unsure_reason,
    });
    print_report(args.json, &report, |_| {
        let reason = match (&unsure_reason, label) {
            (Some(reason), _) => format!("; {reason}"),
            (None, PredictedLabel::Unsure) => {
                "; the tactile images are out of distribution".to_owned()
            }
            (None, PredictedLabel::Stable | PredictedLabel::Slip) => String::new(),
        };
        let set = limits.zip(set).map(|(limits, set)| {
            format!(
                "\nat an error rate of {}: {}",
                limits.error_rate,
                set.words()
            )
        });
        format!(
            "{outcome}: p_stable {:.3}, threshold {}{reason}{}",
            prediction.p_stable,
            prediction.threshold,
            set.unwrap_or_default()
        )
    })
}

fn write_baseline(context: &Context, out: &Path) -> Result<()> {
    let bytes = baseline::onnx_bytes()?;
    save(out, &bytes)?;
    if !context.quiet {
        note!("wrote {} ({} bytes)", out.display(), bytes.len());
    }
    Ok(())
}

/// Flags of the inputs that a model has beside those of a prediction.
fn missing_flags(contract: &ModelContract, used: Modality) -> Vec<&'static str> {
    let inputs = contract.modality.inputs().into_iter();
    let missing = inputs.filter(|name| !used.has(*name));
    let flags = missing.filter_map(|name| match name {
        InputName::TactileLeft => Some("tactile images (`--initial-left`, …)"),
        InputName::TactileRight => None,
        InputName::Rgb => Some("`--rgb`"),
        InputName::Depth => Some("`--depth`"),
    });
    flags.collect()
}

/// Reads a depth image.
fn depth_image(path: &Path, unit_m: f64) -> Result<Depth> {
    let read = || -> Result<Depth> {
        let bytes = read_regular(path, FileKind::Image)
            .map_err(|e| Error::io("cannot read the depth image", e))?;
        let image = decode_png_grey16(&bytes)?;
        Ok(Depth { image, unit_m })
    };
    read().map_err(|error| error.at(path.display()))
}

/// Reads an image file, cropped and resized like a live frame.
fn image(path: &Path, crop: &CropProfile) -> Result<RgbImage> {
    let read = || -> Result<RgbImage> {
        let bytes = read_regular(path, FileKind::Image)
            .map_err(|e| Error::io("cannot read the image", e))?;
        let mut decoder = Decoder::new()?;
        let (width, height) = decoder.stored_image(&bytes)?.dimensions();
        if height > width {
            let what = format!("the image is upright ({width}×{height}), and the sensors' are not");
            return Err(Error::input(what)
                .remedy("rotate it as the camera sends it: it would be stretched to 320×240"));
        }
        decoder.decode_file(&bytes, Some(crop), IMAGE_WIDTH, IMAGE_HEIGHT)
    };
    read().map_err(|error| error.at(path.display()))
}
