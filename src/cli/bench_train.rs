//! `gripcast bench train`: samples that the classifier learns from in a second.
//!
//! Steps of training on random pictures that are in memory: forwards, backwards, Adam. `--peer torch`
//! does the same with PyPI's torch in `python3`, in the same run.

use std::time::Instant;

use serde_json::{Map, Value, json};

use super::{Context, print, python_peer};
use crate::note;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::random::SeedStream;
use gripcast_base::workers::process_cpu_s;
use gripcast_nn::predict::contract::Variant;
use gripcast_nn::{Adam, Architecture, Batch, Network, PICTURE, Step};

const PEER_SCRIPT: &str = include_str!("../../benches/peers/torch_train.py");
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
    /// Another trainer to measure beside ours
    #[arg(long, value_enum)]
    peer: Option<Peer>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Peer {
    /// PyPI's torch, through `python3`
    Torch,
}

/// Samples per second of wall and of CPU time, medians.
struct Figures {
    per_s: f64,
    per_cpu_s: f64,
}

/// Runs the bench.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let architecture = Architecture::named(&args.arch).ok_or_else(|| {
        Error::new(
            ErrorKind::Usage,
            format!("there is no network `{}`", args.arch),
        )
    })?;
    let figures = measure(&architecture, args)?;
    let mut peers = Map::new();
    if let Some(Peer::Torch) = args.peer {
        let description = json!({
            "convolutions": architecture.convolutions,
            "pool": architecture.pool,
            "pooled": architecture.pooled(),
            "embedding": architecture.embedding,
            "hidden": architecture.hidden,
            "batch": args.batch,
            "threads": args.threads,
        });
        let input = description.to_string();
        match python_peer::measure("torch", PEER_SCRIPT, args.runs, input.as_bytes())? {
            Some(mut peer) => {
                let ratio = |ours: f64, key: &str| ours / peer[key].as_f64().unwrap_or(f64::NAN);
                let ratios = [
                    ratio(figures.per_s, "samples_per_s_median"),
                    ratio(figures.per_cpu_s, "samples_per_cpu_s_median"),
                ];
                peer["wall_ratio"] = json!(ratios[0]);
                peer["cpu_ratio"] = json!(ratios[1]);
                peers.insert("torch".to_owned(), peer);
            }
            None => {
                if !context.quiet {
                    note!(
                        "gripcast: torch is absent, so it was not measured\n  → pip install torch"
                    );
                }
            }
        }
    }
    if args.json {
        let report = json!({
            "figures": {
                "samples_per_s_median": figures.per_s,
                "samples_per_cpu_s_median": figures.per_cpu_s,
            },
            "name": "train",
            "params": {
                "arch": args.arch,
                "batch": args.batch,
                "runs": args.runs,
                "threads": args.threads,
            },
            "peers": peers,
        });
        return print(&format!("{report:#}"));
    }
    print(&table(&figures, &peers))
}

fn table(figures: &Figures, peers: &Map<String, Value>) -> String {
    let mut lines = vec!["samples              per s   per CPU s".to_owned()];
    let mut row = |name: &str, per_s: f64, per_cpu_s: f64| {
        lines.push(format!("{name:<14} {per_s:>11.1} {per_cpu_s:>11.1}"));
    };
    row("gripcast", figures.per_s, figures.per_cpu_s);
    for (name, peer) in peers {
        let figure = |key: &str| peer[key].as_f64().unwrap_or(f64::NAN);
        row(
            name,
            figure("samples_per_s_median"),
            figure("samples_per_cpu_s_median"),
        );
    }
    lines.join("\n")
}

fn measure(architecture: &Architecture, args: &Args) -> Result<Figures> {
    let mut draw = SeedStream::named(0, "bench train");
    let mut network = Network::new(architecture, Variant::Vt, || draw.uniform());
    let count = usize::from(args.batch);
    let picture: usize = PICTURE.iter().product();
    let mut pictures = |pictures: usize| -> Vec<f32> {
        (0..pictures * picture)
            .map(|_| draw.uniform() as f32 - 0.5)
            .collect()
    };
    let batch = Batch {
        touch: pictures(2 * count),
        vision: pictures(count),
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
            network.learn(&batch, &step, &mut gradient);
            adam.step(&layout, &mut network.parameters, &gradient, 3e-4, 0.01);
            if number >= WARM_UP {
                wall.push(begun.0.elapsed().as_secs_f64());
                cpu.push(process_cpu_s() - begun.1);
            }
        }
    });
    let median = |times: &mut Vec<f64>| {
        times.sort_by(f64::total_cmp);
        times[(times.len() - 1) / 2]
    };
    Ok(Figures {
        per_s: count as f64 / median(&mut wall),
        per_cpu_s: count as f64 / median(&mut cpu),
    })
}
