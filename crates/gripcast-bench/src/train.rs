//! `gripcast-bench train`: training throughput.
//!
//! Training steps on random images in memory: forward, backward, Adam. `--baseline torch` does the
//! same with PyTorch.

use std::time::Instant;

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast_base::error::{Error, Result};
use gripcast_base::random::SeedStream;
use gripcast_base::statistics::median;
use gripcast_base::workers::process_cpu_s;
use gripcast_nn::predict::contract::Modality;
use gripcast_nn::{Adam, Architecture, Batch, IMAGE, Network, Step};
use serde_json::json;

use crate::baseline::Baseline;

const TORCH: Baseline = Baseline {
    name: "torch",
    packages: "torch",
    script: include_str!("../peers/torch_train.py"),
};
/// Steps before the measurement.
const WARM_UP: u64 = 2;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Network architecture
    #[arg(long, default_value = "gripcast", value_parser = Architecture::NAMES)]
    arch: String,
    /// Batch size
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u16).range(2..=1024))]
    batch_size: u16,
    /// Number of threads
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: u16,
    /// Number of steps
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(3..))]
    runs: u64,
    /// Baseline to compare against (PyPI)
    #[arg(long, value_parser = [TORCH.name])]
    baseline: Option<String>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let architecture = Architecture::by_name(&args.arch)
        .ok_or_else(|| Error::usage(format!("unknown network architecture `{}`", args.arch)))?;
    let [per_s, per_cpu_s] = measure(&architecture, args)?;
    let params = json!({
        "arch": args.arch,
        "batch_size": args.batch_size,
        "runs": args.runs,
        "threads": args.threads,
    });
    let figures = json!({"samples_per_s_median": per_s, "samples_per_cpu_s_median": per_cpu_s});
    let mut text = "samples              per s   per CPU s".to_owned();
    text += &row("gripcast", per_s, per_cpu_s);
    let mut report = Report::new("train", params, figures, text);
    if args.baseline.is_some() {
        let input = json!({
            "convolutions": architecture.convolutions,
            "pool": architecture.pool,
            "pooled": architecture.pooled(),
            "embedding": architecture.embedding,
            "hidden": architecture.hidden,
            "batch": args.batch_size,
            "threads": args.threads,
        });
        let input = input.to_string();
        if let Some(mut baseline) = TORCH.measure(context, args.runs, input.as_bytes())? {
            let figure = |key: &str| baseline[key].as_f64().unwrap_or(f64::NAN);
            let theirs = ["samples_per_s_median", "samples_per_cpu_s_median"].map(figure);
            baseline["wall_ratio"] = json!(per_s / theirs[0]);
            baseline["cpu_ratio"] = json!(per_cpu_s / theirs[1]);
            report.text += &row("torch", theirs[0], theirs[1]);
            report.baselines.insert("torch".to_owned(), baseline);
        }
    }
    report.print(args.json)
}

fn row(name: &str, per_s: f64, per_cpu_s: f64) -> String {
    format!("\n{name:<14} {per_s:>11.1} {per_cpu_s:>11.1}")
}

/// Measures samples per second of wall time and of CPU time (medians).
fn measure(architecture: &Architecture, args: &Args) -> Result<[f64; 2]> {
    let mut draw = SeedStream::named(0, "bench train");
    let mut network = Network::new(architecture, Modality::Vt, || draw.uniform());
    let count = usize::from(args.batch_size);
    let image: usize = IMAGE.iter().product();
    let mut images = |images: usize| -> Vec<f32> {
        (0..images * image)
            .map(|_| draw.uniform() as f32 - 0.5)
            .collect()
    };
    let batch = Batch {
        touch: images(2 * count),
        vision: images(count),
        targets: (0..count).map(|i| (i % 2) as f32).collect(),
        weights: vec![1.0; count],
        ..Batch::default()
    };
    let mut gradient = vec![0.0; network.parameters.len()];
    let mut adam = Adam::new(network.parameters.len());
    let layout = network.layout().clone();
    let pool = crate::timing::pool(usize::from(args.threads))?;
    let (mut wall, mut cpu) = (Vec::new(), Vec::new());
    pool.install(|| {
        for number in 0..WARM_UP + args.runs {
            let start = (Instant::now(), process_cpu_s());
            let step = Step {
                number,
                ..Step::default()
            };
            gradient.fill(0.0);
            network.train_step(&batch, &step, &mut gradient);
            adam.step(
                layout.params(),
                &mut network.parameters,
                &gradient,
                3e-4,
                0.01,
            );
            if number >= WARM_UP {
                wall.push(start.0.elapsed().as_secs_f64());
                cpu.push(process_cpu_s() - start.1);
            }
        }
    });
    Ok([wall, cpu].map(|took| count as f64 / median(took).unwrap_or(f64::NAN)))
}
