//! States of cameras that send harmless oddities, damage, YUYV or depth without depth: what checks,
//! API and dataset say about recordings of each kind.

use std::fs;
use std::path::Path;

use gripcast_imaging::{GelContact, encode_jpeg, gel_image};
use gripcast_testing::jpeg::{damaged_frames, harmless_frames, with_restart_markers};
use serde_json::{Value, json};

use crate::daemon::{Daemon, Place};
use crate::program::{
    collect_on, grasps, gripcast, json as json_of, poll, relax_guards, script, succeed, verify,
};

const SIZE: (u32, u32) = (320, 240);
/// Roles of colour cameras, in the order of the kinds under test.
const ROLES: [&str; 3] = ["left", "right", "rgb"];

/// A recorded camera: its format, and files that repeat.
struct Recording {
    format: &'static str,
    files: Vec<Vec<u8>>,
}

/// Writes a rig of recordings that play for ten minutes; returns the rig file.
fn rig(dir: &Path, cameras: &[(&str, Recording)]) -> std::path::PathBuf {
    let (width, height) = SIZE;
    let mut rig = "schema = 1\nid = \"recorded\"\n".to_owned();
    for (role, Recording { format, files }) in cameras {
        let folder = dir.join(role);
        fs::create_dir_all(&folder).unwrap();
        let stream = json!({
            "schema": 1, "product": "recorded", "serial": role, "interface": 0, "port": "1-1",
            "format": format, "width": width, "height": height, "nominal_fps": 25.0,
            "depth_unit_m": (*role == "depth").then_some(0.001),
        });
        fs::write(folder.join("stream.json"), stream.to_string()).unwrap();
        for (number, bytes) in files.iter().enumerate() {
            fs::write(folder.join(format!("{number}.bin")), bytes).unwrap();
        }
        let frame = |k: usize| {
            let time_ns = 10_000_000_000 + k * 40_000_000;
            let file = format!("{}.bin", k % files.len());
            format!(
                "{}\n",
                json!({"file": file, "sequence": k, "driver_time_ns": time_ns})
            )
        };
        fs::write(
            folder.join("frames.jsonl"),
            (0..15_000).map(frame).collect::<String>(),
        )
        .unwrap();
        rig += &format!(
            "\n[cameras.{role}]\nsource = \"replay\"\npath = \"{role}\"\nformat = \"{format}\"\n\
             width = {width}\nheight = {height}\nfps = 25\n"
        );
        rig += match *role {
            "left" | "right" => "crop_profile = \"gsmini-seventh-v1\"\n",
            "depth" => "depth_unit_m = 0.001\n",
            _ => "",
        };
    }
    let path = dir.join("rig.toml");
    fs::write(&path, rig).unwrap();
    path
}

/// An untouched gel; frames differ in their noise only.
fn open_gel(seed: u64) -> image::RgbImage {
    let contact = GelContact {
        centre_x: 0.5,
        centre_y: 0.5,
        radius: 0.12,
        strength: 0.0,
    };
    gel_image(SIZE.0, SIZE.1, seed, contact)
}

/// Consecutive frames of a gel, whole; with restart markers.
fn gel_frames(count: u64) -> Vec<[Vec<u8>; 2]> {
    let encode = |image: &image::RgbImage| encode_jpeg(image, 85).unwrap();
    let frame = |seed| {
        let gel = open_gel(seed);
        [encode(&gel), with_restart_markers(&gel, encode)]
    };
    (0..count).map(frame).collect()
}

fn daemon_of(place: &Place, rig: &Path) -> Daemon {
    let mut command = gripcast();
    relax_guards(&mut command);
    command
        .args(["daemon", "--model", "none", "--rig"])
        .arg(rig)
        .env("GRIPCAST__DAEMON__LISTEN", "127.0.0.1:0")
        .env("GRIPCAST__DAEMON__SOCKET", place.socket())
        .env("GRIPCAST__COLLECT__DATASET", place.dataset());
    Daemon::start(&mut command)
}

/// State of a camera once it is one of `expected`; fails when it has judged many frames without.
fn state_of(daemon: &Daemon, role: &str, expected: &[&str]) -> Value {
    poll(|| {
        let state = daemon.get("/api/state");
        let cameras = state["cameras"].as_array().unwrap();
        let Some(camera) = cameras.iter().find(|camera| camera["role"] == role) else {
            return Err(state.to_string());
        };
        if expected.contains(&camera["state"].as_str().unwrap()) {
            return Ok(camera.clone());
        }
        let frames = camera["received"].as_u64().unwrap() + camera["damaged"].as_u64().unwrap();
        assert!(frames < 250, "expected {expected:?}, found {camera}");
        Err(camera.to_string())
    })
}

/// Kinds of frames by name, each as a stream of several frames.
fn streams(
    kinds: impl Fn(usize) -> Vec<(&'static str, Vec<u8>)>,
) -> Vec<(&'static str, Recording)> {
    let mut streams: Vec<(&str, Recording)> = Vec::new();
    for (name, bytes) in (0..4).flat_map(kinds) {
        match streams.iter_mut().find(|(known, _)| *known == name) {
            Some((_, stream)) => stream.files.push(bytes),
            None => streams.push((
                name,
                Recording {
                    format: "MJPG",
                    files: vec![bytes],
                },
            )),
        }
    }
    streams
}

/// Runs `test` on daemons of three kinds each: daemon, kind, role.
fn on_each(mut streams: Vec<(&'static str, Recording)>, test: impl Fn(&Daemon, &str, &str)) {
    // The last daemon gets three kinds, too.
    while !streams.is_empty() {
        let gels = gel_frames(4);
        let whole = || Recording {
            format: "MJPG",
            files: gels.iter().map(|[plain, _]| plain.clone()).collect(),
        };
        let mut names = Vec::new();
        let cameras: Vec<_> = ROLES
            .into_iter()
            .map(|role| {
                let (name, stream) = streams.pop().unwrap_or_else(|| ("whole", whole()));
                names.push(name);
                (role, stream)
            })
            .collect();
        let dir = tempfile::tempdir().unwrap();
        let place = Place::new();
        let daemon = daemon_of(&place, &rig(dir.path(), &cameras));
        for (role, name) in ROLES.into_iter().zip(names) {
            test(&daemon, name, role);
        }
    }
}

#[test]
fn harmless_bytes_leave_cameras_live_and_stay_out_of_the_dataset() {
    let gels = gel_frames(5);
    let harmless = streams(|i| harmless_frames(&gels[i][0], &gels[i][1], &gels[i + 1][0]));
    on_each(harmless, |daemon, name, role| {
        let camera = state_of(daemon, role, &["live"]);
        assert_eq!(camera["damaged"], 0, "{name}: {camera}");
        assert_eq!(daemon.get("/api/health")["ok"], true, "{name}");
    });
}

#[test]
fn damaged_cameras_are_damaged_never_unplugged() {
    let gels = gel_frames(4);
    let damaged = streams(|i| damaged_frames(&gels[i][0], &gels[i][1]));
    on_each(damaged, |daemon, name, role| {
        if name == "whole" {
            return;
        }
        let camera = state_of(daemon, role, &["damaged", "unplugged", "silent"]);
        assert_eq!(
            (&camera["state"], &camera["fraction"]),
            (&json!("damaged"), &json!(1.0)),
            "{name}"
        );
        assert!(
            camera["reason"].as_str().unwrap().contains("JPEG"),
            "{name}: {camera}"
        );
        let health = daemon.get("/api/health");
        assert_eq!(health["ok"], false, "{name}");
        let of_role = |camera: &&Value| camera["role"] == role;
        let found = health["cameras"].as_array().unwrap().iter().find(of_role);
        assert_eq!(found.unwrap()["state"], "damaged", "{name}");
    });
}

#[test]
fn seven_of_eight_frames_damaged_is_told_and_the_rest_is_collected() {
    let whole: Vec<_> = gel_frames(8).into_iter().map(|[plain, _]| plain).collect();
    let mostly_cut = whole.iter().enumerate().map(|(i, frame)| match i {
        0 => frame.clone(),
        _ => frame[..frame.len() * 6 / 10].to_vec(),
    });
    let stream = |files| Recording {
        format: "MJPG",
        files,
    };
    let cameras = [
        ("left", stream(mostly_cut.collect())),
        ("right", stream(whole)),
    ];
    let dir = tempfile::tempdir().unwrap();
    let rig = rig(dir.path(), &cameras);
    let place = Place::new();
    let daemon = daemon_of(&place, &rig);
    let camera = state_of(&daemon, "left", &["damaged", "unplugged", "silent"]);
    assert_eq!(camera["state"], "damaged", "{camera}");
    let fraction = camera["fraction"].as_f64().unwrap();
    assert!((0.7..0.95).contains(&fraction), "{camera}");
    state_of(&daemon, "right", &["live"]);
    let answer = daemon.trigger();
    assert_eq!(answer["state"]["session"]["step"], "grasp", "{answer}");

    for verb in [&["rig", "check"][..], &["doctor"]] {
        let output = gripcast()
            .args(verb)
            .args(["--json", "--seconds", "2", "--rig"])
            .arg(&rig)
            .output()
            .unwrap();
        assert!(!output.status.success(), "{verb:?}");
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(
            text.contains("of its frames are damaged"),
            "{verb:?}: {text}"
        );
        assert!(text.contains("the JPEG is truncated"), "{verb:?}: {text}");
    }
}

#[test]
fn depth_without_depth_is_saved_and_told() {
    let whole: Vec<_> = gel_frames(4).into_iter().map(|[plain, _]| plain).collect();
    let pixels = (SIZE.0 * SIZE.1) as usize;
    let gel = || Recording {
        format: "MJPG",
        files: whole.clone(),
    };
    let blind = Recording {
        format: "Z16",
        files: vec![vec![0; 2 * pixels]],
    };
    let dir = tempfile::tempdir().unwrap();
    let rig = rig(
        dir.path(),
        &[("left", gel()), ("right", gel()), ("depth", blind)],
    );
    let place = Place::new();
    let daemon = daemon_of(&place, &rig);
    let expected = ["no_valid_depth", "frozen", "unplugged", "silent"];
    let camera = state_of(&daemon, "depth", &expected);
    assert_eq!(camera["state"], "no_valid_depth", "{camera}");
    assert_eq!(camera["reconnects"], 0);
    assert_eq!(daemon.get("/api/health")["ok"], true);
    assert_eq!(daemon.trigger()["state"]["session"]["step"], "grasp");
    // The grasp may need an override, because nothing touches the gels; missing depth does not.
    poll(|| {
        let (status, refusal) = daemon.command("trigger");
        let reasons = refusal["reasons"].to_string();
        assert!(!reasons.contains("sees nothing"), "{refusal}");
        // Right after the initial frame there is no newer one yet.
        let is_saved = status == 200;
        if is_saved || refusal["can_override"] == true && daemon.command("override").0 == 200 {
            return Ok(());
        }
        Err(refusal.to_string())
    });
    let (_, grasp) = grasps(&place.dataset()).pop_first().unwrap();
    assert_eq!(grasp["grasp"]["cameras"]["depth"]["valid_fraction"], 0.0);
    let check = gripcast()
        .args(["rig", "check", "--json", "--seconds", "2", "--rig"])
        .arg(&rig)
        .output()
        .unwrap();
    let report = json_of(&check);
    let cameras = report["cameras"].as_array().unwrap();
    let depth = cameras
        .iter()
        .find(|camera| camera["role"] == "depth")
        .unwrap();
    assert_eq!(depth["state"], "no_valid_depth", "{depth}");
}

/// YUYV gels work like JPEG ones: initial frame, difference, prediction, dataset, readers.
#[test]
fn yuyv_gels_are_collected_predicted_verified_and_exported() {
    let frame = |seed| -> Vec<u8> {
        let gel = open_gel(seed);
        let grey = |pixel: &image::Rgb<u8>| (u16::from(pixel[1]) * 219 / 255 + 16) as u8;
        let pairs = gel.as_raw().chunks_exact(6);
        pairs
            .flat_map(|pair| {
                let [left, right] = [[pair[0], pair[1], pair[2]], [pair[3], pair[4], pair[5]]];
                [grey(&image::Rgb(left)), 120, grey(&image::Rgb(right)), 135]
            })
            .collect()
    };
    let yuyv = |first| Recording {
        format: "YUYV",
        files: (first..first + 4).map(frame).collect(),
    };
    let dir = tempfile::tempdir().unwrap();
    let rig = rig(dir.path(), &[("left", yuyv(0)), ("right", yuyv(10))]);
    let steps = "stop-on-refusal\nwait live\ntrigger\nwait saved\nwait contact\nwait fresh\ntrigger\nwait saved\n\
                 stable\nwait saved\nquit\n";
    let dataset = dir.path().join("d");
    let mut collect = collect_on(&rig, &script(dir.path(), steps), &dataset);
    collect
        .args(["--model", "baseline-contact"])
        .env("GRIPCAST__GUARDS__MIN_CONTACT_FRACTION", "0");
    let report = json_of(&succeed(&mut collect));
    assert_eq!(report["session"]["saved"], 1, "{report}");
    assert!(
        report["prediction"]["predictions"].as_u64().unwrap() > 0,
        "{report}"
    );
    let (id, grasp) = grasps(&dataset).pop_first().unwrap();
    let live = grasp["prediction"]["p_stable"].as_f64().unwrap();

    let file = |stage: &str, role: &str| {
        let name = grasp[stage]["cameras"][role]["file"].as_str().unwrap();
        dataset.join("grasps").join(&id).join(name)
    };
    // The recording repeats after four frames: `verify` reports a frame that both stages saved, and
    // nothing else.
    let is_repeated = |role: &&str| {
        let [initial, grasp] = ["initial", "grasp"].map(|stage| fs::read(file(stage, role)));
        initial.unwrap() == grasp.unwrap()
    };
    let repeated = ["left", "right"].iter().filter(|role| is_repeated(role));
    let verified = verify(&dataset);
    let problems = verified["problems"].as_array().unwrap();
    assert_eq!(problems.len(), repeated.count(), "{verified}");
    let mut problems = problems.iter();
    assert!(
        problems.all(|problem| problem["kind"] == "duplicate-content"),
        "{verified}"
    );

    let mut predict = gripcast();
    predict.args(["predict", "images", "--json", "--crop", "gsmini-seventh-v1"]);
    predict.args(["--model", "baseline-contact"]);
    for (flag, stage, role) in [
        ("--initial-left", "initial", "left"),
        ("--grasp-left", "grasp", "left"),
        ("--initial-right", "initial", "right"),
        ("--grasp-right", "grasp", "right"),
    ] {
        predict.arg(flag).arg(file(stage, role));
    }
    let again = json_of(&succeed(&mut predict));
    let predicted = again["p_stable"].as_f64().unwrap();
    assert!((predicted - live).abs() < 1e-6, "{predicted} for {live}");

    let out = dir.path().join("export");
    let mut export = gripcast();
    export.args(["dataset", "export", "--to", "webdataset"]);
    succeed(export.arg(&dataset).arg("--out").arg(&out));
    assert!(fs::read_dir(&out).unwrap().next().is_some());
}
