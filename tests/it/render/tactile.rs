//! `gripcast render tactile`.

use std::fs;

use super::calibrate::rendered_presses;
use super::{depth_png, png, refused, render, trace};
use crate::json_schema::assert_schema;
use crate::program::{json, succeed};
use gripcast_base::files::npy::Array;

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

/// Rows, columns and values of an array of gel markers.
fn marker_array(path: std::path::PathBuf) -> (usize, usize, Vec<f32>) {
    let array = Array::from_npy(&fs::read(path).unwrap()).unwrap();
    let [rows, columns, 5] = array.shape() else {
        panic!("{:?}", array.shape());
    };
    (*rows, *columns, array.values().to_vec())
}

#[test]
fn gel_markers_are_drawn_and_their_positions_written() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("images");
    let words = format!(
        "--trace {} --profile gelsight-mini-markers --moment initial,grasp,lift --markers image,field \
         --json --out {}",
        trace().display(),
        out.display()
    );
    let report = json(&succeed(&mut render("tactile", &words)));
    let other = format!(
        "--trace {} --depth --difference --json --out {}",
        trace().display(),
        dir.path().join("other").display()
    );
    let other = json(&succeed(&mut render("tactile", &other)));
    assert_schema("render tactile", &[&report, &other]);
    assert_eq!(report["images"].as_array().unwrap().len(), 6);
    let read = |moment: &str| marker_array(out.join(format!("mug.{moment}.left.markers.npy")));
    let (rows, columns, rest) = read("initial");
    assert!(
        (6..=8).contains(&rows) && (9..=11).contains(&columns),
        "{rows} {columns}"
    );
    let moved = |values: &[f32]| {
        let lengths = values.chunks_exact(5).map(|m| m[2].hypot(m[3]));
        lengths.filter(|d| d.is_finite()).fold(0.0, f32::max)
    };
    assert!(moved(&rest) == 0.0, "no motion before contact");
    let (grasp, lift) = (moved(&read("grasp").2), moved(&read("lift").2));
    assert!(
        (0.2..30.0).contains(&grasp) && (0.2..40.0).contains(&lift),
        "{grasp} {lift}"
    );
    // The dots are dark, and where the array says.
    let image = png(out.join("mug.initial.left.png"));
    for marker in rest.chunks_exact(5).filter(|m| m[4] == 1.0) {
        let [x, y] = [marker[0].round() as u32, marker[1].round() as u32];
        if (1..319).contains(&x) && (1..239).contains(&y) {
            let green = image.get_pixel(x, y)[1];
            assert!(green < 60, "{green} at {x}, {y}");
        }
    }
}

#[test]
fn field_alone_draws_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("press.png");
    let words = format!(
        "--object builtin:sphere --profile gelsight-mini-markers --markers field --out {}",
        out.display()
    );
    succeed(&mut render("tactile", &words));
    assert!(!out.exists());
    let (rows, columns, values) = marker_array(dir.path().join("press.markers.npy"));
    assert_eq!(values.len(), rows * columns * 5);
    assert!(values.chunks_exact(5).any(|m| m[2].hypot(m[3]) > 0.05));
}

#[test]
fn unfit_profiles_are_explained() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("press.png");
    for (flags, words) in [
        (
            "--profile gelsight-mini-marker",
            "did you mean `gelsight-mini-markers`?",
        ),
        (
            "--profile gelsight-mini --markers field",
            "has no gel markers",
        ),
        (
            "--profile gelsight-mini-markers --markers field --difference",
            "--markers image,field",
        ),
    ] {
        let words_in = format!("--object builtin:sphere {flags} --out {}", out.display());
        let (_, text) = refused(&mut render("tactile", &words_in));
        assert!(text.contains(words), "{text}");
    }
    let words_in = format!(
        "--trace {} --side left --profile digit --out {}",
        trace().display(),
        out.display()
    );
    let (_, text) = refused(&mut render("tactile", &words_in));
    assert!(text.contains("25.0 × 20.0 × 4.0 mm"), "{text}");
}
