//! The command `train`: killed, stopped and gone on with, and what it refuses.

use std::fs;
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};

use gripcast_base::files::Root;
use gripcast_dataset::shard::{
    ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow, ShardWriter, shard_path,
};
use gripcast_geometry::Pose;
use gripcast_imaging::{encode_jpeg, synthetic_gel};
use gripcast_train::RunFolder;
use image::{Rgb, RgbImage};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::json_schema::assert_schema;
use crate::program::{end_of, gripcast, json, stderr, succeed, wait_until};

/// Epochs of a run, enough to be met in the middle of it.
const EPOCHS: &str = "4";

/// A sample that holds where both gels are in clear contact.
fn row(part: &str, number: u64, is_stable: bool) -> ShardRow {
    let outcome = if is_stable {
        ShardOutcome::Stable
    } else {
        ShardOutcome::Slip
    };
    let facts = ShardFacts {
        id: format!("{part}-{number}"),
        simulation: format!("{part}-{number}"),
        object: format!("{part}-object-{}", number % 2),
        category: "mug".to_owned(),
        engine: ShardEngine::Fem,
        outcome,
        outcome_detail: if is_stable { "success" } else { "slip" }.to_owned(),
        stop_force_n: Some(10.0),
        friction: Some(0.5),
        mass_kg: Some(0.1),
        lifted_m: Some(0.05),
        force_left_n: Some(5.0),
        force_right_n: Some(5.0),
        opening_m: Some(0.02),
        t_object_gripper: Some(Pose::new(glam::DQuat::IDENTITY, glam::DVec3::ZERO)),
        fault: None,
        appearance: "plain".to_owned(),
        rendering: 0,
        seed: number,
        crop_profile: "full-v1".to_owned(),
        geometry: None,
        lift: None,
        contact: None,
    };
    let gel = |side: u64, contact: f32| {
        let image = synthetic_gel(
            320,
            240,
            100 * part.len() as u64 + 2 * number + side,
            contact,
        );
        encode_jpeg(&image, 85).unwrap()
    };
    let contact = if is_stable { 0.9 } else { 0.05 };
    let colour = RgbImage::from_fn(320, 240, |x, y| Rgb([(x / 2) as u8, y as u8, 90]));
    let images = ShardImages {
        initial_left: gel(0, 0.0),
        initial_right: gel(1, 0.0),
        grasp_left: gel(0, contact),
        grasp_right: gel(1, contact),
        grasp_rgb: encode_jpeg(&colour, 85).unwrap(),
        initial_rgb: None,
        grasp_depth: None,
    };
    ShardRow { facts, images }
}

fn write_part(data: &Path, part: &str, rows: impl IntoIterator<Item = ShardRow>) {
    fs::create_dir_all(data).unwrap();
    let place = shard_path(&Root::new(data), part, 0, 1).unwrap();
    place.parent().create_dir_all().unwrap();
    let mut writer = ShardWriter::create(&place, "{}").unwrap();
    for row in rows {
        writer.push(row).unwrap();
    }
    writer.finish().unwrap();
}

/// A dataset of a few samples with both labels.
fn write_dataset(data: &Path) {
    for (part, rows) in [("train", 8), ("validation", 4)] {
        write_part(data, part, (0..rows).map(|n| row(part, n, n % 4 < 2)));
    }
}

fn train(data: &Path, out: &Path) -> Command {
    let mut command = gripcast();
    command
        .args(["train", "--json", "--modality", "t", "--batch-size", "4"])
        .args(["--epochs", EPOCHS, "--data"])
        .arg(data)
        .arg("--out")
        .arg(out);
    command
}

#[test]
fn seed_with_best_validation_auroc_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    for (part, rows) in [("train", 8), ("validation", 20)] {
        // Labels that contact does not explain, so that the seeds differ.
        let row = |n| {
            let mut row = row(part, n, n % 4 < 2);
            if n % 5 == 0 {
                row.facts.outcome = ShardOutcome::Slip;
            }
            row
        };
        write_part(&data, part, (0..rows).map(row));
    }
    let out = dir.path().join("run");
    let mut command = train(&data, &out);
    command.args(["--seeds", "4"]);
    let report = json(&succeed(&mut command));
    let runs = report["runs"].as_array().unwrap();
    let auroc = |run: &Value| run["validation"]["auroc"].as_f64().unwrap();
    let aurocs: Vec<f64> = runs.iter().map(auroc).collect();
    let best = aurocs.iter().copied().fold(0.0, f64::max);
    assert!(aurocs.iter().any(|x| *x < best), "{aurocs:?}");
    let seed = aurocs.iter().position(|x| *x == best).unwrap();
    let model = runs[seed]["model"].as_str().unwrap();
    let kept = fs::read(out.join("model.onnx")).unwrap();
    assert_eq!(kept, fs::read(model).unwrap(), "{aurocs:?}");
}

/// Figures of the epochs, without how fast they were.
fn metrics(out: &Path) -> Vec<Value> {
    let text = fs::read_to_string(RunFolder::at(out).metrics().shown()).unwrap_or_default();
    // The last line may be half there while the run goes on.
    let whole = &text[..text.rfind('\n').map_or(0, |at| at + 1)];
    let lines = whole.lines().map(|line| {
        let mut figures: Value = serde_json::from_str(line).unwrap();
        figures.as_object_mut().unwrap().remove("samples_per_s");
        figures
    });
    lines.collect()
}

/// Starts or goes on with a run, sends a signal once `epochs` are noted, and tells how it ended.
fn signalled(data: &Path, out: &Path, epochs: usize, signal: Signal) -> Option<i32> {
    let mut child = train(data, out)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    wait_until(&mut child, || metrics(out).len() >= epochs);
    kill_process(Pid::from_child(&child), signal).unwrap();
    let code = end_of(&mut child).code();
    assert!(
        !RunFolder::at(out).model().is_file(),
        "it had ended already"
    );
    code
}

#[test]
fn killed_and_stopped_run_ends_with_same_files() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    write_dataset(&data);
    let [whole, broken] = ["whole", "broken"].map(|name| dir.path().join(name));
    let told = json(&succeed(&mut train(&data, &whole)));
    assert_eq!(told["runs"][0]["epochs"], 4, "{told}");

    assert_eq!(signalled(&data, &broken, 1, Signal::KILL), None);
    assert_eq!(signalled(&data, &broken, 2, Signal::TERM), Some(75));
    let again = json(&succeed(&mut train(&data, &broken)));
    assert_eq!(
        again["runs"][0]["validation"],
        told["runs"][0]["validation"]
    );
    assert_eq!(metrics(&broken), metrics(&whole));
    let [one, other] = [&whole, &broken].map(RunFolder::at);
    let same = |a: &Path, b: &Path| fs::read(a).unwrap() == fs::read(b).unwrap();
    assert!(
        same(&one.model().shown(), &other.model().shown()),
        "the models differ"
    );
    assert!(
        same(&one.state().shown(), &other.state().shown()),
        "the checkpoints differ"
    );
    assert!(
        same(&one.run().shown(), &other.run().shown()),
        "the descriptions differ"
    );

    let state = fs::read(one.state().shown()).unwrap();
    succeed(&mut train(&data, &whole));
    assert!(
        fs::read(one.state().shown()).unwrap() == state,
        "a run that has ended went on"
    );

    for (flag, value, words) in [
        ("--dropout", "0.5", "dropout 0.2, not 0.5"),
        ("--seed", "7", "seed 0, not 7"),
        (
            "--learning-rate",
            "0.001",
            "learning_rate 0.0003, not 0.001",
        ),
    ] {
        let refused = train(&data, &whole).args([flag, value]).output().unwrap();
        let text = stderr(&refused);
        assert_eq!(refused.status.code(), Some(2), "{text}");
        assert!(text.contains(words) && text.contains("run.json"), "{text}");
    }
    write_part(&data, "test", (0..2).map(|n| row("test", n, n == 0)));
    let refused = train(&data, &whole).output().unwrap();
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        stderr(&refused).contains("another dataset"),
        "{}",
        stderr(&refused)
    );
}

#[test]
fn fine_tuned_model_is_compared_with_its_start_and_resumes_to_same_files() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    write_dataset(&data);
    let start = dir.path().join("start");
    let before = json(&succeed(&mut train(&data, &start)));
    let fine_tune = |out: &Path| {
        let mut command = gripcast();
        command
            .args(["train", "--json", "--batch-size", "4", "--epochs", "3"])
            .args(["--unfreeze-epochs", "1", "--data"])
            .arg(&data)
            .arg("--from")
            .arg(&start)
            .arg("--out")
            .arg(out);
        command
    };
    let [whole, broken] = ["whole", "broken"].map(|name| dir.path().join(name));
    let told = json(&succeed(&mut fine_tune(&whole)));
    assert_schema("train", &[&before, &told]);
    let comparison = &told["runs"][0]["comparison"];
    assert_eq!(comparison["start"], "trained-t");
    let advice = comparison["advice"].as_str().unwrap();
    assert!(advice.contains("`trained-t`"), "{advice}");

    let mut child = fine_tune(&broken).stdout(Stdio::null()).spawn().unwrap();
    wait_until(&mut child, || metrics(&broken).len() >= 2);
    kill_process(Pid::from_child(&child), Signal::KILL).unwrap();
    end_of(&mut child);
    succeed(&mut fine_tune(&broken));
    let [one, other] = [&whole, &broken].map(RunFolder::at);
    for file in [RunFolder::model, RunFolder::state, RunFolder::run] {
        let [one, other] = [&one, &other].map(|run| fs::read(file(run).shown()).unwrap());
        assert!(one == other, "the files differ");
    }

    for (flags, words) in [
        (["--modality", "t"], "--modality"),
        (["--arch", "paper"], "--arch"),
    ] {
        let refused = fine_tune(&whole).args(flags).output().unwrap();
        let text = stderr(&refused);
        assert_eq!(refused.status.code(), Some(2), "{text}");
        assert!(text.contains(words) && text.contains("--from"), "{text}");
    }
    let mut heuristic = gripcast();
    heuristic
        .args([
            "train",
            "--from",
            "baseline-contact",
            "--out",
            "no-run",
            "--data",
        ])
        .arg(&data);
    let refused = heuristic.output().unwrap();
    let text = stderr(&refused);
    assert_eq!(refused.status.code(), Some(1), "{text}");
    assert!(
        text.contains("baseline-contact") && text.contains("gripcast-vt"),
        "{text}"
    );
}

#[test]
fn trained_model_predicts_sets_at_an_error_rate() {
    let dir = tempfile::tempdir().unwrap();
    let [data, out] = ["data", "run"].map(|name| dir.path().join(name));
    write_dataset(&data);
    write_part(&data, "test", (0..8).map(|n| row("test", n, n % 4 < 2)));
    succeed(&mut train(&data, &out));
    let model = out.join("model.onnx");
    let eval = |model: &Path, flags: &[&str]| {
        let mut command = gripcast();
        command.args(["eval", "--json", "--model"]).arg(model);
        command.arg("--data").arg(&data).args(flags);
        command
    };
    let found = json(&succeed(&mut eval(&model, &[])));
    let sets = &found["conformal"];
    assert_eq!(
        (&sets["error_rate"], &sets["all"]["n"]),
        (&0.1.into(), &8.into())
    );
    assert_eq!(sets["scores_of"], "validation");
    // Two objects cannot promise 10 %.
    assert_eq!(sets["all"]["cant_tell"], 1.0);

    // A model without scores gets those of other grasps; its predictions stay.
    let heuristic = Path::new("baseline-contact");
    let half = ["--error-rate", "0.5"];
    let output = eval(heuristic, &half).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let told = stderr(&output);
    assert!(told.contains("predict conformal"), "{told}");
    let before = json(&succeed(&mut eval(heuristic, &[])));
    assert!(before["conformal"].is_null(), "{before}");
    let scored = dir.path().join("scored.onnx");
    let mut conformal = gripcast();
    conformal.args([
        "predict",
        "conformal",
        "--json",
        "baseline-contact",
        "--data",
    ]);
    conformal.arg(&data).arg("--out").arg(&scored);
    let written = json(&succeed(&mut conformal));
    assert_schema("predict conformal", &[&written]);
    assert_eq!(
        (&written["slip"], &written["stable"]),
        (&2.into(), &2.into())
    );
    let after = json(&succeed(&mut eval(&scored, &half)));
    assert_eq!(after["auroc"], before["auroc"]);
    let sets = &after["conformal"];
    let source = sets["scores_of"].as_str().unwrap();
    assert!(source.starts_with("validation of dataset "), "{source}");
    // The heuristic separates these grasps.
    assert!(sets["all"]["cant_tell"].as_f64().unwrap() < 1.0, "{sets}");
}

#[test]
fn fig6_experiment_reports_comparison() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    write_dataset(&data);
    write_part(&data, "test", (0..4).map(|n| row("test", n, n < 2)));
    let mut command = gripcast();
    command
        .args(["experiment", "fig6", "--json", "--seeds", "1"])
        .args(["--epochs", "1", "--batch-size", "4", "--fem"])
        .arg(&data)
        .arg("--out")
        .arg(dir.path().join("fig6"));
    let report = json(&succeed(&mut command));
    assert_schema("experiment fig6", &[&report]);
}

/// The dashboard on a terminal of 80×24 that `script` makes; what it printed, and how it ended.
fn on_terminal(
    flags: &str,
    data: &Path,
    out: &Path,
    q_after: Option<usize>,
) -> (String, Option<i32>) {
    let line = format!(
        "stty rows 24 cols 80; exec {} train --modality t --batch-size 4 {flags} --data {} --out {}",
        env!("CARGO_BIN_EXE_gripcast"),
        data.display(),
        out.display()
    );
    let mut terminal = Command::new("script")
        .args(["-qec", &line, "/dev/null"])
        .env("TERM", "xterm-256color")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("`script` of bsdutils is part of every Debian and Ubuntu");
    let mut printed = terminal.stdout.take().unwrap();
    let reading = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        printed.read_to_end(&mut bytes).unwrap();
        String::from_utf8_lossy(&bytes).into_owned()
    });
    let mut keys = terminal.stdin.take().unwrap();
    if let Some(epochs) = q_after {
        wait_until(&mut terminal, || metrics(out).len() >= epochs);
        keys.write_all(b"q").unwrap();
    }
    let code = terminal.wait().unwrap().code();
    (reading.join().unwrap(), code)
}

#[test]
fn dashboard_quits_on_q_and_restores_terminal() {
    const ENTERED: &str = "\u{1b}[?1049h";
    const LEFT: &str = "\u{1b}[?1049l";
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    write_dataset(&data);
    let out = dir.path().join("run");
    let (text, code) = on_terminal("--epochs 1000", &data, &out, Some(1));
    assert_eq!(code, Some(130), "{text}");
    let (before, after) = text.rsplit_once(LEFT).unwrap();
    assert!(
        before.contains(ENTERED) && before.contains("data"),
        "{text}"
    );
    assert!(
        after.contains("interrupted") && after.contains("to resume"),
        "{text}"
    );
    assert!(!RunFolder::at(&out).model().is_file());

    let out = dir.path().join("short");
    let (text, code) = on_terminal("--epochs 1", &data, &out, None);
    assert_eq!(code, Some(0), "{text}");
    let (_, after) = text.rsplit_once(LEFT).unwrap();
    assert!(
        after.contains("best epoch 1 of 1") && after.contains("model.onnx"),
        "{text}"
    );

    let (text, code) = on_terminal("--epochs 1 --headless", &data, &out, None);
    assert_eq!(code, Some(0), "{text}");
    assert!(
        !text.contains(ENTERED) && text.contains("best epoch 1 of 1"),
        "{text}"
    );
}

#[test]
fn unusable_datasets_are_explained() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |name: &str, rows: Vec<ShardRow>, words: [&str; 2]| {
        let data = dir.path().join(name);
        write_part(&data, "train", rows);
        write_part(
            &data,
            "validation",
            (0..4).map(|n| row("validation", n, n % 4 < 2)),
        );
        let out = dir.path().join(format!("{name}-run"));
        let output = train(&data, &out).output().unwrap();
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{text}");
        for words in words {
            assert!(text.contains(words), "{text}");
        }
        assert!(text.contains(name) && !out.exists(), "{text}");
    };
    refused("empty", Vec::new(), ["`train`", "no samples"]);
    let stable = (0..4).map(|n| row("train", n, true)).collect();
    refused("one-sided", stable, ["4 stable and 0 slip", "both labels"]);

    let nothing = dir.path().join("nothing");
    let output = train(&nothing, &dir.path().join("run")).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("nothing"), "{}", stderr(&output));
}
