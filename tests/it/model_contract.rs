//! Models on the command line: invalid ones are refused with a reason, and nothing panics.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::json_schema::assert_schema;
use gripcast_imaging::{encode_png_rgb, synthetic_gel};
use gripcast_nn::predict::{BASELINE, Model, SHIPPED, baseline, contract, onnx};
use serde_json::Value;

fn gripcast(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gripcast"))
        .args(arguments)
        .output()
        .unwrap()
}

fn json(output: &Output) -> Value {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Runs `predict check` on the bytes; it must fail with exit code 1 and print nothing to stdout.
fn refusal(directory: &Path, bytes: &[u8]) -> String {
    let file = directory.join("model.onnx");
    fs::write(&file, bytes).unwrap();
    let file = file.to_str().unwrap();
    let output = gripcast(&["predict", "check", file]);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(output.stdout.is_empty());
    assert!(stderr.contains(file), "missing file name: {stderr}");
    assert!(stderr.contains("\n  → "), "missing remedy: {stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
    stderr
}

fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("models/baseline-contact.onnx")
}

#[test]
fn shipped_model_passes_and_is_described() {
    let report = json(&gripcast(&[
        "predict",
        "check",
        shipped().to_str().unwrap(),
        "--json",
    ]));
    let trained = json(&gripcast(&["predict", "check", SHIPPED, "--json"]));
    assert_schema("predict check", &[&report, &trained]);
    assert_eq!(report["kind"], "heuristic");
    assert_eq!(report["modality"], "T");
    assert_eq!(report["threshold"], 0.5);
    assert_eq!(report["crop_profile"], "any");
    assert_eq!(report["sha256"], Model::baseline().unwrap().sha256());
    assert!(report["card"].as_str().unwrap().contains("not trained"));
    assert!(report["load_ms"].as_f64().unwrap() > 0.0);
    let keys: Vec<_> = report.as_object().unwrap().keys().collect();
    assert!(keys.is_sorted(), "{keys:?}");
}

#[test]
fn baseline_can_be_exported() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("again.onnx");
    let output = gripcast(&["predict", "baseline", "--out", file.to_str().unwrap()]);
    assert!(output.status.success());
    assert!(fs::read(file).unwrap() == fs::read(shipped()).unwrap());
    let missing = gripcast(&["predict", "baseline", "--out", "/no/such/folder/m.onnx"]);
    assert_eq!(missing.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&missing.stderr).contains("/no/such/folder/m.onnx"));
}

#[test]
fn other_files_are_refused_by_type() {
    let folder = tempfile::tempdir().unwrap();
    let refusal = |bytes: &[u8]| refusal(folder.path(), bytes);
    assert!(refusal(b"").contains("empty (0 bytes)"));
    assert!(refusal(b"\xff\xd8\xff\xe0\0\x10JFIF").contains("a JPEG image"));
    assert!(refusal(b"PK\x03\x04rest").contains("PyTorch"));
    assert!(refusal(b"version https://git-lfs.github.com/spec/v1\n").contains("git lfs pull"));
    assert!(refusal(b"<html></html>").contains("an HTML page"));
    assert!(refusal(b"\x80\x02}q\0.").contains("a Python pickle"));
    let whole = fs::read(shipped()).unwrap();
    assert!(refusal(&whole[..whole.len() / 2]).contains("damaged or truncated"));

    let missing = gripcast(&["predict", "check", "/no/such/model.onnx"]);
    assert_eq!(missing.status.code(), Some(1));
    let text = String::from_utf8_lossy(&missing.stderr).into_owned();
    assert!(text.contains("/no/such/model.onnx: cannot read"), "{text}");
    let directory = gripcast(&["predict", "check", folder.path().to_str().unwrap()]);
    assert_eq!(directory.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&directory.stderr).contains("a directory"));
}

#[test]
fn foreign_network_is_refused_with_the_missing_key() {
    let folder = tempfile::tempdir().unwrap();
    let mut graph = onnx::OnnxGraphBuilder::new("foreign");
    let x = graph.input("x", &[1, 3, 224, 224]).unwrap();
    let y = graph.node("Relu", "y", &[&x], []).unwrap();
    graph.output(&y, &[1, 3, 224, 224]);
    let text = refusal(folder.path(), &graph.to_bytes().unwrap());
    assert!(text.contains("missing key `gripcast.schema`"), "{text}");
    assert!(text.contains("models/README.md"), "{text}");
}

#[test]
fn stamped_file_of_another_program_is_a_model() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let mut graph = onnx::OnnxGraphBuilder::new("foreign");
    let rgb = graph.input("rgb", &contract::INPUT_SHAPE).unwrap();
    let flat = [onnx::Attribute::int("axis", 1)];
    let flat = graph.node("Flatten", "flat", &[&rgb], flat).unwrap();
    let over = [
        onnx::Attribute::ints("axes", &[1]),
        onnx::Attribute::int("keepdims", 1),
    ];
    let mean = graph.node("ReduceMean", "mean", &[&flat], over).unwrap();
    let answer = graph.node("Sigmoid", contract::OUTPUT, &[&mean], []);
    graph.output(&answer.unwrap(), &contract::OUTPUT_SHAPE);
    fs::write(at("foreign.onnx"), graph.to_bytes().unwrap()).unwrap();
    fs::write(at("data.txt"), "images/1.png").unwrap();
    let stamp = |more: &[&str]| {
        let (file, out) = (at("foreign.onnx"), at("stamped.onnx"));
        let mut arguments = vec!["predict", "stamp", &file, "--out", &out, "--name", "mine"];
        arguments.extend(["--modality", "v", "--threshold", "0.4"]);
        arguments.extend(more);
        gripcast(&arguments)
    };
    let colour = [
        "--rgb-mean",
        "0.485,0.456,0.406",
        "--rgb-std",
        "0.2,0.2,0.25",
    ];
    let data = at("data.txt");
    let without = stamp(&["--data", &data]);
    assert_eq!(without.status.code(), Some(2));
    let text = String::from_utf8_lossy(&without.stderr).into_owned();
    assert!(text.contains("needs `--rgb-mean R,G,B`"), "{text}");
    assert_eq!(stamp(&colour).status.code(), Some(2), "no origin");
    let stamped = stamp(&[&colour[..], &["--data", &data, "--seed", "3"]].concat());
    let text = String::from_utf8_lossy(&stamped.stderr).into_owned();
    assert!(stamped.status.success(), "{text}");
    let report = json(&gripcast(&[
        "predict",
        "check",
        &at("stamped.onnx"),
        "--json",
    ]));
    assert_eq!(report["name"], "mine");
    assert_eq!(
        (&report["seed"], &report["threshold"]),
        (&3.into(), &0.4.into())
    );
    let sha256 = gripcast_base::files::sha256_hex("images/1.png");
    assert_eq!(report["train_manifest_sha256"], sha256);
    assert_eq!(report["inputs"][0]["std"][2], 0.25);
}

#[test]
fn graph_with_mismatched_shapes_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut graph = onnx::OnnxGraphBuilder::new("odd");
    baseline::contract().write(&mut graph).unwrap();
    let left = graph.input("tactile_left", &contract::INPUT_SHAPE).unwrap();
    let right = graph.input("tactile_right", &contract::INPUT_SHAPE);
    let weights = graph.constant("w", &[7, 1], &[0.0; 7]).unwrap();
    let gemm = graph.node("Gemm", "gemm", &[&left, &weights], []).unwrap();
    let inputs = [&gemm, &right.unwrap()];
    let y = graph.node("Add", contract::OUTPUT, &inputs, []).unwrap();
    graph.output(&y, &contract::OUTPUT_SHAPE);
    let text = refusal(folder.path(), &graph.to_bytes().unwrap());
    assert!(text.contains("the engine cannot"), "{text}");
}

/// Flips bits of the shipped model one at a time. Returns the number of refusals; none may panic.
fn flip(positions: impl Iterator<Item = (usize, u32)>) -> usize {
    let mut model = baseline::onnx_bytes().unwrap();
    let mut refused = 0;
    for (byte, bit) in positions {
        model[byte] ^= 1 << bit;
        refused += usize::from(Model::from_bytes(&model).is_err());
        model[byte] ^= 1 << bit;
    }
    refused
}

#[test]
fn damaged_models_never_panic() {
    let whole = baseline::onnx_bytes().unwrap();
    for at in (0..whole.len()).step_by(7) {
        assert!(
            Model::from_bytes(&whole[..at]).is_err(),
            "truncated at {at}"
        );
    }
    let refused = flip((0..whole.len()).step_by(7).map(|at| (at, at as u32 % 8)));
    assert!(refused > 100, "only {refused} flips were detected");
}

#[test]
#[ignore = "flips every bit of the file, takes minutes"]
fn flipped_bits_never_panic() {
    let bytes = baseline::onnx_bytes().unwrap().len();
    let refused = flip((0..bytes).flat_map(|byte| (0..8).map(move |bit| (byte, bit))));
    assert!(refused > 8 * 100, "only {refused} flips were detected");
}

#[test]
fn grasp_is_predicted_from_image_files() {
    let folder = tempfile::tempdir().unwrap();
    let image = |name: &str, seed, contact| {
        let file = folder.path().join(name);
        let bytes = encode_png_rgb(&synthetic_gel(640, 480, seed, contact)).unwrap();
        fs::write(&file, bytes).unwrap();
        file.to_str().unwrap().to_owned()
    };
    let open_left = image("open-left.png", 1, 0.0);
    let open_right = image("open-right.png", 2, 0.0);
    let closed_left = image("closed-left.png", 3, 0.8);
    let closed_right = image("closed-right.png", 4, 0.8);
    let predict = |left: &str, right: &str, more: &[&str]| {
        let mut arguments = vec!["predict", "images", "--json"];
        arguments.extend(["--initial-left", &open_left, "--initial-right", &open_right]);
        arguments.extend(["--grasp-left", left, "--grasp-right", right]);
        arguments.extend(["--model", BASELINE]);
        arguments.extend(more);
        gripcast(&arguments)
    };
    let both = predict(&closed_left, &closed_right, &[]);
    assert!(String::from_utf8_lossy(&both.stderr).contains("heuristic"));
    let both = json(&both);
    assert_eq!(both["predicted"], "stable");
    assert_eq!(both["kind"], "heuristic");
    let crop = ["--crop", "gsmini-fifteen-v1"];
    let cropped = json(&predict(&closed_left, &closed_right, &crop));
    assert_eq!(cropped["crop_profile"], "gsmini-fifteen-v1");
    assert_eq!(
        json(&predict(&closed_left, &open_right, &[]))["predicted"],
        "slip"
    );
    assert_eq!(
        json(&predict(&open_left, &open_right, &[]))["predicted"],
        "slip"
    );

    let code = |output: Output| {
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code(), text)
    };
    let (status, text) = code(predict(&closed_left, &closed_right, &["--crop", "seventh"]));
    assert_eq!(status, Some(2), "{text}");
    assert!(
        text.contains("--crop: unknown crop profile `seventh`"),
        "{text}"
    );
    let not_an_image = shipped();
    let (status, text) = code(predict(&closed_left, not_an_image.to_str().unwrap(), &[]));
    assert_eq!(status, Some(1), "{text}");
    assert!(
        text.contains("expected a JPEG, PNG or WebP image"),
        "{text}"
    );
    let (status, text) = code(gripcast(&[
        "predict",
        "images",
        "--initial-left",
        &open_left,
    ]));
    assert_eq!(status, Some(2), "{text}");
    assert!(text.contains("`--grasp-left FILE` is needed"), "{text}");
}

#[test]
fn bench_reports_the_documented_timings() {
    let report = json(&gripcast(&["bench", "predict", "--runs", "30", "--json"]));
    assert_schema("bench predict", &[&report]);
    assert_eq!(report["name"], "predict");
    assert_eq!(report["params"]["runs"], 30);
    assert!(report["baselines"].as_object().unwrap().is_empty());
    for key in ["engine_ms", "preprocess_ms", "load_ms"] {
        let figure = |kind: &str| report["figures"][format!("{key}_{kind}")].as_f64().unwrap();
        assert!(
            0.0 < figure("min") && figure("min") <= figure("median"),
            "{key}"
        );
    }
    let few = gripcast(&["bench", "predict", "--runs", "3"]);
    assert_eq!(few.status.code(), Some(2));
}
