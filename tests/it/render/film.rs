//! `gripcast render film`, and a rig that plays what it made.

use std::fs;

use super::{refused, render, trace};
use crate::json_schema::assert_schema;
use crate::program::{collect_on, grasps, json, script, stderr, succeed};

#[test]
fn rig_plays_clip_and_records_ground_truth() {
    let dir = tempfile::tempdir().unwrap();
    let films = dir.path().join("films");
    let words = format!("--samples 1 --size 32x24 --out {} --json", films.display());
    let report = json(&succeed(render("film", &words).arg("--trace").arg(trace())));
    assert_schema("render film", &[&report]);
    assert_eq!(report["images"][0]["name"], "mug");
    assert_eq!(fs::read_dir(&films).unwrap().count(), 5);

    let camera = |role: &str| {
        format!(
            "[cameras.{role}]\nsource = \"virtual\"\npath = \"films\"\nformat = \"MJPG\"\n\
             width = 160\nheight = 120\nfps = 25\ncrop_profile = \"gsmini-seventh-v1\"\n"
        )
    };
    let rig = dir.path().join("rig.toml");
    let text = format!(
        "schema = 1\nid = \"films\"\n{}{}",
        camera("left"),
        camera("right")
    );
    fs::write(&rig, &text).unwrap();
    let steps =
        "wait live\ninitial\nwait saved\nwait contact\nwait fresh\ngrasp\nexpect saved\nquit\n";
    let dataset = dir.path().join("d");
    let script = script(dir.path(), steps);
    let collect = |dataset: &str| collect_on(&rig, &script, &dir.path().join(dataset));
    succeed(&mut collect("d"));
    let (_, grasp) = grasps(&dataset).pop_first().unwrap();
    let truth = &grasp["truth"];
    assert_eq!(truth["film"], "mug", "{truth}");
    assert_eq!(truth["object"], "builtin:mug");
    let is_success = truth["outcome"] == "success";
    assert_eq!(truth["held"], is_success, "{truth}");

    // What is wrong with a film is said before anything is collected.
    let strip = films.join("mug.colour.jpg");
    let whole = fs::read(&strip).unwrap();
    fs::write(&strip, &whole[..whole.len() / 2]).unwrap();
    let output = collect("e").output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = stderr(&output);
    assert!(
        said.contains("mug") && said.contains("render film"),
        "{said}"
    );
    fs::write(&rig, text.replacen("path = \"films\"\n", "", 1)).unwrap();
    let said = stderr(&collect("f").output().unwrap());
    assert!(said.contains("the same clips"), "{said}");
}

#[test]
fn wrong_traces_are_explained_and_the_rest_is_made() {
    let dir = tempfile::tempdir().unwrap();
    let bad = dir.path().join("bad.bin");
    fs::write(&bad, b"not a trace").unwrap();
    let out = dir.path().join("films");
    let words = format!("--samples 1 --size 16x12 --out {}", out.display());
    let (code, said) = refused(render("film", &words).arg("--trace").arg(&bad));
    assert!(code == 1 && said.contains("bad.bin"), "{code}: {said}");
    assert_eq!(fs::read_dir(&out).unwrap().count(), 0);
    let (code, said) = refused(
        render("film", "--out x --size 0x12")
            .arg("--trace")
            .arg(&bad),
    );
    assert!(
        code == 2 && said.contains("from 1 to 8192"),
        "{code}: {said}"
    );
}
