//! `gripcast replay`: a small dataset with both engines, resumed runs, invalid input.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::{Value, json};

use crate::json_schema::assert_schema;
use crate::program::{
    collect, end_of, grasps, gripcast, json, script, stderr, succeed, wait_until,
};

/// Heights of the gripper above the center of the box, m, and outcomes. The gel reaches 12.5 mm
/// down and the box is 60 mm high, so at 45 mm the gripper closes above the box.
const GRASPS: [(f64, &str); 3] = [(0.0, "stable"), (0.01, "stable"), (0.045, "slip")];

/// Records grasps on the virtual rig and sets poses of top grasps of a box.
fn annotated_dataset(dir: &Path) -> PathBuf {
    let dataset = dir.join("d");
    let cycle = "wait no-contact\nwait fresh\ntrigger\nwait saved\nwait contact\nwait fresh\n\
                 trigger\nwait saved\nstable\nwait saved\n";
    let steps = format!(
        "object box\nwait live\n{}quit\n",
        cycle.repeat(GRASPS.len())
    );
    succeed(&mut collect(&script(dir, &steps), &dataset));
    for (id, (height, label)) in grasps(&dataset).keys().zip(GRASPS) {
        change(&dataset, id, |record| {
            record["outcome"] = json!(label);
            record["pose"] = json!({
                "t_m": [0.0, 0.0, height],
                "q_wxyz": [0.0, 1.0, 0.0, 0.0],
                "frame": "t_object_gripper",
                "covariance": null,
                "reprojection_px": null,
                "corrected_by_hand": true,
            });
        });
    }
    dataset
}

fn change(dataset: &Path, id: &str, change: impl FnOnce(&mut Value)) {
    let path = dataset.join("grasps").join(id).join("grasp.json");
    let mut record: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut record);
    fs::write(path, serde_json::to_vec_pretty(&record).unwrap()).unwrap();
}

fn objects(dir: &Path) -> PathBuf {
    let folder = dir.join("objects");
    fs::create_dir_all(&folder).unwrap();
    let text = "schema = 1\nmesh = \"builtin:box\"\nmass_kg = 0.06\n";
    fs::write(folder.join("box.toml"), text).unwrap();
    folder
}

fn replay(dataset: &Path, objects: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = gripcast();
    command
        .arg("replay")
        .arg(dataset)
        .arg("--objects")
        .arg(objects);
    command.args([
        "--gel",
        "coarse",
        "--friction",
        "0.4",
        "--stop-force-n",
        "20",
    ]);
    command.args([
        "--rigid-friction",
        "0.25,0.4",
        "--rigid-force-n",
        "10",
        "--resolution",
        "32",
    ]);
    command.arg("--out").arg(out).args(more);
    command
}

fn report(out: &Path) -> Value {
    serde_json::from_slice(&fs::read(out.join("report.json")).unwrap()).unwrap()
}

/// Tells whether a case is finished.
fn has_case(cases: &Path) -> bool {
    let folders = fs::read_dir(cases).into_iter().flatten().flatten();
    let mut files = folders.flat_map(|folder| fs::read_dir(folder.path()).into_iter().flatten());
    files.any(|file| {
        file.unwrap()
            .path()
            .extension()
            .is_some_and(|end| end == "json")
    })
}

/// Outcomes by grasp, engine and setting, with curves.
fn outcomes(report: &Value) -> Vec<Value> {
    let grasps = report["grasps"].as_array().unwrap();
    grasps
        .iter()
        .map(|grasp| {
            let replays = grasp["replays"].as_array().unwrap();
            json!([
                grasp["id"],
                replays
                    .iter()
                    .map(|r| json!([r["cells"], r["curves"]]))
                    .collect::<Vec<_>>()
            ])
        })
        .collect()
}

#[test]
fn resumed_replay_gives_the_same_outcomes() {
    let dir = tempfile::tempdir().unwrap();
    let (dataset, objects) = (annotated_dataset(dir.path()), objects(dir.path()));
    let whole = dir.path().join("whole");
    let output = replay(&dataset, &objects, &whole, &["--json"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let summary = json(&output);
    // Whether a pair of tactile images can be compared depends on the frames that were collected.
    let with_metrics = |value: Value| {
        let mut summary = summary.clone();
        for grasp in summary["grasps"].as_array_mut().unwrap() {
            for pair in grasp["tactile"].as_array_mut().into_iter().flatten() {
                for metric in ["contact_iou", "fve", "l1", "psnr_db"] {
                    pair[metric] = value.clone();
                }
            }
        }
        summary
    };
    let [absent, present] = [Value::Null, json!(0.5)].map(with_metrics);
    assert_schema("replay", &[&summary, &absent, &present]);
    assert_eq!(summary["grasps"].as_array().unwrap().len(), GRASPS.len());
    assert_eq!(summary["dataset"]["reality"]["kind"], "simulated");
    let complete = report(&whole);
    assert_eq!(complete["engines"][0]["name"], "fem");
    assert_eq!(
        complete["engines"][0]["scores"]["paper"]["all"]["agree"],
        GRASPS.len(),
        "{summary}"
    );
    assert_eq!(complete["engines"][1]["name"], "rigid");
    for grasp in complete["grasps"].as_array().unwrap() {
        let image = |value: &Value| {
            value
                .as_str()
                .unwrap()
                .starts_with("data:image/jpeg;base64,")
        };
        if grasp["replays"][0]["case"]["outcome"] != "miss" {
            assert!(image(&grasp["view"]["sim"]));
            assert_eq!(grasp["tactile"].as_array().unwrap().len(), 2);
        }
    }
    let page = fs::read_to_string(whole.join("report.html")).unwrap();
    assert!(page.contains("simulated") && page.len() > 20_000);

    // Stopped after the first case and resumed.
    let stopped = dir.path().join("stopped");
    let more = ["--jobs", "1", "--no-images"];
    let mut child = replay(&dataset, &objects, &stopped, &more)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    wait_until(&mut child, || has_case(&stopped.join("cases")));
    Command::new("kill")
        .arg(child.id().to_string())
        .status()
        .unwrap();
    assert_eq!(end_of(&mut child).code(), Some(75));
    assert!(!stopped.join("report.json").exists());
    succeed(&mut replay(&dataset, &objects, &stopped, &more));
    let resumed = report(&stopped);
    let cases = resumed["cost"]["cases"].as_u64().unwrap();
    assert!(resumed["cost"]["simulated_now"].as_u64().unwrap() < cases);
    assert_eq!(outcomes(&resumed), outcomes(&complete));

    let old = whole.join("report.json");
    let more = ["--no-images", "--compare", old.to_str().unwrap()];
    succeed(&mut replay(&dataset, &objects, &stopped, &more));
    let compared = report(&stopped);
    assert_eq!(compared["cost"]["simulated_now"], 0);
    assert_eq!(compared["changes"]["outcomes"], json!([]));
}

#[test]
fn excluded_grasps_give_exit_code_3() {
    let dir = tempfile::tempdir().unwrap();
    let (dataset, objects) = (annotated_dataset(dir.path()), objects(dir.path()));
    let ids: Vec<String> = grasps(&dataset).into_keys().collect();
    change(&dataset, &ids[0], |record| record["object"] = json!("bax"));
    change(&dataset, &ids[1], |record| record["pose"] = json!(null));
    let out = dir.path().join("out");
    let more = ["--engine", "rigid", "--no-images"];
    let output = replay(&dataset, &objects, &out, &more).output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    let left_out = report(&out)["left_out"].clone();
    assert_eq!(left_out.as_array().unwrap().len(), 2);
    assert!(
        left_out[0]["reason"]
            .as_str()
            .unwrap()
            .contains("nearest name is box")
    );
    assert!(
        left_out[1]["reason"]
            .as_str()
            .unwrap()
            .contains("gripcast annotate")
    );
    let counted = replay(&dataset, &objects, &out, &["--dry-run"])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&counted.stdout).into_owned();
    assert!(
        text.contains("1 of 3 grasps can be replayed: 3 cases"),
        "{text}"
    );
}

/// `replay` with the measured forces, rigid engine only.
fn replay_measured(dataset: &Path, objects: &Path, out: &Path) -> Output {
    let mut command = gripcast();
    command
        .arg("replay")
        .arg(dataset)
        .arg("--objects")
        .arg(objects);
    command.args([
        "--engine",
        "rigid",
        "--rigid-friction",
        "0.4",
        "--resolution",
        "32",
    ]);
    command
        .args(["--force", "measured", "--no-images", "--out"])
        .arg(out);
    command.output().unwrap()
}

#[test]
fn measured_forces_replace_the_search() {
    let dir = tempfile::tempdir().unwrap();
    let (dataset, objects) = (annotated_dataset(dir.path()), objects(dir.path()));
    let ids: Vec<String> = grasps(&dataset).into_keys().collect();
    let force = |normal_n: f64| {
        let of_gel = |n: f64| {
            json!({
                "normal_n": n,
                "normal_std_n": 1.0,
                "shear_n": null,
                "shear_std_n": null,
                "is_calibrated": true,
            })
        };
        json!({"left": of_gel(normal_n - 1.0), "right": of_gel(normal_n + 1.0)})
    };
    for (id, normal_n) in ids.iter().zip([8.0, 14.0]) {
        change(&dataset, id, |record| {
            record["grasp"]["force"] = force(normal_n)
        });
    }
    change(&dataset, &ids[2], |record| {
        record["grasp"].as_object_mut().unwrap().remove("force");
    });
    let out = dir.path().join("out");
    let output = replay_measured(&dataset, &objects, &out);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    let report = report(&out);
    // The upper median.
    assert_eq!(report["engines"][0]["forces_n"], json!([14.0]));
    let of_grasps = report["grasps"].as_array().unwrap().iter();
    let used: Vec<f64> = of_grasps
        .map(|grasp| grasp["replays"][0]["cells"][0]["force_n"].as_f64().unwrap())
        .collect();
    assert_eq!(used, [8.0, 14.0]);
    let reason = report["left_out"][0]["reason"].as_str().unwrap();
    assert!(reason.contains("no measured force"), "{reason}");

    for id in &ids {
        change(&dataset, id, |record| {
            record["grasp"].as_object_mut().unwrap().remove("force");
        });
    }
    let output = replay_measured(&dataset, &objects, &dir.path().join("none"));
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("no grasp has a measured force"), "{text}");
    let more = ["--force", "measured"];
    let output = replay(&dataset, &objects, &out, &more).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
}

#[test]
fn invalid_arguments_are_explained() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let check = |arguments: &[&str], code: i32, message: &str| {
        let output: Output = gripcast().arg("replay").args(arguments).output().unwrap();
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{text}");
        assert!(text.contains(message), "{text}");
    };
    check(&[], 2, "replay demo");
    check(&[&path("nothing")], 2, "--objects");
    check(&[&path("nothing"), "--objects", &path("o")], 1, "nothing");
    check(&["demo", "--friction", "-1"], 2, "above 0");
    fs::write(path("old.json"), "{}").unwrap();
    let old = path("old.json");
    let compare = ["--compare", &old];
    let data = path("d");
    check(
        &[&[data.as_str(), "--objects", "o"], &compare[..]].concat(),
        1,
        "report.json",
    );
}
