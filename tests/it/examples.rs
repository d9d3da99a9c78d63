//! The examples do what their headers say.

use gripcast_nn::predict::Model;

use crate::dataset::write_dataset;

#[path = "../../examples/contact_fields.rs"]
#[expect(dead_code, reason = "`main` is of the example alone")]
mod contact_fields;
#[path = "../../examples/read_dataset.rs"]
#[expect(dead_code, reason = "`main` is of the example alone")]
mod read_dataset;
#[path = "../../examples/simulate_and_render.rs"]
#[expect(dead_code, reason = "`main` is of the example alone")]
mod simulate_and_render;
#[path = "../../examples/write_predictor.rs"]
#[expect(dead_code, reason = "`main` is of the example alone")]
mod write_predictor;

#[test]
fn example_reads_a_dataset() {
    let dir = tempfile::tempdir().unwrap();
    let ids = write_dataset(dir.path(), &["mug", "bottle", "sponge"]);
    let table = read_dataset::table(dir.path().to_str().unwrap()).unwrap();
    let lines: Vec<Vec<&str>> = table
        .lines()
        .map(|l| l.split_whitespace().collect())
        .collect();
    assert_eq!(lines.len(), 4, "{table}");
    assert_eq!(lines[1][..4], [ids[0].as_str(), "mug", "Stable", "32x24"]);
    assert_eq!(lines[2][..3], [ids[1].as_str(), "bottle", "Slip"]);
    assert_eq!(lines[3][2], "Unlabelled");
    let strength: f64 = lines[1][4].parse().unwrap();
    assert!(strength > 1.0, "{table}");
}

#[test]
fn example_prints_the_resultant_over_a_lift() {
    let table = contact_fields::table("box").unwrap();
    let lifting: Vec<&str> = table.lines().filter(|l| l.starts_with("Lift")).collect();
    assert!(lifting.len() > 3, "{table}");
    for line in lifting {
        let stick = line.split("stick ").nth(1).unwrap();
        let stick: f64 = stick.split(',').next().unwrap().parse().unwrap();
        assert!(stick > 0.9, "{line}");
    }
}

#[test]
fn example_simulates_and_renders_a_grasp() {
    let dir = tempfile::tempdir().unwrap();
    let said = simulate_and_render::run("box", dir.path()).unwrap();
    assert!(said.starts_with("Success, lifted "), "{said}");
    for (name, size) in [
        ("left", (320, 240)),
        ("right", (320, 240)),
        ("colour", (160, 120)),
    ] {
        let bytes = std::fs::read(dir.path().join(format!("{name}.png"))).unwrap();
        let image = gripcast_imaging::decode_png_rgb(&bytes).unwrap();
        assert_eq!(image.dimensions(), size, "{name}");
        let first = image.get_pixel(0, 0);
        assert!(
            image.pixels().any(|pixel| pixel != first),
            "{name} is blank"
        );
    }
}

#[test]
fn example_writes_and_measures_a_predictor() {
    let dir = tempfile::tempdir().unwrap();
    write_dataset(dir.path(), &["mug", "bottle", "sponge"]);
    let model = Model::from_bytes(&write_predictor::onnx().unwrap()).unwrap();
    // Both labelled grasps have strong differences; the second slipped all the same.
    let found = write_predictor::accuracy(&model, dir.path().to_str().unwrap()).unwrap();
    assert_eq!(found, (1, 2));
}
