//! The command `gripcast rig` on fake device trees.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::json_schema::assert_schema;
use gripcast_testing::sysfs_tree::{Tree, d435, mini};

fn gripcast(tree: &Tree, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gripcast"))
        .arg("rig")
        .args(arguments)
        .arg("--sysfs-root")
        .arg(tree.path("sys"))
        .arg("--dev-root")
        .arg(tree.path("dev"))
        .arg("--proc-root")
        .arg(tree.path("proc"))
        .output()
        .unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Two sensors and a D435. The nodes are plain files that can be opened.
fn bench() -> Tree {
    let mut tree = Tree::new();
    tree.plug(
        mini("3-1", "GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7"),
        &[(0, 2)],
    );
    tree.plug(
        mini("3-2", "GelSight Mini R0B 28F5-K4RR", "28F5K4RR"),
        &[(0, 2)],
    );
    tree.plug(d435("4-1"), &[(0, 2), (3, 2)]);
    tree
}

#[test]
fn list_without_cameras_exits_69() {
    let output = gripcast(&Tree::new(), &["list"]);
    assert_eq!(output.status.code(), Some(69));
    assert!(output.stdout.is_empty());
    let text = stderr(&output);
    assert!(text.contains("no camera is connected"), "{text}");
    assert!(text.contains("--rig virtual"), "{text}");
    let output = gripcast(&Tree::new(), &["list", "--json"]);
    assert_eq!(output.status.code(), Some(69));
    let value: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(value["cameras"], Value::Array(Vec::new()));
}

#[test]
fn list_excludes_metadata_nodes() {
    let tree = bench();
    let output = gripcast(&tree, &["list", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let value: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_schema("rig list", &[&value]);
    let cameras = value["cameras"].as_array().unwrap();
    assert_eq!(cameras.len(), 4);
    let left = &cameras[0];
    assert_eq!(left["serial"], "2BNN4ZE7");
    assert_eq!(left["port"], "3-1");
    assert_eq!(left["bus"], 3);
    assert_eq!(left["speed_mbps"], 480);
    assert_eq!(left["vendor_id"], "0c45");
    assert_eq!(left["role_hint"], "left or right");
    assert_eq!(left["access"], "ready");
    assert_eq!(left["modes"], Value::Null);
    assert_eq!(cameras[3]["interface"], 3);
    let warning = value["warnings"][0].as_str().unwrap();
    assert!(
        warning.starts_with("2 cameras share USB bus 3"),
        "{warning}"
    );

    fs::remove_file(tree.node(0)).unwrap();
    tree.hold(4242, "cheese", 2);
    let output = gripcast(&tree, &["list"]);
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    assert!(
        text.contains("serial 2BNN4ZE7 · 0c45:636d · port 3-1 · bus 3, 480 Mbit/s"),
        "{text}"
    );
    assert!(text.contains("no device node"), "{text}");
    assert!(text.contains("in use by cheese (process 4242)"), "{text}");
}

#[test]
fn init_does_not_overwrite() {
    let tree = bench();
    let out = tree.path("bench-1.toml");
    let arguments = ["init", "--out", out.to_str().unwrap()];
    let output = gripcast(&tree, &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stderr(&output).contains("swap the two `serial` lines"));
    let written = fs::read_to_string(&out).unwrap();
    assert!(written.contains("id = \"bench-1\""), "{written}");
    assert!(written.contains("[cameras.depth]"), "{written}");

    let output = gripcast(&tree, &arguments);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("the rig file exists"));
    assert_eq!(fs::read_to_string(&out).unwrap(), written);

    let output = gripcast(&Tree::new(), &["init", "--out", "/proc/nonexistent/x.toml"]);
    assert_eq!(output.status.code(), Some(69));
}

#[test]
fn check_distinguishes_missing_and_failing_cameras() {
    let tree = bench();
    let file = tree.path("bench-1.toml");
    let rig = file.to_str().unwrap();
    gripcast(&tree, &["init", "--out", rig]);
    // The nodes are files: all cameras are present and fail.
    let output = gripcast(&tree, &["check", "--rig", rig, "--json"]);
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    let value: Value = serde_json::from_slice(&output.stdout).unwrap();
    let simulated = gripcast(
        &tree,
        &["check", "--rig", "virtual", "--seconds", "1", "--json"],
    );
    let simulated = serde_json::from_slice(&simulated.stdout).unwrap();
    assert_schema("rig check", &[&value, &simulated]);
    assert_eq!(value["rig"], "bench-1");
    let cameras = value["cameras"].as_array().unwrap();
    let roles: Vec<&str> = cameras
        .iter()
        .map(|c| c["role"].as_str().unwrap())
        .collect();
    assert_eq!(roles, ["left", "right", "rgb", "depth"]);
    assert!(
        cameras
            .iter()
            .all(|c| c["ok"] == false && c["missing"] == false)
    );
    let problem = cameras[0]["problems"][0].as_str().unwrap();
    assert!(
        problem.contains("cannot query") && problem.contains("camera left"),
        "{problem}"
    );

    let other = fs::read_to_string(&file)
        .unwrap()
        .replace("28F5K4RR", "AAAA1111");
    fs::write(&file, other).unwrap();
    let output = gripcast(&tree, &["check", "--rig", rig]);
    assert_eq!(output.status.code(), Some(69), "{}", stderr(&output));
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    assert!(
        text.contains("found GelSight Mini with serials 28F5K4RR, 2BNN4ZE7; the rig expects"),
        "{text}"
    );
    assert!(stderr(&output).contains("missing cameras: "));
}

#[test]
fn invalid_rigs_are_rejected() {
    let tree = Tree::new();
    let output = gripcast(&tree, &["check", "--rig", "virtuell"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("did you mean `virtual`?"),
        "{}",
        stderr(&output)
    );

    let file = tree.path("bad.toml");
    fs::write(&file, "schema = 1\nid = \"x\"\ncameras = {}\npedal = []\n").unwrap();
    let output = gripcast(&tree, &["check", "--rig", file.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(2));
    let text = stderr(&output);
    assert!(
        text.contains("bad.toml: line 4: unknown field `pedal`"),
        "{text}"
    );
    assert!(text.contains("did you mean `pedals`?"), "{text}");

    let output = gripcast(&tree, &["check", "--rig", "virtual", "--seconds", "0"]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn example_rig_files_are_valid() {
    let rigs = Path::new(env!("CARGO_MANIFEST_DIR")).join("calib/rigs");
    let mut checked = 0;
    for entry in fs::read_dir(rigs).unwrap() {
        let path = entry.unwrap().path();
        gripcast_capture::calibration::RigFile::load(&path).unwrap();
        checked += 1;
    }
    assert!(checked >= 2);
}

#[test]
fn twin_of_an_unplugged_camera_is_not_taken() {
    const SERIAL: &str = "200901010001";
    let mut tree = Tree::new();
    tree.plug(mini("1-2", "Tactile Cam", SERIAL), &[(0, 2)]);
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("twins.toml");
    let camera = |role: &str, port: &str| {
        format!(
            "[cameras.{role}]\nproduct = \"Tactile Cam\"\nserial = \"{SERIAL}\"\n{port}\
             format = \"MJPG\"\nwidth = 640\nheight = 480\nfps = 25\n\
             crop_profile = \"gsmini-seventh-v1\"\n"
        )
    };
    let write = |left: &str, right: &str| {
        let cameras = camera("left", left) + &camera("right", right);
        fs::write(&file, format!("schema = 1\nid = \"twins\"\n{cameras}")).unwrap();
    };
    let check = |tree: &Tree| {
        let rig = file.to_str().unwrap();
        gripcast(tree, &["check", "--json", "--seconds", "0.1", "--rig", rig])
    };
    write("port = \"1-1\"\n", "port = \"1-2\"\n");
    let output = check(&tree);
    assert_eq!(output.status.code(), Some(69), "{}", stderr(&output));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let of = |role: &str| {
        let cameras = report["cameras"].as_array().unwrap();
        let found = cameras.iter().find(|camera| camera["role"] == role);
        found.unwrap().clone()
    };
    assert_eq!(of("left")["missing"], true, "{report}");
    let problem = of("left")["problems"][0].to_string();
    assert!(
        problem.contains("no matching camera in port 1-1"),
        "{problem}"
    );
    assert!(of("left")["expected"].to_string().contains("port 1-1"));
    // The right one is there, but the fake tree has no camera behind its node.
    assert_eq!(of("right")["missing"], false, "{report}");

    write("", "port = \"1-2\"\n");
    let output = check(&tree);
    assert_eq!(output.status.code(), Some(2));
    let text = stderr(&output);
    assert!(text.contains("[cameras.left] names no `port`"), "{text}");
    assert!(text.contains("rig init` writes them"), "{text}");

    tree.plug(mini("1-1", "Tactile Cam", SERIAL), &[(0, 2)]);
    let text = stderr(&gripcast(&tree, &["list"]));
    assert!(
        text.contains("only their ports 1-2, 1-1 distinguish them"),
        "{text}"
    );
}
