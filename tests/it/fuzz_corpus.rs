//! Runs the fuzz cases on the stored corpus, which includes past failures.

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

fn files(directory: &Path) -> Vec<PathBuf> {
    let entries =
        fs::read_dir(directory).unwrap_or_else(|e| panic!("{}: {e}", directory.display()));
    let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn stored_inputs_pass() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    for (name, check) in CASES {
        let files = files(&corpus.join(name));
        assert!(!files.is_empty(), "{name} has no inputs");
        for file in files {
            // Identifies a failing input.
            println!("{}", file.display());
            check(&fs::read(&file).unwrap());
        }
    }
    let directories: Vec<_> = files(&corpus);
    let has_case = |directory: &PathBuf| CASES.iter().any(|(name, _)| directory.ends_with(name));
    assert!(
        directories.iter().all(has_case),
        "directory without a case: {directories:?}"
    );
}

/// Seeded random inputs: a few hundred, or as many as fit into
/// `GRIPCAST_FUZZ_SECONDS` seconds (docs/how-to/fuzzing.md).
#[test]
fn random_hostile_names_are_safe() {
    let seconds = std::env::var("GRIPCAST_FUZZ_SECONDS").ok();
    let seconds: Option<u64> = seconds.map(|text| text.parse().unwrap());
    let start = Instant::now();
    let keep_going = |number: u64| match seconds {
        Some(seconds) => start.elapsed() < Duration::from_secs(seconds),
        None => number < 300,
    };
    let mut number = 0;
    while keep_going(number) {
        let mut random = Pcg64::seed_from_u64(number);
        let mut input = vec![0; 96];
        random.fill_bytes(&mut input);
        // Identifies a failing input.
        println!("seed {number}");
        hostile_names::check(&input);
        number += 1;
    }
    println!("{number} inputs");
}
