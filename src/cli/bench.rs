//! `gripcast bench`: benchmarks gripcast on this machine.
//!
//! Each benchmark prints a table, or with `--json` one object `{"figures", "name", "params",
//! "baselines"}`. Benchmarks for developers are in `crates/gripcast-bench`.

use serde::Serialize;
use serde_json::{Map, Value};

use super::{Context, bench_daemon, bench_live, bench_predict, print_report};
use gripcast_base::error::Result;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    bench: Bench,
}

#[derive(Debug, clap::Subcommand)]
enum Bench {
    /// Benchmark the live path: dropped frames, latency, cores, memory
    Live(bench_live::Args),
    /// Benchmark a collecting daemon: API latency, saves, viewers, memory
    Daemon(bench_daemon::Args),
    /// Benchmark one prediction: load, preprocess, engine
    Predict(bench_predict::Args),
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.bench {
        Bench::Live(args) => args.measure(context)?.print(args.json),
        Bench::Daemon(args) => args.measure(context)?.print(args.json),
        Bench::Predict(args) => args.measure()?.0.print(args.json),
    }
}

/// Result of a benchmark.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Name of the benchmark.
    pub name: &'static str,
    /// Its parameters.
    pub params: Value,
    /// Measured figures.
    pub figures: Value,
    /// Figures of other implementations, by name.
    pub baselines: Map<String, Value>,
    /// Further keys of the JSON object.
    #[serde(flatten)]
    pub more: Map<String, Value>,
    /// The result as text.
    #[serde(skip)]
    pub text: String,
}

impl Report {
    /// Returns a report without baselines.
    pub fn new(name: &'static str, params: Value, figures: Value, text: String) -> Self {
        Self {
            name,
            params,
            figures,
            baselines: Map::new(),
            more: Map::new(),
            text,
        }
    }

    /// Prints the JSON object or the text on stdout.
    ///
    /// # Errors
    /// `Io`.
    pub fn print(&self, is_json: bool) -> Result<()> {
        print_report(is_json, self, |report| report.text.clone())
    }
}
