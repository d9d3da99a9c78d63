//! `gripcast-bench force-model`: fits the model of the force to simulated presses and measures it on
//! what it has not seen.
//!
//! ```text
//! gripcast-bench force-model --seed 0 --out calib/force/gelsight-mini.toml
//! ```
//!
//! Presses of 24 shapes on gels of three Poisson's ratios are simulated with finite elements and
//! rendered with sensors that differ from the shipped profile as real ones do. Held out are 11 other
//! shapes and 4 balls, on gels of two other Poisson's ratios, seen by other sensors. The shifted gel
//! is calibrated as by a user: with four weights on one ball.
//!
//! Exit codes: 0 done · 130 interrupted.

use std::path::{Path, PathBuf};

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast::cli::working::interruptible;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_regular, save};
use serde::Serialize;
use serde_json::json;

use crate::force_figures::{fitted, text};
use crate::force_presses::{SimulatedPress, simulate};
use crate::force_samples::samples;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Random seed of the sensors
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// File of the simulated presses: read if it exists, else written
    #[arg(long, value_name = "FILE.json")]
    presses: Option<PathBuf>,
    /// Write the fitted model
    #[arg(long, value_name = "FILE.toml")]
    out: Option<PathBuf>,
    /// Write the samples
    #[arg(long, value_name = "FILE.json")]
    samples: Option<PathBuf>,
    /// Simulate every N-th press
    #[arg(long, value_name = "N", default_value_t = 1)]
    stride: usize,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let (file, stride, seed) = (args.presses.clone(), args.stride, args.seed);
    let samples = interruptible(context, "pressing", move |progress| {
        let presses = match &file {
            Some(file) if file.exists() => read_presses(file)?,
            _ => simulate(stride, &|done, all| progress.count(done, all))?,
        };
        if let Some(file) = file.filter(|file| !file.exists()) {
            write_json(&file, &presses)?;
        }
        progress.stage("rendering");
        samples(&presses, seed)
    })??;
    if let Some(file) = &args.samples {
        write_json(file, &samples)?;
    }
    let (model, figures) = fitted(&samples)?;
    if let Some(file) = &args.out {
        save(file, model.to_toml()?.as_bytes())?;
    }
    let text = text(&figures);
    let figures = json!({"figures": figures, "model": model});
    Report::new("force-model", json!({"seed": args.seed}), figures, text).print(args.json)
}

fn read_presses(file: &Path) -> Result<Vec<SimulatedPress>> {
    let cannot = |e| Error::io("cannot read the presses", e).at(file.display());
    let bytes = read_regular(file, FileKind::Bulk).map_err(cannot)?;
    serde_json::from_slice(&bytes).map_err(|e| {
        Error::input("invalid presses")
            .because(e)
            .at(file.display())
    })
}

fn write_json(file: &Path, value: &impl Serialize) -> Result<()> {
    let bytes = serde_json::to_vec(value)
        .map_err(|e| Error::internal("cannot write the file").because(e))?;
    save(file, &bytes)
}
