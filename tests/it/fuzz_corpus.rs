//! The small inputs that the fuzzer keeps, and those that once went wrong.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng as _, SeedableRng as _};

#[path = "../../fuzz/cases/calibration_table.rs"]
mod calibration_table;
#[path = "../../fuzz/cases/frame.rs"]
mod frame;
#[path = "../../fuzz/cases/grasp_json.rs"]
mod grasp_json;
#[path = "../../fuzz/cases/hostile_names.rs"]
mod hostile_names;
#[path = "../../fuzz/cases/mesh.rs"]
mod mesh;
#[path = "../../fuzz/cases/onnx.rs"]
mod onnx;
#[path = "../../fuzz/cases/plan_jsonl.rs"]
mod plan_jsonl;
#[path = "../../fuzz/cases/settings.rs"]
mod settings;

type Case = (&'static str, fn(&[u8]));

const CASES: [Case; 8] = [
    ("calibration_table", calibration_table::check),
    ("frame", frame::check),
    ("grasp_json", grasp_json::check),
    ("hostile_names", hostile_names::check),
    ("mesh", mesh::check),
    ("onnx", onnx::check),
    ("plan_jsonl", plan_jsonl::check),
    ("settings", settings::check),
];

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn kept_inputs_are_answered() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    for (name, check) in CASES {
        let files = files(&corpus.join(name));
        assert!(!files.is_empty(), "{name} has no inputs");
        for file in files {
            // Names the input where it fails.
            println!("{}", file.display());
            check(&fs::read(&file).unwrap());
        }
    }
    let folders: Vec<_> = files(&corpus);
    let known = |folder: &PathBuf| CASES.iter().any(|(name, _)| folder.ends_with(name));
    assert!(
        folders.iter().all(known),
        "a folder that no case reads: {folders:?}"
    );
}

/// Random inputs from a seed: a few hundred, or as many as fit into
/// `GRIPCAST_FUZZ_SECONDS` seconds (docs/fuzzing.md).
#[test]
fn hostile_names_lead_nowhere() {
    let seconds = std::env::var("GRIPCAST_FUZZ_SECONDS").ok();
    let seconds: Option<u64> = seconds.map(|text| text.parse().unwrap());
    let began = Instant::now();
    let goes_on = |number: u64| match seconds {
        Some(seconds) => began.elapsed() < Duration::from_secs(seconds),
        None => number < 300,
    };
    let mut number = 0;
    while goes_on(number) {
        let mut random = Pcg64::seed_from_u64(number);
        let mut input = vec![0; 96];
        random.fill_bytes(&mut input);
        // Names the input where it fails.
        println!("seed {number}");
        hostile_names::check(&input);
        number += 1;
    }
    println!("{number} inputs");
}
