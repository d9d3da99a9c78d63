//! `gripcast sim grasp` as a user runs it.

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use gripcast_sim::grasp::TraceFile;
use serde_json::Value;

use crate::json_schema::assert_schema;
use crate::program::{gripcast, json, stderr, succeed};

/// A grasp on the coarse gel, as JSON.
fn grasp(object: &str, more: &str) -> Command {
    let mut command = gripcast();
    command
        .args(["sim", "grasp", "--json", "--gel", "coarse", "--object"])
        .arg(object)
        .args(more.split_whitespace());
    command
}

fn result(object: &str, more: &str) -> Value {
    json(&succeed(&mut grasp(object, more)))
}

/// Error text of a command that fails with exit code 1.
fn error_text(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(output.stdout.is_empty(), "no data on stdout");
    text
}

/// OBJ text of a closed box of 40 × 40 × 60 units, facing outwards.
fn box_obj() -> String {
    box_of([20.0, 20.0, 30.0])
}

/// OBJ text of a closed box of the given half sizes, facing outwards.
fn box_of(half: [f64; 3]) -> String {
    let mut text = String::new();
    for corner in 0..8 {
        let pick = |bit: usize, half: f64| if corner & bit == 0 { -half } else { half };
        let (x, y, z) = (pick(1, half[0]), pick(2, half[1]), pick(4, half[2]));
        text += &format!("v {x} {y} {z}\n");
    }
    for face in [
        "1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6",
    ] {
        text += &format!("f {face}\n");
    }
    text
}

fn write(dir: &Path, name: &str, text: &str) -> PathBuf {
    let path = dir.join(name);
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn mug_grasp_succeeds_through_three_stages() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let (plot, trace) = (path("f.svg"), path("f.bin"));
    let found = result(
        "builtin:mug",
        // The handle makes it 93 mm wide.
        &format!("--stop-force-n 40 --max-opening 0.1 --plot {plot} --trace {trace}"),
    );
    assert_schema("sim grasp", &[&found]);
    assert_eq!(found["outcome"], "success");
    let lifted = found["lifted_m"].as_f64().unwrap();
    assert!((0.045..0.055).contains(&lifted), "{lifted}");
    let mean = found["mean_force_n"].as_f64().unwrap();
    assert!((mean - 40.0).abs() <= 0.8, "{mean}");
    assert_eq!(found["steady"], true);
    assert!(found["wall_s"].as_f64().unwrap() > 0.0);
    assert_eq!(found["parameters"]["preset"], "paper");
    assert_eq!(found["parameters"]["material"]["young_pa"], 1e6);
    let stages: Vec<&str> = found["stages"]
        .as_array()
        .unwrap()
        .iter()
        .map(|stage| stage["stage"].as_str().unwrap())
        .collect();
    assert_eq!(stages, ["closure", "adjustment", "lift"]);

    let svg = fs::read_to_string(plot).unwrap();
    for word in [
        "closure",
        "adjustment",
        "lift",
        "F_stop 40 N",
        "builtin:mug: stable",
    ] {
        assert!(svg.contains(word), "{word}");
    }
    let file = TraceFile::from_bytes(&fs::read(trace).unwrap()).unwrap();
    assert_eq!(file.header["outcome"], "success");
    let axes = file.header["gel_axes_m"].as_array().unwrap();
    let nodes: usize = axes.iter().map(|a| a.as_array().unwrap().len()).product();
    assert_eq!(file.trace.snapshots.len(), 3);
    assert_eq!(file.trace.snapshots[1].gels[0].len(), nodes);
    assert_eq!(Some(file.trace.steps.len() as u64), found["steps"].as_u64());
}

#[test]
fn friction_decides_whether_a_box_slips() {
    // 2 μ F = 0.5 N against a weight of 1.96 N.
    let loose = result(
        "builtin:box",
        "--mass-kg 0.2 --friction 0.05 --stop-force-n 5",
    );
    assert_eq!(loose["outcome"], "slip");
    let firm = result(
        "builtin:box",
        "--mass-kg 0.2 --friction 0.4 --stop-force-n 40",
    );
    assert_eq!(firm["outcome"], "success");
}

#[test]
fn rolled_off_centre_grasp_fails_and_high_grasp_misses() {
    let lost = result(
        "builtin:sphere",
        "--roll-deg 10 --offset-y 0.018 --adjust-s 0.2",
    );
    let outcome = lost["outcome"].as_str().unwrap();
    assert!(["eject", "slip"].contains(&outcome), "{outcome}");
    assert!(lost["lifted_m"].as_f64().unwrap() < 0.02);
    let miss = result("builtin:sphere", "--height 0.08");
    assert_eq!(miss["outcome"], "miss");
    assert_eq!(miss["mean_force_n"], Value::Null);
}

#[test]
fn small_stopping_forces_hold_light_objects() {
    // 2 μ F of 0.4 N against 0.2 N, and of 1.2 N against 0.39 N.
    for flags in [
        "--stop-force-n 0.5 --mass-kg 0.02",
        "--stop-force-n 1 --mass-kg 0.04 --friction 0.6",
    ] {
        let found = result("builtin:box", &format!("{flags} --adjust-s 0.5"));
        assert_eq!(found["outcome"], "success", "{flags}: {found}");
        assert_eq!(found["steady"], true, "{flags}: {found}");
        assert_eq!(found["reached_stop_force"], true);
        let used = found["friction_use"].as_f64().unwrap();
        assert!((0.25..0.65).contains(&used), "{flags}: {used}");
    }
}

#[test]
fn bar_lost_below_its_torsional_limit_is_called_creep() {
    // A bar held 60 mm off its centre at 85 % of the torsional limit of its contact.
    let folder = tempfile::tempdir().unwrap();
    let bar = write(folder.path(), "bar.obj", &box_of([10.0, 100.0, 10.0]));
    let flags = "--unit mm --offset-y .06 --mass-kg .1768 --stop-force-n 20 --adjust-s 0.3";
    let creep = |eps_v: &str| {
        result(
            &bar.display().to_string(),
            &format!("{flags} --eps-v {eps_v}"),
        )
    };
    let lost = creep("1e-3");
    let used = lost["friction_use"].as_f64().unwrap();
    assert!((0.7..0.95).contains(&used), "{used}");
    assert_eq!(lost["outcome"], "slip");
    assert!(
        lost["warnings"].to_string().contains("lost by creep"),
        "{lost}"
    );
    let held = creep("5e-4");
    assert_eq!(held["outcome"], "success");
    assert!(held["lifted_m"].as_f64() > lost["lifted_m"].as_f64());
}

#[test]
fn object_wider_than_the_gripper_is_turned_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let wide = |y: f64| {
        let file = write(folder.path(), &format!("{y}.obj"), &box_of([60.0, y, 30.0]));
        file.display().to_string()
    };
    let output = succeed(&mut grasp(
        &wide(20.0),
        "--unit mm --adjust-s 0.05 --offset-y -.002",
    ));
    let found = json(&output);
    let opening = found["pose"]["opening_m"].as_f64().unwrap();
    assert!((opening - 0.042).abs() < 1e-9, "{opening}");
    assert!(
        found["warnings"].to_string().contains("turned by 90°"),
        "{found}"
    );
    assert!(stderr(&output).contains("turned by 90°"));
    for (y, flags) in [(60.0, "--unit mm"), (20.0, "--unit mm --yaw-deg 0")] {
        let text = error_text(&mut grasp(&wide(y), flags));
        assert!(text.contains("wider than the gripper's 90 mm"), "{text}");
        assert!(text.contains("--max-opening"), "{text}");
    }
}

#[test]
fn pose_in_the_air_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pose.json");
    let pose = r#"{"t_object_gripper": {"t_m": [0, 0, 0], "q_wxyz": [0, 1, 0, 0]},
        "t_world_object": {"t_m": [0, 0, 0.08], "q_wxyz": [1, 0, 0, 0]}}"#;
    std::fs::write(&file, pose).unwrap();
    let flags = format!("--pose {} --adjust-s 0.05", file.display());
    let output = succeed(&mut grasp("builtin:box", &flags));
    let expected = "50.0 mm above the ground";
    assert!(stderr(&output).contains(expected));
    assert!(json(&output)["warnings"].to_string().contains(expected));
}

#[test]
fn initial_penetration_is_an_outcome_with_a_hint() {
    let output = succeed(&mut grasp("builtin:box", "--width 0.03"));
    assert_eq!(json(&output)["outcome"], "penetrating_start");
    assert!(stderr(&output).contains("--width"), "{}", stderr(&output));
    let low = json(&succeed(&mut grasp("builtin:box", "--height 0.005")));
    assert_eq!(low["outcome"], "penetrating_start");
    let detail = low["detail"].as_str().unwrap();
    assert!(detail.contains("below the ground"), "{detail}");
}

#[test]
fn unconverged_grasp_exits_with_4() {
    let output = grasp("builtin:box", "--max-iterations 1").output().unwrap();
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    let found = json(&output);
    assert_eq!(found["outcome"], "not_converged");
    assert!(found["unconverged_steps"].as_u64().unwrap() > 0);
    assert!(stderr(&output).contains("did not converge"));
}

#[test]
fn results_are_bit_identical_for_any_thread_count() {
    let dir = tempfile::tempdir().unwrap();
    let trace = |name: &str, threads: &str| {
        let path = dir.path().join(name);
        let more = format!(
            "--adjust-s 0.1 --lift 0.004 --offset-y 0.012 --threads {threads} --trace {}",
            path.display()
        );
        result("builtin:sphere", &more);
        let file = TraceFile::from_bytes(&fs::read(path).unwrap()).unwrap();
        file.trace
    };
    let one = trace("a.bin", "1");
    assert_eq!(one, trace("b.bin", "2"));
    assert_eq!(one, trace("c.bin", "2"));
}

#[test]
fn pose_file_defines_the_gripper_pose() {
    let dir = tempfile::tempdir().unwrap();
    let pose = write(
        dir.path(),
        "pose.json",
        r#"{"t_object_gripper": {"t_m": [0, 0.004, 0.005], "q_wxyz": [0, 1, 0, 0]},
            "t_world_object": {"t_m": [0.1, 0, 0.03], "q_wxyz": [1, 0, 0, 0]},
            "opening_m": 0.05}"#,
    );
    let short = "--adjust-s 0.05 --lift 0.002";
    let found = result("builtin:box", &format!("{short} --pose {}", pose.display()));
    assert_eq!(found["pose"]["opening_m"], 0.05);
    assert_eq!(found["pose"]["t_world_object"]["t_m"][0], 0.1);
    let across = found["pose"]["t_object_gripper"]["t_m"][1]
        .as_f64()
        .unwrap();
    assert!((across - 0.004).abs() < 1e-12);
    assert_eq!(found["pose"]["stable_pose"], Value::Null);

    let misspelt = write(
        dir.path(),
        "misspelt.json",
        r#"{"t_object_gripper": {"t_m": [0, 0, 0], "q_wxyz": [0, 1, 0, 0]}, "opening": 0.05}"#,
    );
    let text = error_text(grasp("builtin:box", "--pose").arg(&misspelt));
    assert!(
        text.contains("`opening`") && text.contains("misspelt.json"),
        "{text}"
    );

    let buried = write(
        dir.path(),
        "buried.json",
        r#"{"t_object_gripper": {"t_m": [0, 0, 0], "q_wxyz": [0, 1, 0, 0]},
            "t_world_object": {"t_m": [0, 0, 0.01], "q_wxyz": [1, 0, 0, 0]}}"#,
    );
    let text = error_text(grasp("builtin:box", "--pose").arg(&buried));
    assert!(
        text.contains("20.0 mm into the ground") && text.contains("stable"),
        "{text}"
    );
}

#[test]
fn volume_of_overlapping_pieces_is_that_of_their_union() {
    let dir = tempfile::tempdir().unwrap();
    // Two copies of the box, one shifted by half its width.
    let one = box_obj();
    let corners = |line: &str| -> Vec<f64> {
        let numbers = line.split(' ').skip(1);
        numbers.map(|number| number.parse().unwrap()).collect()
    };
    let vertices: Vec<Vec<f64>> = one
        .lines()
        .filter(|l| l.starts_with("v "))
        .map(corners)
        .collect();
    let width = vertices
        .iter()
        .map(|v| v[0])
        .fold(f64::NEG_INFINITY, f64::max)
        - vertices.iter().map(|v| v[0]).fold(f64::INFINITY, f64::min);
    let mut text = one.clone();
    for line in one.lines() {
        let numbers = corners(line);
        text += &match line.split_once(' ') {
            Some(("v", _)) => format!(
                "v {} {} {}\n",
                numbers[0] + 0.5 * width,
                numbers[1],
                numbers[2]
            ),
            Some(("f", _)) => {
                let moved: Vec<String> = numbers
                    .iter()
                    .map(|n| (*n as usize + vertices.len()).to_string())
                    .collect();
                format!("f {}\n", moved.join(" "))
            }
            _ => String::new(),
        };
    }
    let volume = |name: &str, text: &str| {
        let path = write(dir.path(), name, text);
        let mut command = gripcast();
        command.args(["sim", "mesh", "--unit", "mm", "--json", "--object"]);
        let found = json(&succeed(command.arg(path)));
        assert_schema("sim mesh", &[&found]);
        found
    };
    let (one, two) = (volume("one.obj", &one), volume("two.obj", &text));
    let ratio = two["volume_m3"].as_f64().unwrap() / one["volume_m3"].as_f64().unwrap();
    assert!((ratio - 1.5).abs() < 0.015, "{two}");
    // Of the volume of the union.
    let overlap = two["overlap"].as_f64().unwrap();
    assert!((overlap - 1.0 / 3.0).abs() < 0.01, "{two}");
    assert_eq!(one["warnings"].as_array().unwrap().len(), 0);
}

#[test]
fn mesh_files_are_checked_repaired_or_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let text = box_obj();
    let good = write(dir.path(), "box.obj", &text);
    let good = good.display().to_string();
    let short = "--adjust-s 0.05 --lift 0.002";

    let message = error_text(&mut grasp(&good, ""));
    assert!(message.contains("--unit mm"), "{message}");
    let found = result(&good, &format!("--unit mm {short}"));
    let height = found["object"]["size_m"][2].as_f64().unwrap();
    assert!((height - 0.06).abs() < 1e-9);
    let half = result(&good, &format!("--unit mm --scale 0.5 {short}"));
    let height = half["object"]["size_m"][2].as_f64().unwrap();
    assert!((height - 0.03).abs() < 1e-9);

    let inverted: String = text
        .lines()
        .map(|line| match line.strip_prefix("f ") {
            Some(face) => {
                let corners: Vec<&str> = face.split(' ').rev().collect();
                format!("f {}\n", corners.join(" "))
            }
            None => format!("{line}\n"),
        })
        .collect();
    let inverted = write(dir.path(), "inverted.obj", &inverted);
    let output = succeed(&mut grasp(
        &inverted.display().to_string(),
        &format!("--unit mm {short}"),
    ));
    let warnings = json(&output)["warnings"].to_string();
    assert!(warnings.contains("faced inwards"), "{warnings}");
    assert!(!warnings.contains("creep"), "{warnings}");
    assert!(
        stderr(&output).contains("inverted.obj"),
        "{}",
        stderr(&output)
    );

    let rejected = |name: &str, text: &str| {
        let path = write(dir.path(), name, text);
        error_text(&mut grasp(
            &path.display().to_string(),
            "--unit mm --repair strict",
        ))
    };
    let open = text.rsplit_once("f ").unwrap().0;
    let message = rejected("open.obj", open);
    assert!(
        message.contains("closed") && message.contains("open.obj"),
        "{message}"
    );
    let message = rejected("nan.obj", &text.replacen("v -20", "v nan", 1));
    assert!(
        message.contains("finite") || message.contains("number"),
        "{message}"
    );
    let message = rejected("empty.obj", "");
    assert!(message.contains("empty"), "{message}");
    let flat = text.replace(" 30\n", " 0\n").replace(" -30\n", " 0\n");
    rejected("flat.obj", &flat);
    // The same box again, shifted into itself.
    let twice = format!("{text}{}", shifted(&text));
    let message = rejected("twice.obj", &twice);
    assert!(message.contains("intersects itself"), "{message}");
    let tiny = error_text(&mut grasp(&good, "--unit mm --scale 0.001"));
    assert!(tiny.contains("--unit m"), "{tiny}");
}

/// Lines that append the box of [`box_obj`] again, shifted into itself.
fn shifted(text: &str) -> String {
    let mut more = String::new();
    for line in text.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        match words[0] {
            "v" => {
                let at = |i: usize| words[i].parse::<f64>().unwrap();
                more += &format!("v {} {} {}\n", at(1) + 10.0, at(2) + 10.0, at(3) + 5.0);
            }
            _ => {
                let corners = words[1..].iter().map(|w| w.parse::<u32>().unwrap() + 8);
                let corners: Vec<String> = corners.map(|c| c.to_string()).collect();
                more += &format!("f {}\n", corners.join(" "));
            }
        }
    }
    more
}

#[test]
fn invalid_numbers_are_rejected() {
    for flags in [
        "--mass-kg=0",
        "--mass-kg=-1",
        "--mass-kg=nan",
        "--friction=-0.4",
        "--width=0",
        "--yaw-deg=inf",
        "--scale=0",
    ] {
        let output = grasp("builtin:box", flags).output().unwrap();
        let (option, _) = flags.split_once('=').unwrap();
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{flags}: {text}");
        assert!(text.contains(option), "{flags}: {text}");
    }
    let cases = [
        ("--width 3", "opening"),
        ("--mass-kg 60", "at most 10 kg"),
        ("--mass-kg 9", "osmium"),
        ("--stable-pose 99", "stable pose 99"),
    ];
    for (flags, word) in cases {
        let text = error_text(&mut grasp("builtin:box", flags));
        assert!(text.contains(word), "{flags}: {text}");
    }
    for object in ["builtin:bx", "nowhere.obj", "box"] {
        let text = error_text(&mut grasp(object, ""));
        assert!(text.contains('→'), "{object}: {text}");
    }
}

#[test]
fn usage_errors_are_reported_before_the_simulation() {
    let usage = |more: &str| -> Output {
        let output = grasp("builtin:box", more).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{more}: {}", stderr(&output));
        output
    };
    let text = stderr(&usage("--trace f.csv"));
    assert!(text.contains(".json or .bin"), "{text}");
    usage("--plot f.png");
    usage("--stop-force-n -4");
    usage("--dt 0");
    usage("--unit parsec");
    let text = error_text(&mut grasp("builtin:box", "--plot /nowhere/at/all/f.svg"));
    assert!(text.contains("/nowhere/at/all"), "{text}");
}

#[test]
fn ctrl_c_ends_a_grasp_with_130() {
    let mut command = gripcast();
    command.args([
        "sim",
        "grasp",
        "--gel",
        "fine",
        "--object",
        "builtin:bottle",
    ]);
    let mut child = command
        .args(["--dt", "0.0001", "--adjust-s", "1000"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    // The handler for Ctrl-C is installed before this line is printed.
    let first = lines.next().unwrap().unwrap();
    assert!(first.contains("simulating"), "{first}");
    let id = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(id, rustix::process::Signal::INT).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
}
