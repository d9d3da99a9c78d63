//! `gripcast predict stamp`: writes the contract into an ONNX file of another program.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::Context;
use super::flags::{fraction, modality};
use crate::note;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_regular, read_text, save, sha256_hex};
use gripcast_imaging::CropProfile;
use gripcast_nn::predict::contract::{InputName, InputSpec, Modality, Origin, RgbNormalisation};
use gripcast_nn::predict::{Model, ModelContract, onnx};
use gripcast_train::dataset_sha256;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct StampArgs {
    /// ONNX file; its inputs and output have the contract's names and shapes
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// File to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Model name
    #[arg(long)]
    name: String,
    /// Input modality
    #[arg(long, value_name = "MODALITY", default_value = "vt", value_parser = modality())]
    modality: Modality,
    /// Crop profile of the tactile images in training
    #[arg(long, value_name = "PROFILE")]
    crop: Option<String>,
    /// Mean of red, green and blue in training, of pixels from 0 to 1
    #[arg(long, value_name = "R,G,B", value_parser = channels)]
    rgb_mean: Option<[f32; 3]>,
    /// Standard deviation of red, green and blue in training, of pixels from 0 to 1
    #[arg(long, value_name = "R,G,B", value_parser = channels)]
    rgb_std: Option<[f32; 3]>,
    /// Decision threshold: stable at or above it
    #[arg(long, value_name = "P", default_value_t = 0.5, value_parser = fraction)]
    threshold: f64,
    /// Training data: folder of a dataset, or a file that lists it
    #[arg(long, value_name = "PATH", required_unless_present = "heuristic")]
    data: Option<PathBuf>,
    /// Random seed of the training
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// The model is hand-written, not trained
    #[arg(long, conflicts_with_all = ["data", "seed"])]
    heuristic: bool,
    /// Markdown file: intended use, data, limits, licence
    #[arg(long, value_name = "FILE")]
    card: Option<PathBuf>,
}

/// Card of a model without one.
const NO_CARD: &str = "No card was given: intended use, data, limits and licence are unknown.";

/// Runs the command.
pub(super) fn run(context: &Context, args: &StampArgs) -> Result<()> {
    let contract = contract(args)?;
    let bytes = onnx::read(&args.file)?;
    let stamped = contract.stamp(&bytes).and_then(|stamped| {
        // What is written loads.
        Model::from_bytes(&stamped).map(|_| stamped)
    });
    let stamped = stamped.map_err(|e| e.at(args.file.display()))?;
    save(&args.out, &stamped)?;
    if !context.quiet {
        let size = stamped.len();
        note!("wrote {} ({size} bytes)", args.out.display());
    }
    Ok(())
}

fn contract(args: &StampArgs) -> Result<ModelContract> {
    let needed = |flag: &str| {
        let what = format!("the modality {} needs `{flag}`", args.modality);
        Error::usage(what)
    };
    let inputs = args.modality.inputs().into_iter().map(|name| match name {
        InputName::Rgb => Ok(InputSpec::rgb(RgbNormalisation {
            mean: args.rgb_mean.ok_or_else(|| needed("--rgb-mean R,G,B"))?,
            std: args.rgb_std.ok_or_else(|| needed("--rgb-std R,G,B"))?,
        })),
        InputName::Depth => Ok(InputSpec::depth()),
        touch => Ok(InputSpec::tactile(touch)),
    });
    let crop_profile = match &args.crop {
        Some(name) => Some(CropProfile::by_name(name).map_err(|e| e.at("--crop"))?),
        None if args.modality.has_touch() && !args.heuristic => {
            return Err(needed("--crop PROFILE"));
        }
        None => None,
    };
    let origin = match &args.data {
        Some(data) => Origin::Trained {
            seed: args.seed,
            manifest_sha256: data_sha256(data)?,
        },
        None => Origin::Heuristic,
    };
    let card = args.card.as_deref().map(|path| {
        read_text(path, FileKind::List)
            .map_err(|e| Error::io("cannot read the card", e).at(path.display()))
    });
    Ok(ModelContract {
        name: args.name.clone(),
        origin,
        modality: args.modality,
        inputs: inputs.collect::<Result<_>>()?,
        threshold: args.threshold,
        temperature: 1.0,
        fallbacks: Vec::new(),
        geometry: Vec::new(),
        contact: Vec::new(),
        crop_profile,
        card: card.transpose()?.unwrap_or_else(|| NO_CARD.to_owned()),
        other: BTreeMap::new(),
    })
}

fn data_sha256(data: &Path) -> Result<String> {
    if data.is_dir() {
        return dataset_sha256(&[data.to_owned()]);
    }
    read_regular(data, FileKind::List)
        .map(sha256_hex)
        .map_err(|e| Error::io("cannot read the list of the training data", e).at(data.display()))
}

fn channels(text: &str) -> Result<[f32; 3], String> {
    let numbers: Option<Vec<f32>> = text.split(',').map(|x| x.trim().parse().ok()).collect();
    let numbers = numbers.filter(|numbers| numbers.iter().all(|x| x.is_finite()));
    let numbers = numbers.and_then(|numbers| numbers.try_into().ok());
    numbers.ok_or_else(|| "expected three numbers, such as 0.485,0.456,0.406".to_owned())
}
