//! Names and settings at every door, corrections of saved grasps, and the start report.

use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use crate::daemon::Place;
use crate::json_schema::assert_schema;
use crate::program::{collect, collect_on, grasps, gripcast, script, stderr, succeed, verify};

/// One grasp of the object `mug`.
const ONE_GRASP: &str = "wait live\nobject mug\nwait fresh\ninitial\nexpect saved\nwait contact\n\
                         grasp\nexpect saved\nslip\nexpect saved\n";

/// Collects with a script; returns the closing report and the lines.
fn run(command: &mut Command) -> (Value, String) {
    let output = succeed(command.env("GRIPCAST__GUARDS__MIN_CONTACT_FRACTION", "0"));
    (crate::program::json(&output), stderr(&output))
}

fn subjects(report: &Value) -> Vec<&str> {
    let findings = report["start_report"].as_array().unwrap();
    let subjects = findings.iter().map(|finding| &finding["subject"]);
    subjects.map(|subject| subject.as_str().unwrap()).collect()
}

/// A virtual rig of small cameras.
fn other_rig(dir: &Path) -> std::path::PathBuf {
    let camera = "source = \"virtual\"\nformat = \"MJPG\"\nwidth = 320\nheight = 240\nfps = 25.0\n\
                  crop_profile = \"gsmini-seventh-v1\"\n";
    let text =
        format!("schema = 1\nid = \"other\"\n[cameras.left]\n{camera}[cameras.right]\n{camera}");
    let path = dir.join("other.toml");
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn start_report_names_default_object_other_rig_and_unreadable_records() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("d");
    let steps = script(dir.path(), &format!("{ONE_GRASP}quit\n"));
    let (report, lines) = run(&mut collect(&steps, &dataset));
    assert_eq!(subjects(&report), ["object"], "{lines}");
    assert!(
        lines.contains("WARNING the object still has the default name"),
        "{lines}"
    );

    let (report, lines) = run(collect(&steps, &dataset).args(["--seed", "2"]));
    let found = subjects(&report);
    assert!(
        !found.contains(&"rig") && !found.contains(&"cameras"),
        "{lines}"
    );
    assert!(found.contains(&"free_space"), "{lines}");

    let other = other_rig(dir.path());
    let broken = dataset
        .join("grasps")
        .join(grasps(&dataset).keys().next().unwrap());
    std::fs::write(broken.join("grasp.json"), "{").unwrap();
    let (report, lines) = run(collect_on(&other, &steps, &dataset).args(["--seed", "3"]));
    let found = subjects(&report);
    for subject in ["rig", "cameras", "unreadable"] {
        assert!(found.contains(&subject), "{subject}: {lines}");
    }
    assert!(lines.contains("rig other, but the dataset's newest grasp is from rig virtual"));
}

#[test]
fn last_grasp_is_edited_by_script_and_all_grasps_by_command() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("d");
    let steps = format!(
        "{ONE_GRASP}edit last object jar\nexpect saved\nedit last operator Ada\nexpect saved\n\
         undo\nexpect saved\nquit\n"
    );
    run(&mut collect(&script(dir.path(), &steps), &dataset));
    let record = grasps(&dataset).into_values().next().unwrap();
    assert_eq!(
        (&record["object"], &record["operator"]),
        (&json!("jar"), &json!(""))
    );

    let edit = |arguments: &[&str]| {
        let mut command = gripcast();
        command
            .args(["dataset", "edit", "--json"])
            .arg(&dataset)
            .args(arguments);
        command.output().unwrap()
    };
    let planned = edit(&[
        "--all-of",
        "jar",
        "--object",
        "  tea\u{a0}cup ",
        "--dry-run",
    ]);
    assert_eq!(
        crate::program::json(&planned)["changed"][0]["before"]["object"],
        "jar"
    );
    let done = edit(&["--all-of", "jar", "--object", "tea cup", "--scene", "lab"]);
    assert!(done.status.success(), "{}", stderr(&done));
    let [planned, done] = [&planned, &done].map(crate::program::json);
    assert_schema("dataset edit", &[&planned, &done]);
    let (id, record) = grasps(&dataset).into_iter().next().unwrap();
    assert_eq!(
        (&record["object"], &record["scene"]),
        (&json!("tea cup"), &json!("lab"))
    );
    assert_eq!(verify(&dataset)["problems"], json!([]));
    for (arguments, code) in [
        (vec!["--all-of", "jar", "--object", "cup"], 66),
        (vec!["--object", "cup"], 2),
        (vec![id.as_str()], 2),
        (vec![id.as_str(), "--object", ""], 2),
        (vec!["../7f3a", "--object", "cup"], 2),
    ] {
        let output = edit(&arguments);
        let found = output.status.code();
        let is_refused = found == Some(code) || (code == 66 && found != Some(0));
        assert!(is_refused, "{arguments:?}: {found:?} {}", stderr(&output));
    }
}

#[test]
fn api_edits_names_of_a_grasp_and_undoes_them_together() {
    let place = Place::new();
    let daemon = place.daemon();
    let named = json!({"name": "Gro\u{308}\u{df}e  1"});
    let (status, body) = daemon.ask("PUT", "/api/object", Some(&named));
    let answer: Value = serde_json::from_slice(&body).unwrap();
    assert_eq!(
        (status, &answer["state"]["session"]["object"]),
        (200, &json!("Gr\u{f6}\u{df}e 1"))
    );
    let id = daemon.grasp("stable");
    let path = format!("/api/grasps/{id}");
    let patch = |body: Value| {
        let (status, body) = daemon.ask("PATCH", &path, Some(&body));
        (status, serde_json::from_slice::<Value>(&body).unwrap())
    };
    let (status, answer) = patch(json!({
        "object": "cup", "scene": "lab", "operator": "Ada",
        "sender": {"request_id": "edit-1", "age_ms": 1.5},
    }));
    assert_eq!(status, 200, "{answer}");
    assert_eq!(answer["state"]["session"]["last"]["object"], "cup");
    let record = daemon.get(&path);
    assert_eq!(
        [&record["object"], &record["scene"], &record["operator"]],
        ["cup", "lab", "Ada"]
    );
    let listed = daemon.get("/api/grasps?object=%20cup");
    assert_eq!(listed["grasps"][0]["id"], id, "{listed}");
    let (status, _) = daemon.command("undo");
    assert_eq!(status, 200);
    let record = daemon.get(&path);
    assert_eq!(record["object"], "Gr\u{f6}\u{df}e 1");
    let (status, _) = daemon.command(&format!("edit {id} operator Bo"));
    assert_eq!(
        (status, &daemon.get(&path)["operator"]),
        (200, &json!("Bo"))
    );
    let (status, _) = patch(json!({"operator": ""}));
    assert_eq!((status, &daemon.get(&path)["operator"]), (200, &json!("")));
    for body in [
        json!({}),
        json!({"object": ""}),
        json!({"object": " \u{200d}"}),
        json!({"object": "a\nb"}),
        json!({"outcome": "slip"}),
    ] {
        assert_eq!(patch(body.clone()).0, 422, "{body}");
    }
    let missing = daemon.ask(
        "PATCH",
        "/api/grasps/missing",
        Some(&json!({"object": "cup"})),
    );
    assert_eq!(missing.0, 404);
    let state = daemon.get("/api/state");
    assert!(state["start_report"].is_array(), "{state}");
    assert_eq!(daemon.stop(), Some(0));
    assert_eq!(verify(&place.dataset())["problems"], json!([]));
}

#[test]
fn invalid_settings_and_names_end_with_their_source() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("c.toml");
    let refused = |command: &mut Command, expected: &[&str]| {
        let output = command.output().unwrap();
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{command:?}\n{text}");
        for part in expected {
            assert!(text.contains(part), "{part}: {text}");
        }
    };
    for (key, value) in [
        ("max_skew_ms", "-1"),
        ("max_skew_ms", "nan"),
        ("max_frame_age_ms", "inf"),
    ] {
        std::fs::write(&file, format!("[guards]\n{key} = {value}\n")).unwrap();
        let mut command = gripcast();
        command.args(["config", "show", "--config"]).arg(&file);
        refused(&mut command, &[key, "c.toml:2", "expected", "found"]);
        let variable = format!("GRIPCAST__GUARDS__{}", key.to_uppercase());
        let mut command = gripcast();
        command.args(["config", "show"]).env(&variable, value);
        refused(&mut command, &[key, &variable]);
    }
    let mut command = gripcast();
    command
        .args(["config", "show"])
        .env("GRIPCAST__COLLECT__OBJECT", " ");
    refused(&mut command, &["GRIPCAST__COLLECT__OBJECT", "object name"]);
    for object in ["", "mug\nblue", "mug\u{202e}"] {
        let mut command = gripcast();
        command.args(["collect", "--rig", "virtual", "--object", object]);
        refused(&mut command, &["--object"]);
    }
}
