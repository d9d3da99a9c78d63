//! Annotation of grasps of the virtual rig, live and from the dataset, compared with the truth.

use std::fs;
use std::path::Path;

use gripcast_pose::BoardFile;
use serde_json::{Value, json};

use crate::json_schema::assert_schema;
use crate::program::{collect_on, grasps, gripcast, script, stderr, succeed, verify};

/// One grasp per built-in clip.
const GRASPS: usize = 8;

fn annotate(dataset: &Path, more: &[&str]) -> std::process::Output {
    let mut command = gripcast();
    command
        .arg("annotate")
        .arg(dataset)
        .arg("--json")
        .args(more);
    command.output().unwrap()
}

fn summary(output: &std::process::Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", stderr(output)))
}

fn count(summary: &Value, what: &str) -> usize {
    summary[what].as_array().unwrap().len()
}

fn change(dataset: &Path, id: &str, change: impl FnOnce(&mut Value)) {
    let path = dataset.join("grasps").join(id).join("grasp.json");
    let mut record: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut record);
    fs::write(path, serde_json::to_vec_pretty(&record).unwrap()).unwrap();
}

fn collected(dir: &Path) -> std::path::PathBuf {
    let dataset = dir.join("d");
    let cycle = "wait no-contact\nwait fresh\ntrigger\nwait saved\nwait contact\nwait fresh\n\
                 trigger\nwait saved\nstable\nwait saved\n";
    let steps = format!("wait live\n{}quit\n", cycle.repeat(GRASPS));
    let steps = script(dir, &steps);
    succeed(&mut collect_on(
        Path::new("virtual-external"),
        &steps,
        &dataset,
    ));
    dataset
}

#[test]
fn poses_of_the_virtual_rig_are_accurate() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = collected(dir.path());
    let live = grasps(&dataset);
    assert_eq!(live.len(), GRASPS);
    let with_pose = live.values().filter(|g| g["pose"].is_object()).count();
    assert!(
        with_pose > 0,
        "no grasp was annotated while it was collected"
    );
    for grasp in live.values().filter(|g| g["pose"].is_object()) {
        let keys = &grasp["boards"];
        for key in [&keys["sheet"], &keys["tags"]] {
            let file = format!("calibration/{}.toml", key.as_str().unwrap());
            assert!(dataset.join(file).is_file());
        }
        for frame in grasp["pose"]["quality"]["frames"].as_array().unwrap() {
            assert!(
                grasp["files"][frame.as_str().unwrap()].is_object(),
                "{frame}"
            );
        }
    }
    let clean = verify(&dataset);
    assert_eq!(clean["problems"], json!([]), "{clean}");

    let output = annotate(&dataset, &["--again"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let done = summary(&output);
    assert_schema("annotate", &[&done]);
    assert_eq!(count(&done, "annotated"), GRASPS);
    let mut errors_mm = Vec::new();
    let mut errors_deg = Vec::new();
    for grasp in done["annotated"].as_array().unwrap() {
        errors_mm.push(grasp["error_mm"].as_f64().unwrap());
        errors_deg.push(grasp["error_deg"].as_f64().unwrap());
        let quality = &grasp["pose"]["quality"];
        assert_eq!(quality["ambiguous"], false, "{grasp}");
        // A computer that is busy renders the rig late.
        let late = json!("the gripper was not at rest before it closed");
        let mut notes = quality["notes"].as_array().unwrap().iter();
        assert!(notes.all(|note| *note == late), "{grasp}");
        // None without a detected finger tag.
        if let Some(opening_m) = quality["opening_m"].as_f64() {
            assert!((opening_m - 0.08).abs() < 1e-3, "{grasp}");
        }
        assert!(Path::new(grasp["overlay"].as_str().unwrap()).is_file());
    }
    println!("errors: {errors_mm:.3?} mm, {errors_deg:.4?}°");
    for errors in [&mut errors_mm, &mut errors_deg] {
        errors.sort_by(f64::total_cmp);
    }
    // Median and maximum; `gripcast-bench pose` measures more images.
    assert!(errors_mm[GRASPS / 2] <= 0.1 && errors_deg[GRASPS / 2] <= 0.08);
    assert!(errors_mm[GRASPS - 1] <= 0.4 && errors_deg[GRASPS - 1] <= 0.2);
    let clean = verify(&dataset);
    assert_eq!(clean["problems"], json!([]), "{clean}");
    let index = fs::read_to_string(dataset.join("metadata.jsonl")).unwrap();
    assert!(
        index
            .lines()
            .all(|line| !line.contains("\"pose_t_m\":null"))
    );

    corrections_by_hand_are_kept(&dataset);
    invalid_grasp_does_not_stop_the_others(&dataset);
    wrong_boards_are_reported(&dataset, dir.path());
}

fn corrections_by_hand_are_kept(dataset: &Path) {
    let first = grasps(dataset).into_keys().next().unwrap();
    change(dataset, &first, |record| {
        record["pose"]["t_m"] = json!([0.5, 0.5, 0.5]);
        record["pose"]["corrected_by_hand"] = json!(true);
    });
    let done = summary(&annotate(dataset, &["--again", "--no-overlays"]));
    assert_eq!(done["by_hand"], json!([first]));
    assert_eq!(count(&done, "annotated"), GRASPS - 1);
    assert_eq!(
        grasps(dataset)[&first]["pose"]["t_m"],
        json!([0.5, 0.5, 0.5])
    );
    let done = summary(&annotate(dataset, &["--no-overlays"]));
    assert_eq!(
        (count(&done, "already"), count(&done, "annotated")),
        (GRASPS - 1, 0)
    );
}

fn invalid_grasp_does_not_stop_the_others(dataset: &Path) {
    let second = grasps(dataset).into_keys().nth(1).unwrap();
    let folder = dataset.join("grasps").join(&second);
    let mut kept = Vec::new();
    for entry in fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name.contains("external") && !name.starts_with("grasp.") {
            kept.push((path.clone(), fs::read(&path).unwrap()));
            fs::write(&path, [0xff, 0xd8, 0xff, 0x00]).unwrap();
        }
    }
    let before = grasps(dataset)[&second]["pose"].clone();
    let output = annotate(dataset, &["--again", "--no-overlays"]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    let done = summary(&output);
    assert_eq!(count(&done, "annotated"), GRASPS - 2);
    assert_eq!(done["failed"][0]["grasp"], json!(second));
    assert!(
        done["failed"][0]["reason"]
            .as_str()
            .unwrap()
            .contains("external")
    );
    assert_eq!(
        grasps(dataset)[&second]["pose"],
        before,
        "the pose is unchanged"
    );
    for (path, bytes) in kept {
        fs::write(path, bytes).unwrap();
    }
}

fn wrong_boards_are_reported(dataset: &Path, dir: &Path) {
    let sheet = dir.join("other.toml");
    let pdf = dir.join("other.pdf");
    succeed(
        gripcast()
            .args([
                "board",
                "make",
                "--object",
                "builtin:mug",
                "--dictionary",
                "36h11",
                "--out",
            ])
            .arg(&pdf)
            .arg("--board")
            .arg(&sheet),
    );
    let camera = dir.join("camera.toml");
    fs::write(
        &camera,
        "width = 640\nheight = 480\nfx = 600.0\nfy = 600.0\ncx = 320.0\ncy = 240.0\n\
         model = \"none\"\ncoefficients = [0.0, 0.0, 0.0, 0.0, 0.0]\n",
    )
    .unwrap();
    for (flag, file, expected) in [
        ("--sheet", sheet.to_str().unwrap(), "DICT_6X6_250"),
        ("--intrinsics", camera.to_str().unwrap(), "1280×720"),
        ("--tags", "/no/such/tags.toml", "/no/such/tags.toml"),
    ] {
        let output = annotate(dataset, &["--again", "--dry-run", flag, file]);
        assert!(!output.status.success());
        let message = stderr(&output);
        assert!(message.contains(expected), "{flag}: {message}");
    }
    // Without calibration and without boards.
    let last = grasps(dataset).into_keys().next_back().unwrap();
    let whole = grasps(dataset)[&last].clone();
    for (key, expected) in [
        ("calibration", "not calibrated"),
        ("boards", "--sheet FILE"),
    ] {
        change(dataset, &last, |record| {
            record[key] = if key == "boards" {
                Value::Null
            } else {
                json!({})
            };
        });
        let message = stderr(&annotate(dataset, &["--again", "--dry-run"]));
        assert!(message.contains(expected), "{message}");
        change(dataset, &last, |record| *record = whole.clone());
    }
    // The sheet of the first grasp, as if printed at 91 %.
    let first = grasps(dataset).into_values().next().unwrap();
    let key = first["boards"]["sheet"].as_str().unwrap().to_owned();
    let stored = dataset.join(format!("calibration/{key}.toml"));
    let mut scaled = BoardFile::load(&stored).unwrap();
    for marker in &mut scaled.board.markers {
        marker.corners_m = marker.corners_m.map(|corner| 1.1 * corner);
    }
    let file = dir.join("scaled.toml");
    fs::write(&file, scaled.to_toml()).unwrap();
    let flags = ["--again", "--dry-run", "--sheet", file.to_str().unwrap()];
    change(dataset, first["id"].as_str().unwrap(), |record| {
        record["pose"]["corrected_by_hand"] = json!(false);
    });
    let found = summary(&annotate(dataset, &flags));
    let notes = found["annotated"][0]["pose"]["quality"]["notes"].to_string();
    assert!(notes.contains("between the fingers"), "{notes}");

    let nowhere = annotate(&dir.join("nowhere"), &[]);
    assert_eq!(nowhere.status.code(), Some(1), "{}", stderr(&nowhere));
}
