//! `gripcast sim press` and `gripcast sim validate` as a user runs them.

use std::process::Command;

use crate::json_schema::assert_schema;
use crate::program::{gripcast, json, stderr, succeed};

fn sim(arguments: &str) -> Command {
    let mut command = gripcast();
    command.arg("sim").args(arguments.split_whitespace());
    command
}

#[test]
fn plate_force_matches_the_reference() {
    let found = json(&succeed(&mut sim(
        "press --indenter plate --gel coarse --depth-m 1e-4,2e-4 --face-m 1e-3 --json",
    )));
    assert_schema("sim press", &[&found]);
    assert_eq!(found["gel_nodes"][0], 13);
    let points = found["points"].as_array().unwrap();
    assert_eq!(points.len(), 2);
    // The converged reference is 30.755 N; the coarse gel is 2.5 % too stiff.
    let force = points[1]["normal_n"].as_f64().unwrap();
    assert!((30.7..32.3).contains(&force), "{force}");
    let depth = points[1]["depth_m"].as_f64().unwrap();
    assert!((depth - 2e-4).abs() < 1e-7, "{depth}");
}

#[test]
fn invalid_presses_are_rejected() {
    for (arguments, code, expected) in [
        ("press --indenter sphere", 2, "--radius-m"),
        ("press --indenter sphere --radius-m 0", 2, "--radius-m"),
        (
            "press --indenter plate --depth-m 0.003",
            1,
            "at most 0.002 m, half the gel's thickness, found 0.003",
        ),
        ("press --indenter plate --depth-m -.003", 1, "found -0.003"),
        ("press --indenter plate --radius-m -.003", 2, "--radius-m"),
        ("press --indenter mesh", 2, "--mesh"),
        ("press --indenter mesh --mesh no.stl", 1, "no.stl"),
    ] {
        let output = sim(arguments).output().unwrap();
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments}: {text}");
        assert!(text.contains(expected), "{arguments}: {text}");
    }
}

#[test]
fn mesh_beside_the_gel_is_explained() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("plate.obj");
    let corner = |x: f64, y: f64, z: f64| format!("v {x} {y} {z}\n");
    let vertices = [
        corner(20.0, 0.0, 0.0),
        corner(30.0, 0.0, 0.0),
        corner(20.0, 9.0, 0.0),
        corner(22.0, 3.0, 9.0),
    ];
    let faces = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    std::fs::write(&file, vertices.concat() + faces).unwrap();
    let press = format!(
        "press --indenter mesh --unit mm --gel coarse --mesh {}",
        file.display()
    );
    let output = sim(&press).output().unwrap();
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        text.contains("beside the gel: it spans x from 20.0 to 30.0 mm"),
        "{text}"
    );
}

#[test]
fn validation_counts_passed_cases() {
    let found = json(&succeed(&mut sim(
        "validate --cases free-fall,momentum --json",
    )));
    assert_schema("sim validate", &[&found]);
    assert_eq!(found["failed"], 0);
    assert_eq!(found["passed"], found["cases"].as_array().unwrap().len());
    let first = &found["cases"][0];
    assert_eq!(first["name"], "free-fall/25 steps");
    assert_eq!(first["passed"], true);
    assert!(first["expected"].is_f64() && first["found"].is_f64());
    let output = sim("validate --cases fre-fall").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("did you mean free-fall?"));
}
