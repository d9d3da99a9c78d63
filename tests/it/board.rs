//! The command `gripcast board`.

use std::fs;
use std::path::Path;
use std::process::Command;

use glam::DVec3;
use gripcast_geometry::MeshQuery;
use gripcast_pose::{BoardFile, BoardMarker, Body};
use gripcast_visual::gripper_parts;

use crate::json_schema::assert_schema;
use crate::program::{gripcast, json, stderr, succeed};

fn board(words: &str) -> Command {
    let mut command = gripcast();
    command.arg("board").args(words.split_whitespace());
    command
}

/// Exit code and stderr.
fn failure(command: &mut Command) -> (i32, String) {
    let output = command.output().unwrap();
    (output.status.code().unwrap(), stderr(&output))
}

#[test]
fn sheet_is_written_in_three_formats_with_its_board() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).display().to_string();
    let words = format!(
        "make --object builtin:mug --out {} --out {} --out {} --dpi 100 --json",
        at("mug.pdf"),
        at("mug.svg"),
        at("mug.png")
    );
    let made = json(&succeed(&mut board(&words)));
    assert_schema("board make", &[&made]);
    assert!(fs::read(at("mug.pdf")).unwrap().starts_with(b"%PDF"));
    let svg = fs::read_to_string(at("mug.svg")).unwrap();
    assert!(svg.contains("width=\"297mm\" height=\"210mm\""));
    let hash = made["hash"].as_str().unwrap();
    assert!(svg.contains(hash), "the hash is printed");
    let image = gripcast_imaging::decode_png_rgb(&fs::read(at("mug.png")).unwrap()).unwrap();
    assert_eq!(image.dimensions(), (1169, 827));
    let file = BoardFile::load(Path::new(&at("mug.toml"))).unwrap();
    assert_eq!(file.board.hash(), hash);
    assert_eq!(
        made["ids"].as_array().unwrap().len(),
        file.board.markers.len()
    );
    // The origin of the mug's frame is 40 mm above the sheet.
    let heights = file.board.markers.iter().flat_map(|m| m.corners_m);
    assert!(heights.into_iter().all(|c| (c.z + 0.04).abs() < 1e-6));
    assert!(file.board.is_planar(Body::Object));
}

#[test]
fn measured_rulers_change_the_board_only() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("b.svg");
    let run = |more: &str| {
        let words = format!(
            "make --object builtin:box --out {} --json {more}",
            out.display()
        );
        let made = json(&succeed(&mut board(&words)));
        (made, fs::read(&out).unwrap())
    };
    let (plain, drawn) = run("");
    let (measured, again) = run("--measured-mm 99.5,100.25");
    assert_eq!(drawn, again);
    assert_eq!(plain["hash"], plain["printed_hash"]);
    assert_eq!(measured["printed_hash"], plain["hash"]);
    assert_ne!(measured["hash"], plain["hash"]);
    let words = format!("show {} --json", dir.path().join("b.toml").display());
    let shown = json(&succeed(&mut board(&words)));
    assert_schema("board show", &[&shown]);
    assert_eq!(shown["hash"], measured["hash"]);
    assert_eq!(shown["sheet"]["printed_hash"], plain["hash"]);
    assert_eq!(shown["sheet"]["measured_mm"][1], 100.25);
}

#[test]
fn invalid_arguments_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("b.pdf").display().to_string();
    for (words, code, expected) in [
        (
            format!("make --object builtin:box --scale 6 --out {out}"),
            1,
            "A3 is large enough",
        ),
        (
            format!("make --object builtin:box --scale 12 --out {out}"),
            1,
            "no paper",
        ),
        (
            format!("make --object builtin:bx --out {out}"),
            1,
            "builtin:box",
        ),
        (
            format!("make --object builtin:box --out {out} --dictionary 6x6_25"),
            2,
            "DICT_6X6_250",
        ),
        (
            format!("make --object builtin:box --out {out} --paper a5"),
            2,
            "A4",
        ),
        (
            format!("make --object builtin:box --out {out} --measured-mm 99"),
            2,
            "99.6,99.8",
        ),
        (
            format!("make --object builtin:box --out {out} --measured-mm 9.9,10"),
            1,
            "100 mm",
        ),
        (
            format!("make --object builtin:box --out {out} --stable-pose 9"),
            1,
            "stable pose",
        ),
        (
            format!("make --object builtin:box --out {out} --first-id 240"),
            1,
            "ends with id 249",
        ),
        (
            "make --object builtin:box --out board.dxf".to_owned(),
            2,
            ".pdf, .svg or .png",
        ),
        (
            "make --object builtin:box --out /proc/nonexistent/b.pdf".to_owned(),
            1,
            "/proc/nonexistent",
        ),
        (
            format!("gripper --out {out} --body-mm 60"),
            1,
            "does not fit on the body",
        ),
        (
            "show /proc/nonexistent.toml".to_owned(),
            1,
            "/proc/nonexistent.toml",
        ),
    ] {
        let (found, message) = failure(&mut board(&words));
        assert_eq!(found, code, "{words}: {message}");
        assert!(message.contains(expected), "{words}: {message}");
    }
    assert!(!Path::new(&out).exists());
}

#[test]
fn foreign_boards_are_imported() {
    let dir = tempfile::tempdir().unwrap();
    let ros = dir.path().join("board_descriptions.yaml");
    let grid = |name: &str| {
        format!(
            "- name: {name}\n  frame_at_center: true\n  first_id: 4\n  markers_x: 3\n  \
             markers_y: 2\n  marker_size: 0.03\n  separation: 0.006\n"
        )
    };
    fs::write(&ros, grid("table") + &grid("wall")).unwrap();
    let (code, message) = failure(&mut board(&format!("import {}", ros.display())));
    assert_eq!(code, 2);
    assert!(message.contains("marker_dict"), "{message}");
    let words = format!("import {} --dictionary 4X4_50", ros.display());
    let (code, message) = failure(&mut board(&words));
    assert_eq!(code, 2);
    assert!(message.contains("table, wall"), "{message}");
    let out = dir.path().join("wall.toml");
    let words = format!("{words} --name wall --out {} --json", out.display());
    let wall = json(&succeed(&mut board(&words)));
    assert_eq!(wall["ids"][5], 9);
    let read = BoardFile::load(&out).unwrap();
    assert_eq!(
        (read.board.name.as_str(), read.board.markers.len()),
        ("wall", 6)
    );

    let kalibr = dir.path().join("target.yaml");
    let text =
        "target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n";
    fs::write(&kalibr, text).unwrap();
    let words = format!("import {} --json", kalibr.display());
    let kalibr_shown = json(&succeed(&mut board(&words)));
    assert_eq!(kalibr_shown["dictionary"], "36h11_border2");

    let own = dir.path().join("own.yml");
    let text = "%YAML:1.0\nnmarkers: 2\nmarkersize: 3\nmarker_0: \"101011001\"\n\
                marker_1: \"001010111\"\n";
    fs::write(&own, text).unwrap();
    let shown = json(&succeed(&mut board(&format!(
        "import {} --json",
        own.display()
    ))));
    assert_schema("board import", &[&wall, &kalibr_shown, &shown]);
    assert_eq!(shown["markers"], 2);
    let neither = dir.path().join("x.yaml");
    fs::write(&neither, "camera_matrix: 3\n").unwrap();
    let (code, message) = failure(&mut board(&format!("import {}", neither.display())));
    assert_eq!(code, 1);
    assert!(message.contains("target_type"), "{message}");
}

#[test]
fn custom_dictionary_is_stored_next_to_the_board() {
    let dir = tempfile::tempdir().unwrap();
    let known = gripcast_pose::Dictionary::by_name("DICT_5X5_50").unwrap();
    let mut text = "%YAML:1.0\nnmarkers: 50\nmarkersize: 5\n".to_owned();
    for id in 0..50 {
        text += &format!("marker_{id}: \"{:025b}\"\n", known.code(id).unwrap());
    }
    fs::write(dir.path().join("own.yml"), text).unwrap();
    let out = dir.path().join("b.pdf");
    let words = format!(
        "make --object builtin:box --dictionary own.yml --out {}",
        out.display()
    );
    succeed(&mut board(&words));
    let file = BoardFile::load(&dir.path().join("b.toml")).unwrap();
    assert_eq!(file.board.dictionary, "own.yml");
    assert_eq!(file.dictionary.code(7), known.code(7));
}

/// The bundled board.
fn gripper() -> BoardFile {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    BoardFile::load(&root.join("calib/boards/gripper-umi.toml")).unwrap()
}

#[test]
fn gripper_tags_match_the_bundled_board() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("gripper-umi.pdf");
    succeed(&mut board(&format!("gripper --out {}", out.display())));
    let made = fs::read_to_string(out.with_extension("toml")).unwrap();
    assert_eq!(made, gripper().to_toml());
}

/// Corners and centre of a marker at an opening, slightly in front of it, m.
fn points_of(marker: &BoardMarker, opening: f64) -> Vec<DVec3> {
    let shift = match marker.body {
        Body::FingerLeft => -0.5 * opening,
        Body::FingerRight => 0.5 * opening,
        Body::Gripper | Body::Object => 0.0,
    };
    let off = DVec3::X * shift + marker.normal() * 2e-4;
    let all = marker.corners_m.into_iter().chain([marker.center_m()]);
    all.map(|p| p + off).collect()
}

/// Position of a camera in front of the gripper, relative to the centre of the gels, m.
fn eye(azimuth_deg: f64, elevation_deg: f64, distance: f64) -> DVec3 {
    let (a, e) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
    DVec3::new(a.sin() * e.cos(), -a.cos() * e.cos(), -e.sin()) * distance
}

#[test]
fn gripper_tags_are_visible() {
    let board = gripper().board;
    for opening in [0.0, 0.06, 0.14] {
        let parts = gripper_parts(opening).unwrap();
        let bodies: Vec<MeshQuery> = parts.iter().map(|p| MeshQuery::new(&p.shape)).collect();
        for marker in &board.markers {
            let points = points_of(marker, opening);
            let is_inside = |p: &DVec3| bodies.iter().any(|b| b.contains(*p));
            assert!(!points.iter().any(is_inside), "{}", marker.id);
            for (azimuth, elevation) in [(0.0, 10.0), (-10.0, 20.0), (10.0, 30.0), (0.0, 30.0)] {
                for distance in [0.4, 0.8] {
                    let eye = eye(azimuth, elevation, distance);
                    let to_eye = (eye - marker.center_m()).normalize();
                    assert!(marker.normal().dot(to_eye) > 0.3, "{}", marker.id);
                    for p in &points {
                        let hidden = bodies
                            .iter()
                            .any(|b| b.ray_cast(*p, eye - *p, 1.0).is_some());
                        assert!(!hidden, "{} from {azimuth}°, {elevation}°", marker.id);
                    }
                }
            }
        }
    }
}

#[test]
fn markers_of_an_image_are_detected() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).display().to_string();
    succeed(&mut board(&format!(
        "charuco --dictionary DICT_7X7_250 --first-id 60 --out {} --dpi 100",
        at("c.png")
    )));
    let words = format!("detect {} --overlay {} --json", at("c.png"), at("found"));
    let found = json(&succeed(&mut board(&words)));
    assert_schema("board detect", &[&found]);
    let image = &found["images"][0];
    let ids: Vec<u64> = image["markers"]
        .as_array()
        .unwrap()
        .iter()
        .map(|marker| {
            // The smallest dictionary with these ids.
            assert_eq!(marker["dictionary"], "DICT_7X7_100");
            marker["id"].as_u64().unwrap()
        })
        .collect();
    assert_eq!(ids, (60..84).collect::<Vec<u64>>());
    assert_eq!(image["repeated_ids"].as_array().unwrap().len(), 0);
    assert!(image["pose"].is_null());
    assert!(Path::new(&at("found/c.png.jpg")).exists());
    // 21 mm at 100 dpi.
    let side = image["markers"][0]["sides_px"][0].as_f64().unwrap();
    assert!((side - 82.7).abs() < 0.5, "{side}");
    // Text, the board file, another dictionary.
    let output = succeed(&mut board(&format!(
        "detect {} --board {}",
        at("c.png"),
        at("c.toml")
    )));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text.contains("24 markers") && text.contains("DICT_7X7_250"),
        "{text}"
    );
    let words = format!("detect {} --dictionary 4X4_50", at("c.png"));
    let output = board(&words).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("24 of DICT_7X7_100"), "{text}");
}

#[test]
fn copies_of_a_marker_are_all_listed() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).display().to_string();
    succeed(&mut board(&format!(
        "charuco --out {} --dpi 80",
        at("c.png")
    )));
    let one = gripcast_imaging::decode_png_rgb(&fs::read(at("c.png")).unwrap()).unwrap();
    let (width, height) = one.dimensions();
    let mut two = image::RgbImage::new(2 * width, height);
    image::imageops::replace(&mut two, &one, 0, 0);
    image::imageops::replace(&mut two, &one, i64::from(width), 0);
    two.save(at("two.png")).unwrap();
    let found = json(&succeed(&mut board(&format!(
        "detect {} --json",
        at("two.png")
    ))));
    let image = &found["images"][0];
    assert_eq!(image["markers"].as_array().unwrap().len(), 48);
    assert_eq!(image["repeated_ids"].as_array().unwrap().len(), 24);
}

/// Files of the field: imported, or refused with the cause.
#[test]
fn field_boards_are_imported_or_refused_with_the_cause() {
    let Some(folder) = gripcast_testing::shared("field/mesh-sim-pose/board-import") else {
        return;
    };
    for (name, flags, expected) in [
        (
            "aruco_map.yml",
            "",
            Err("aruco_bc_nmarkers is 2, found 1 markers"),
        ),
        ("dict4.yml", "", Ok("3 of 4 × 4 cells")),
        ("dict_maxcorr.yml", "", Ok("2 of 6 × 6 cells")),
        ("kalibr_checker.yaml", "", Ok("squares = [7, 8]")),
        ("kalibr_frac.yaml", "", Err("write 0.3000")),
        (
            "kalibr_startid.yaml",
            "",
            Err("from id 36 exceeds 16h5_border2"),
        ),
        ("kalibr_yamlhead.yaml", "", Ok("36h11_border2")),
        (
            "ros_extra.yaml",
            "--dictionary 4X4_50 --name b1",
            Ok("DICT_4X4_50"),
        ),
        (
            "ros_extra.yaml",
            "--dictionary 4X4_50 --name custom",
            Err("not a grid"),
        ),
        ("ros_extra.yaml", "--dictionary 4X4_50", Err("has 2 boards")),
    ] {
        let words = format!("import {} {flags}", folder.join(name).display());
        let output = board(&words).output().unwrap();
        match expected {
            Ok(text) => {
                let found = String::from_utf8(output.stdout.clone()).unwrap();
                assert!(found.contains(text), "{name}: {found}{}", stderr(&output));
            }
            Err(text) => assert!(
                stderr(&output).contains(text),
                "{name}: {}",
                stderr(&output)
            ),
        }
    }
}
