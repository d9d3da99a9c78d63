//! `gripcast render visual`.

use std::fs;

use super::{depth_png, png, refused, render, trace};
use crate::json_schema::assert_schema;
use crate::program::{json, succeed};

const SMALL: &str = "--size 48x36 --spp 4";

#[test]
fn image_and_depth_do_not_depend_on_threads() {
    let dir = tempfile::tempdir().unwrap();
    let take = |name: &str, threads: u32| {
        let out = dir.path().join(name);
        let words = format!(
            "--trace {} {SMALL} --depth --threads {threads} --out {}",
            trace().display(),
            out.display()
        );
        succeed(&mut render("visual", &words));
        (
            fs::read(&out).unwrap(),
            fs::read(out.with_extension("depth.png")).unwrap(),
        )
    };
    assert!(
        take("one.png", 1) == take("two.png", 2),
        "the image depends on the number of threads"
    );
    let image = png(dir.path().join("one.png"));
    let mean = image.iter().map(|&v| f64::from(v)).sum::<f64>() / (48.0 * 36.0 * 3.0);
    assert!((70.0..150.0).contains(&mean), "{mean}");
    let depth = depth_png(dir.path().join("one.depth.png"));
    let known = depth.iter().filter(|&&d| (80..1000).contains(&d)).count();
    assert!(known > 48 * 36 / 4, "{known} depths of a table or hand");
}

#[test]
fn images_vary_in_light_and_ground() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("many");
    let words = format!(
        "--object builtin:mug {SMALL} --count 2 --json --out {}",
        out.display()
    );
    let report = json(&succeed(&mut render("visual", &words)));
    assert_schema("render visual", &[&report]);
    assert_eq!(report["images"].as_array().unwrap().len(), 2);
    let [a, b] = [0, 1].map(|n| png(out.join(format!("builtin-mug.initial.{n}.png"))));
    assert!(a != b);
    let named = words.replace("--count 2", "--count 2 --sky overcast --pattern wood,stone");
    succeed(&mut render("visual", &named));
    assert!(a != png(out.join("builtin-mug.initial.0.png")));
}

#[test]
fn invalid_input_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("x.png").display().to_string();
    let invalid = dir.path().join("not.hdr");
    fs::write(&invalid, "hello").unwrap();
    let invalid = invalid.display();
    let cases = [
        (
            format!("--object builtin:box --hdri {invalid} --out {out}"),
            1,
            "not.hdr",
        ),
        (
            format!("--object builtin:box --ground {invalid} --out {out}"),
            1,
            "not.hdr",
        ),
        (
            format!("--object builtin:bax --out {out}"),
            1,
            "builtin:bar",
        ),
        (
            format!("--object builtin:box --sky suny --out {out}"),
            2,
            "did you mean sunny",
        ),
        (
            format!("--object builtin:box --pattern wod --out {out}"),
            2,
            "did you mean wood",
        ),
        (
            format!("--object builtin:box --finish glas --out {out}"),
            2,
            "glass",
        ),
        (
            format!("--object builtin:box --size 0x4 --out {out}"),
            2,
            "640x480",
        ),
        (
            format!("--object builtin:box --count 2 --out {out}"),
            2,
            "folder",
        ),
    ];
    for (words, code, expected) in cases {
        let (found, message) = refused(&mut render("visual", &words));
        assert_eq!(found, code, "{words}: {message}");
        assert!(message.contains(expected), "{words}: {message}");
    }
}
