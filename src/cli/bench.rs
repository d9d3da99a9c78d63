//! `gripcast bench`: measures gripcast on this machine.
//!
//! Each bench prints a table, or with `--json` one object `{"figures", "name", "params", "peers"}`.
//! Benches for developers are in `crates/gripcast-bench`.

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::{Context, bench_daemon, bench_live, bench_predict, print, print_json};
use gripcast_base::error::Result;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    bench: Bench,
}

#[derive(Debug, clap::Subcommand)]
enum Bench {
    /// The complete live path: frames lost, latency, cores, memory
    Live(bench_live::Args),
    /// A daemon that collects: calls of the API, saves, viewers, memory
    Daemon(bench_daemon::Args),
    /// One prediction: load, preprocess, engine
    Predict(bench_predict::Args),
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.bench {
        Bench::Live(args) => args.measure(context)?.print(args.json),
        Bench::Daemon(args) => args.measure(context)?.print(args.json),
        Bench::Predict(args) => args.measure()?.0.print(args.json),
    }
}

/// What a bench measured.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Name of the bench.
    pub name: &'static str,
    /// What was chosen.
    pub params: Value,
    /// What was measured.
    pub figures: Value,
    /// What other implementations took, by their names.
    pub peers: Map<String, Value>,
    /// More keys of the object.
    #[serde(flatten)]
    pub more: Map<String, Value>,
    /// The same for people.
    #[serde(skip)]
    pub text: String,
}

impl Report {
    /// A report without peers.
    pub fn new(name: &'static str, params: Value, figures: Value, text: String) -> Self {
        Self {
            name,
            params,
            figures,
            peers: Map::new(),
            more: Map::new(),
            text,
        }
    }

    /// Prints the JSON object or the text on stdout.
    ///
    /// # Errors
    /// That of the operating system.
    pub fn print(&self, is_json: bool) -> Result<()> {
        if is_json {
            print_json(&json!(self))
        } else {
            print(&self.text)
        }
    }
}
