//! `gripcast bench predict`: how long one prediction takes on this machine.
//!
//! Loads the model, turns 320×240 images into tensors and predicts, on one thread; prints minimum
//! and median in ms.

use serde_json::json;

use super::bench::Report;
use gripcast_base::error::{Error, Result};
use gripcast_nn::predict::{Model, PredictTimings, SHIPPED, measure, model_bytes};

/// Runs below this give no usable median.
const MIN_RUNS: u64 = 30;

/// Arguments.
// Flattened into the arguments of gripcast-bench.
#[derive(Clone, Debug, clap::Args)]
#[group(skip)]
pub struct Args {
    /// ONNX file, `gripcast-vt`, the built-in classifier, or `baseline-contact`, a heuristic
    #[arg(long, value_name = "MODEL", default_value = SHIPPED)]
    model: String,
    /// Predictions to measure
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(MIN_RUNS..))]
    pub runs: u64,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

impl Args {
    /// Runs the bench; also gives the bytes of the model.
    ///
    /// # Errors
    /// When the model cannot be read, loaded or run.
    pub fn measure(&self) -> Result<(Report, Vec<u8>)> {
        let bytes = model_bytes(&self.model)?;
        let at_model = |error: Error| error.at(&self.model);
        let model = Model::from_bytes(&bytes).map_err(at_model)?;
        let figures = measure(&bytes, self.runs as usize).map_err(at_model)?;
        let params = json!({
            "model": model.contract().name,
            "model_sha256": model.sha256(),
            "runs": self.runs,
            "threads": 1,
        });
        let report = Report::new("predict", params, json!(figures), table(&figures));
        Ok((report, bytes))
    }
}

fn table(figures: &PredictTimings) -> String {
    let rows = [
        ("engine", figures.engine_ms_min, figures.engine_ms_median),
        (
            "preprocess",
            figures.preprocess_ms_min,
            figures.preprocess_ms_median,
        ),
        ("load", figures.load_ms_min, figures.load_ms_median),
    ];
    let rows = rows.map(|(name, min, median)| row(name, min, median));
    format!("ms                  min   median{}", rows.concat())
}

/// A further line of the table.
pub fn row(name: &str, min: f64, median: f64) -> String {
    format!("\n{name:<14} {min:>8.3} {median:>8.3}")
}
