//! `gripcast render tactile`.

use std::fs;

use super::calibrate::rendered_presses;
use super::{depth_png, png, refused, render, trace};
use crate::json_schema::assert_schema;
use crate::program::{json, succeed};

#[test]
fn grasp_is_rendered_with_depth_and_difference() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("images");
    let words = format!(
        "--trace {} --moment initial,grasp --depth --difference --json --out {}",
        trace().display(),
        out.display()
    );
    let report = json(&succeed(&mut render("tactile", &words)));
    assert_schema("render tactile", &[&report]);
    let images = report["images"].as_array().unwrap();
    assert_eq!(images.len(), 4);
    for image in images {
        let touched = image["contact"].as_f64().unwrap();
        let deepest = image["deepest_m"].as_f64().unwrap();
        if image["moment"] == "initial" {
            assert_eq!((touched, deepest), (0.0, 0.0));
        } else {
            assert!((0.05..0.95).contains(&touched), "{image}");
            assert!((5e-5..2e-3).contains(&deepest), "{image}");
        }
    }
    let initial = png(out.join("mug.initial.left.png"));
    let grasp = png(out.join("mug.grasp.left.png"));
    assert_eq!(grasp.dimensions(), (320, 240));
    assert!(initial != grasp, "the press must be visible");
    let depth = depth_png(out.join("mug.grasp.right.depth.png"));
    let deepest = depth.iter().max().copied().unwrap();
    let record = images
        .iter()
        .find(|p| p["side"] == "right" && p["moment"] == "grasp");
    let reported_m = record.unwrap()["deepest_m"].as_f64().unwrap();
    assert!(
        (f64::from(deepest) - 1e6 * reported_m).abs() <= 0.51,
        "{deepest} µm, {reported_m} m"
    );
    let quiet = png(out.join("mug.initial.left.difference.png"));
    assert!(quiet.iter().all(|&v| v == 128), "no change before contact");
}

#[test]
fn noise_depends_on_seed() {
    let dir = tempfile::tempdir().unwrap();
    let take = |name: &str, seed: &str| {
        let out = dir.path().join(name);
        let words = format!(
            "--trace {} --side left --seed {seed} --out {}",
            trace().display(),
            out.display()
        );
        succeed(&mut render("tactile", &words));
        fs::read(out).unwrap()
    };
    let first = take("a.png", "1");
    assert!(first == take("b.png", "1"));
    assert!(first != take("c.png", "2"));
}

#[test]
fn methods_render_different_images() {
    let dir = tempfile::tempdir().unwrap();
    let presses = rendered_presses(dir.path());
    let take = |method: &str| {
        let out = dir.path().join(method).with_extension("png");
        let words = format!(
            "--trace {} --side left --no-noise --method {method} --presses {} --out {}",
            trace().display(),
            presses.display(),
            out.display()
        );
        succeed(&mut render("tactile", &words));
        png(out)
    };
    let [object, gel, lookup] = ["object", "gel-surface", "lookup"].map(take);
    assert!(object != gel && object != lookup && gel != lookup);
}

#[test]
fn mesh_is_pressed_to_given_depth() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("press.png");
    let words = format!(
        "--object builtin:sphere --press-m 7e-4 --json --out {}",
        out.display()
    );
    let report = json(&succeed(&mut render("tactile", &words)));
    let image = &report["images"][0];
    let deepest = image["deepest_m"].as_f64().unwrap();
    assert!((deepest - 7e-4).abs() < 2e-6, "{deepest}");
    let touched = image["contact"].as_f64().unwrap();
    assert!((0.02..0.6).contains(&touched), "{touched}");
    assert_eq!(png(out).dimensions(), (320, 240));
}

#[test]
fn batch_continues_after_broken_trace() {
    let dir = tempfile::tempdir().unwrap();
    let broken = dir.path().join("broken.bin");
    let whole = fs::read(trace()).unwrap();
    fs::write(&broken, &whole[..whole.len() / 2]).unwrap();
    let out = dir.path().join("out");
    let words = format!(
        "--trace {} {} --side left --out {}",
        broken.display(),
        trace().display(),
        out.display()
    );
    let (code, message) = refused(&mut render("tactile", &words));
    assert_eq!(code, 3, "{message}");
    assert!(
        message.contains("broken.bin") && message.contains("truncated after"),
        "{message}"
    );
    assert!(out.join("mug.grasp.left.png").exists());
}

#[test]
fn invalid_input_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let trace = trace().display().to_string();
    let out = dir.path().join("x.png").display().to_string();
    let invalid = dir.path().join("not.toml");
    fs::write(&invalid, "schema = 7").unwrap();
    let cases = [
        (
            format!("--trace {trace} --out {out}"),
            2,
            "must be a folder",
        ),
        (
            format!("--trace {trace} --side left --object builtin:box --out {out}"),
            1,
            "differs from the simulated",
        ),
        (
            format!("--trace {out} --side left --out {out}"),
            1,
            "cannot read the trace",
        ),
        (
            format!(
                "--trace {trace} --side left --profile {} --out {out}",
                invalid.display()
            ),
            2,
            "schema",
        ),
        (
            format!("--object builtin:box --press-m 1 --out {out}"),
            1,
            "depth of a press",
        ),
        (
            format!("--trace {trace} --side left --mounting 45 --out {out}"),
            2,
            "0, 90, 180",
        ),
        (
            format!("--trace {trace} --side left --moment lift,grasp --out {out}"),
            2,
            "folder",
        ),
    ];
    for (words, code, expected) in cases {
        let (found, message) = refused(&mut render("tactile", &words));
        assert_eq!(found, code, "{words}: {message}");
        assert!(message.contains(expected), "{words}: {message}");
    }
}
