use super::*;
use glam::DQuat;

use gripcast_geometry::{builtin, stable_poses};

fn settings() -> SheetSettings {
    SheetSettings {
        name: "test".into(),
        dictionary: Dictionary::by_name("DICT_6X6_250").unwrap(),
        first_id: 4,
        marker_m: 0.03,
        paper: Paper::A4,
        measured_mm: [100.0; 2],
    }
}

/// A mesh in one of its stable poses, rotated about the vertical.
fn lying(mesh: &TriangleMesh, pose: usize, yaw_rad: f64) -> SheetObject<'_> {
    let pose = stable_poses(mesh, 0.0).unwrap()[pose].t_world_object;
    SheetObject {
        mesh,
        source: "builtin:test",
        t_world_object: Pose::from_rotation(DQuat::from_rotation_z(yaw_rad)) * pose,
    }
}

/// A built-in mesh in its own orientation.
fn on(mesh: &TriangleMesh) -> SheetObject<'_> {
    let lowest = mesh.bounds().min.z;
    SheetObject {
        mesh,
        source: "builtin:test",
        t_world_object: Pose::from_translation(DVec3::new(0.0, 0.0, -lowest)),
    }
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-9
}

#[test]
fn markers_and_object_do_not_overlap() {
    for (name, paper, pose, yaw) in [
        ("mug", Paper::A4, 0, 0.0),
        ("mug", Paper::Letter, 1, 0.7),
        ("bar", Paper::A4, 0, 0.4),
        ("sphere", Paper::A3, 0, 0.0),
    ] {
        let mesh = builtin(name).unwrap();
        let settings = SheetSettings {
            paper,
            ..settings()
        };
        let sheet = object_sheet(&lying(&mesh, pose, yaw), &settings).unwrap();
        let markers: Vec<[f64; 4]> = sheet.drawing.markers().collect();
        assert!(markers.len() >= 10, "{name}: {}", markers.len());
        let cell = 30.0 / 8.0;
        let [width, height] = sheet.drawing.size_mm;
        for (k, [x, y, w, h]) in markers.iter().enumerate() {
            assert!(close(*w, 30.0) && close(*h, 30.0));
            // The quiet zone is on the paper and empty.
            assert!(x - cell > 0.0 && y - cell > 0.0);
            assert!(x + w + cell < width && y + h + cell < height);
            for [p, q, _, _] in &markers[..k] {
                assert!((x - p).abs() >= 30.0 + cell || (y - q).abs() >= 30.0 + cell);
            }
        }
        for shape in &sheet.drawing.shapes {
            let points = match shape {
                Shape::Line { points, .. } => points.clone(),
                Shape::Text { at, text, .. } => {
                    vec![*at, *at + DVec2::new(1.2 * text.len() as f64, 0.0)]
                }
                Shape::Marker { .. } => continue,
            };
            for pair in points.windows(2) {
                let (low, high) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
                assert!(
                    is_outside_quiet_zones(&sheet.drawing, low, high, cell - 1e-9),
                    "{name}: {shape:?}"
                );
            }
        }
        // All vertices of the object are outside the quiet zones.
        let t = sheet.file.sheet.as_ref().unwrap().t_world_object;
        for marker in &sheet.file.board.markers {
            let [low, high] = span(marker, &t);
            for vertex in &mesh.vertices {
                let p = t.transform_point(*vertex).truncate() * 1e3;
                let inside = p.cmpgt(low - cell).all() && p.cmplt(high + cell).all();
                assert!(!inside, "{name}: marker {}", marker.id);
            }
        }
    }
}

/// A marker on the table, mm.
fn span(marker: &BoardMarker, t_world_object: &Pose) -> [DVec2; 2] {
    let corners = marker.corners_m.map(|c| {
        let on_table = 1e3 * t_world_object.transform_point(c);
        assert!(on_table.z.abs() < 1e-6, "{on_table}");
        on_table.truncate()
    });
    [
        corners.into_iter().reduce(DVec2::min).unwrap(),
        corners.into_iter().reduce(DVec2::max).unwrap(),
    ]
}

#[test]
fn drawing_matches_the_board_file() {
    let mesh = builtin("wedge").unwrap();
    let sheet = object_sheet(&lying(&mesh, 2, 0.3), &settings()).unwrap();
    let t = sheet.file.sheet.as_ref().unwrap().t_world_object;
    let drawn: Vec<[f64; 4]> = sheet.drawing.markers().collect();
    assert_eq!(drawn.len(), sheet.file.board.markers.len());
    // All drawn corners match the table after one translation.
    let on_table = |k: usize, c: usize| {
        let corner = sheet.file.board.markers[k].corners_m[c];
        1e3 * t.transform_point(corner).truncate()
    };
    let shift = on_table(0, 0) - DVec2::new(drawn[0][0], -drawn[0][1]);
    for (k, [x, y, w, h]) in drawn.iter().enumerate() {
        for (c, (px, py)) in [(*x, *y), (x + w, *y), (x + w, y + h), (*x, y + h)]
            .into_iter()
            .enumerate()
        {
            let expected = DVec2::new(px, -py) + shift;
            assert!(on_table(k, c).distance(expected) < 1e-9);
        }
    }
    // The drawn outline matches that of the object.
    let bottom: Vec<DVec2> = sheet
        .drawing
        .shapes
        .iter()
        .filter_map(|shape| match shape {
            Shape::Line {
                points,
                closed: true,
                dash_mm: None,
                ..
            } => Some(points.clone()),
            _ => None,
        })
        .flatten()
        .map(|p| DVec2::new(p.x, -p.y) + shift)
        .collect();
    let own: Vec<Outline> = section(&mesh.transformed(&t), SECTION_M);
    let low = |points: &mut dyn Iterator<Item = DVec2>| points.reduce(DVec2::min).unwrap();
    let a = low(&mut bottom.into_iter());
    let b = low(&mut own.iter().flat_map(|o| o.points.iter().map(|p| 1e3 * *p)));
    assert!(a.distance(b) < 0.02, "{a} {b}");
}

#[test]
fn sheet_has_two_rulers() {
    let mesh = builtin("box").unwrap();
    let sheet = object_sheet(&on(&mesh), &settings()).unwrap();
    let is_ruler = |shape: &&Shape| match shape {
        Shape::Line { points, .. } => {
            points.len() == 2 && close(points[0].distance(points[1]), 100.0)
        }
        _ => false,
    };
    let rulers: Vec<&Shape> = sheet.drawing.shapes.iter().filter(is_ruler).collect();
    assert_eq!(rulers.len(), 2);
}

#[test]
fn printer_scale_changes_the_board_only() {
    let mesh = builtin("mug").unwrap();
    let plain = object_sheet(&on(&mesh), &settings()).unwrap();
    let scaled = SheetSettings {
        measured_mm: [99.0, 101.5],
        ..settings()
    };
    let scaled = object_sheet(&on(&mesh), &scaled).unwrap();
    assert_eq!(plain.drawing, scaled.drawing);
    let record = scaled.file.sheet.as_ref().unwrap();
    assert_eq!(record.printed_hash, plain.file.board.hash());
    assert_ne!(scaled.file.board.hash(), plain.file.board.hash());
    let t = record.t_world_object;
    for (a, b) in plain
        .file
        .board
        .markers
        .iter()
        .zip(&scaled.file.board.markers)
    {
        let [low, high] = span(b, &t);
        assert!((high - low).distance(DVec2::new(29.7, 30.45)) < 1e-6);
        // The fixed point is the axis of the mug, not the centre of its bounding box.
        let [from, _] = span(a, &t);
        let fixed_point = (low - from * DVec2::new(0.99, 1.015)) / DVec2::new(0.01, -0.015);
        assert!(
            fixed_point.distance(1e3 * t.translation_m.truncate()) < 0.2,
            "{fixed_point}"
        );
    }
}

#[test]
fn papers_that_fit_are_named() {
    let large = builtin("box").unwrap().scaled(4.5);
    let error = object_sheet(&on(&large), &settings())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("covers 180") && error.contains("A3 is large enough"),
        "{error}"
    );
    let huge = builtin("box").unwrap().scaled(20.0);
    let error = object_sheet(&on(&huge), &settings())
        .unwrap_err()
        .to_string();
    assert!(error.contains("no paper"), "{error}");
}

#[test]
fn invalid_settings_are_rejected() {
    let mesh = builtin("box").unwrap();
    let check = |object: &SheetObject<'_>, settings: &SheetSettings, word: &str| {
        let error = object_sheet(object, settings).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    };
    let floating = SheetObject {
        t_world_object: Pose::IDENTITY,
        ..on(&mesh)
    };
    check(&floating, &settings(), "lowest point is at -30.000 mm");
    let empty = TriangleMesh::default();
    let nothing = SheetObject {
        mesh: &empty,
        ..on(&mesh)
    };
    check(&nothing, &settings(), "no triangles");
    let with = |change: &dyn Fn(&mut SheetSettings)| {
        let mut changed = settings();
        change(&mut changed);
        changed
    };
    check(&on(&mesh), &with(&|s| s.first_id = 245), "ends with id 249");
    check(
        &on(&mesh),
        &with(&|s| s.marker_m = 30.0),
        "from 5 to 400 mm",
    );
    check(
        &on(&mesh),
        &with(&|s| s.marker_m = f64::NAN),
        "from 5 to 400 mm",
    );
    check(
        &on(&mesh),
        &with(&|s| s.measured_mm = [9.9, 10.0]),
        "100 mm",
    );
    check(
        &on(&mesh),
        &with(&|s| s.measured_mm = [f64::NAN; 2]),
        "100 mm",
    );
}
