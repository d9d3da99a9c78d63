//! `gripcast render clip`, and a virtual rig that plays the result.

use std::fs;

use super::{refused, render, trace};
use crate::json_schema::assert_schema;
use crate::program::{collect_on, grasps, json, script, stderr, succeed};

#[test]
fn rig_plays_clip_and_writes_ground_truth() {
    let dir = tempfile::tempdir().unwrap();
    let clips = dir.path().join("clips");
    let words = format!("--spp 1 --size 32x24 --out {} --json", clips.display());
    let report = json(&succeed(render("clip", &words).arg("--trace").arg(trace())));
    assert_schema("render clip", &[&report]);
    assert_eq!(report["images"][0]["name"], "mug");
    assert_eq!(fs::read_dir(&clips).unwrap().count(), 5);

    let camera = |role: &str| {
        format!(
            "[cameras.{role}]\nsource = \"virtual\"\npath = \"clips\"\nformat = \"MJPG\"\n\
             width = 160\nheight = 120\nfps = 25\ncrop_profile = \"gsmini-seventh-v1\"\n"
        )
    };
    let rig = dir.path().join("rig.toml");
    let text = format!(
        "schema = 1\nid = \"clips\"\n{}{}",
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
    assert_eq!(truth["clip"], "mug", "{truth}");
    assert_eq!(truth["object"], "builtin:mug");
    let is_success = truth["outcome"] == "success";
    assert_eq!(truth["stable"], is_success, "{truth}");

    // A damaged clip is reported before collection starts.
    let strip = clips.join("mug.colour.jpg");
    let whole = fs::read(&strip).unwrap();
    fs::write(&strip, &whole[..whole.len() / 2]).unwrap();
    let output = collect("e").output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let message = stderr(&output);
    assert!(
        message.contains("mug") && message.contains("render clip"),
        "{message}"
    );
    fs::write(&rig, text.replacen("path = \"clips\"\n", "", 1)).unwrap();
    let message = stderr(&collect("f").output().unwrap());
    assert!(message.contains("the same clips"), "{message}");
}

#[test]
fn invalid_trace_or_size_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let bad = dir.path().join("bad.bin");
    fs::write(&bad, b"not a trace").unwrap();
    let out = dir.path().join("clips");
    let words = format!("--spp 1 --size 16x12 --out {}", out.display());
    let (code, message) = refused(render("clip", &words).arg("--trace").arg(&bad));
    assert!(
        code == 1 && message.contains("bad.bin"),
        "{code}: {message}"
    );
    assert_eq!(fs::read_dir(&out).unwrap().count(), 0);
    let (code, message) = refused(
        render("clip", "--out x --size 0x12")
            .arg("--trace")
            .arg(&bad),
    );
    assert!(
        code == 2 && message.contains("from 1 to 8192"),
        "{code}: {message}"
    );
}
