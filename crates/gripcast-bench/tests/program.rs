//! Running the benches as a developer does.

#![allow(
    clippy::unwrap_used,
    reason = "a helper of a test fails as a test does"
)]

use std::process::{Command, Output};

use serde_json::Value;

fn bench(arguments: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gripcast-bench"))
        .args(arguments.split_whitespace())
        .output()
        .unwrap()
}

fn report(arguments: &str) -> Value {
    let output = bench(arguments);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments}: {errors}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn dataset_reports_pages_and_filters() {
    let report = report("-q dataset --json --grasps 60 --runs 1");
    for figure in [
        "fill",
        "refresh",
        "first_page",
        "last_page",
        "filter_no_match",
    ] {
        let timing = &report["figures"][format!("{figure}_ms")];
        assert!(timing["median"].as_f64().unwrap() > 0.0, "{figure}");
    }
}

#[test]
fn contact_reports_phases_and_total() {
    let report = report("-q contact --json --faces 1280 --runs 20");
    assert_eq!(report["name"], "contact");
    assert_eq!(report["params"]["threads"], 1);
    assert!(report["baselines"].as_object().unwrap().is_empty());
    let ours = report["figures"]["coarse_1280_ours_ms"].as_f64().unwrap();
    let phases = &report["meshes"][0]["phases"];
    for phase in ["find", "energy", "gradient", "hessian", "ccd"] {
        let figure = |kind: &str| phases[phase][kind].as_f64().unwrap();
        assert!(
            0.0 < figure("min") && figure("min") <= figure("median"),
            "{phase}"
        );
        assert!(figure("min") < ours, "{phase}");
    }
    let pairs = &report["meshes"][0]["state"]["edge_edge_pairs"];
    assert!(pairs.as_u64().unwrap() > 100);
}

#[test]
fn predict_reports_engine_time() {
    let report = report("predict --json --runs 30");
    assert_eq!(report["name"], "predict");
    assert!(report["figures"]["engine_ms_median"].as_f64().unwrap() > 0.0);
}

#[test]
fn invalid_flags_are_usage_errors() {
    for wrong in [
        "contact --faces 1000",
        "contact --runs 3",
        "grasp --gel extra",
        "grasp --only nothing",
        "train --baseline jax",
    ] {
        assert_eq!(bench(wrong).status.code(), Some(2), "{wrong}");
    }
}
