//! `gripcast bench predict`: benchmarks one prediction.
//!
//! Loads the model, converts 320×240 images to tensors and predicts on one thread; prints minimum
//! and median in ms.

use serde_json::json;

use super::bench::Report;
use gripcast_base::error::{Error, Result};
use gripcast_nn::predict::{Model, PredictTimings, SHIPPED, measure, model_bytes};

/// Minimum for a usable median.
const MIN_RUNS: u64 = 30;

/// Arguments.
// Flattened into the arguments of gripcast-bench.
#[derive(Clone, Debug, clap::Args)]
#[group(skip)]
pub struct Args {
    /// ONNX file, gripcast-vt (built-in classifier) or baseline-contact (built-in heuristic)
    #[arg(long, value_name = "MODEL", default_value = SHIPPED)]
    model: String,
    /// Number of predictions
    #[arg(long, value_name = "N", default_value_t = 100,
        value_parser = clap::value_parser!(u64).range(MIN_RUNS..))]
    pub runs: u64,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

impl Args {
    /// Runs the benchmark; also returns the bytes of the model.
    ///
    /// # Errors
    /// If the model cannot be read, loaded or run.
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
    let f = figures;
    [
        "ms                  min   median".to_owned(),
        row("engine", f.engine_ms_min, f.engine_ms_median),
        row("preprocess", f.preprocess_ms_min, f.preprocess_ms_median),
        row("load", f.load_ms_min, f.load_ms_median),
    ]
    .concat()
}

/// Formats a line of the table.
pub fn row(name: &str, min: f64, median: f64) -> String {
    format!("\n{name:<14} {min:>8.3} {median:>8.3}")
}
