//! `gripcast-bench train`: samples that the classifier learns from in a second.
//!
//! Steps of training on random images that are in memory: forwards, backwards, Adam. `--peer torch`
//! does the same with PyPI's torch in `python3`, in the same run.

use std::time::Instant;

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::random::SeedStream;
use gripcast_base::statistics::median;
use gripcast_base::workers::process_cpu_s;
use gripcast_nn::predict::contract::Modality;
use gripcast_nn::{Adam, Architecture, Batch, IMAGE, Network, Step};
use serde_json::json;

use crate::peer::Peer;

const TORCH: Peer = Peer {
    name: "torch",
    packages: "torch",
    script: include_str!("../peers/torch_train.py"),
};
/// Steps before those that are measured.
const WARM_UP: u64 = 2;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Network
    #[arg(long, default_value = "gripcast", value_parser = Architecture::NAMES)]
    arch: String,
    /// Samples of a step
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u16).range(2..=1024))]
    batch: u16,
    /// Threads
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: u16,
    /// Steps to measure
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(3..))]
    runs: u64,
    /// Measure PyPI's torch as well
    #[arg(long, value_parser = [TORCH.name])]
    peer: Option<String>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the bench.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let architecture = Architecture::by_name(&args.arch)
        .ok_or_else(|| Error::usage(format!("there is no network `{}`", args.arch)))?;
    let [per_s, per_cpu_s] = measure(&architecture, args)?;
    let params = json!({
        "arch": args.arch,
        "batch": args.batch,
        "runs": args.runs,
        "threads": args.threads,
    });
    let figures = json!({"samples_per_s_median": per_s, "samples_per_cpu_s_median": per_cpu_s});
    let mut text = "samples              per s   per CPU s".to_owned();
    text += &row("gripcast", per_s, per_cpu_s);
    let mut report = Report::new("train", params, figures, text);
    if args.peer.is_some() {
        let input = json!({
            "convolutions": architecture.convolutions,
            "pool": architecture.pool,
            "pooled": architecture.pooled(),
            "embedding": architecture.embedding,
            "hidden": architecture.hidden,
            "batch": args.batch,
            "threads": args.threads,
        });
        let input = input.to_string();
        if let Some(mut peer) = TORCH.measure(context, args.runs, input.as_bytes())? {
            let figure = |key: &str| peer[key].as_f64().unwrap_or(f64::NAN);
            let theirs = ["samples_per_s_median", "samples_per_cpu_s_median"].map(figure);
            peer["wall_ratio"] = json!(per_s / theirs[0]);
            peer["cpu_ratio"] = json!(per_cpu_s / theirs[1]);
            report.text += &row("torch", theirs[0], theirs[1]);
            report.peers.insert("torch".to_owned(), peer);
        }
    }
    report.print(args.json)
}

fn row(name: &str, per_s: f64, per_cpu_s: f64) -> String {
    format!("\n{name:<14} {per_s:>11.1} {per_cpu_s:>11.1}")
}

/// Samples per second of wall and of CPU time, medians.
fn measure(architecture: &Architecture, args: &Args) -> Result<[f64; 2]> {
    let mut draw = SeedStream::named(0, "bench train");
    let mut network = Network::new(architecture, Modality::Vt, || draw.uniform());
    let count = usize::from(args.batch);
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
    };
    let mut gradient = vec![0.0; network.parameters.len()];
    let mut adam = Adam::new(network.parameters.len());
    let layout = network.layout().clone();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(usize::from(args.threads))
        .build()
        .map_err(|e| Error::new(ErrorKind::Io, "cannot start threads").because(e))?;
    let (mut wall, mut cpu) = (Vec::new(), Vec::new());
    pool.install(|| {
        for number in 0..WARM_UP + args.runs {
            let begun = (Instant::now(), process_cpu_s());
            let step = Step {
                number,
                ..Step::default()
            };
            gradient.fill(0.0);
            network.train_step(&batch, &step, &mut gradient);
            adam.step(&layout, &mut network.parameters, &gradient, 3e-4, 0.01);
            if number >= WARM_UP {
                wall.push(begun.0.elapsed().as_secs_f64());
                cpu.push(process_cpu_s() - begun.1);
            }
        }
    });
    Ok([wall, cpu].map(|took| count as f64 / median(took).unwrap_or(f64::NAN)))
}
