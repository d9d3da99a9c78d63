//! Annotation of rendered images with known poses.

use glam::{DQuat, DVec3};
use image::{GrayImage, Luma, imageops};

use super::*;
use gripcast_imaging::Intrinsics;
use gripcast_pose::detect::FullSearch;
use gripcast_pose::synthetic::{ImageConditions, PlacedBoard, render, ring_board, test_camera};
use gripcast_pose::{BoardFile, Body, Dictionary};

const WIDTH: u32 = 960;

fn tags() -> BoardFile {
    BoardFile::gripper_umi().unwrap()
}

fn sheet(dictionary: &str) -> BoardFile {
    let dictionary = Dictionary::by_name(dictionary).unwrap();
    BoardFile::new(ring_board(&dictionary), dictionary, None).unwrap()
}

fn camera() -> Intrinsics {
    test_camera(WIDTH, WIDTH * 9 / 16)
}

/// A gripper pointing down over the centre of the sheet.
fn t_object_gripper() -> Pose {
    let down = DQuat::from_rotation_x(std::f64::consts::PI);
    Pose::new(
        DQuat::from_rotation_z(0.1) * down,
        DVec3::new(0.004, -0.003, 0.03),
    )
}

/// The camera in front of the gripper, 30° above the table.
fn t_camera_object() -> Pose {
    // The gripper's −y side is the sheet's +y side.
    let eye = DVec3::new(0.05, 0.58, 0.42);
    let target = DVec3::new(0.0, 0.0, 0.1);
    let forward = (target - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let axes = glam::DMat3::from_cols(right, forward.cross(right), forward);
    Pose::new(DQuat::from_mat3(&axes), eye).inverse()
}

struct TestImage {
    opening_m: f64,
    moved_m: f64,
    blur_px: f64,
    seed: u64,
}

impl Default for TestImage {
    fn default() -> Self {
        Self {
            opening_m: 0.08,
            moved_m: 0.0,
            blur_px: 0.7,
            seed: 1,
        }
    }
}

impl TestImage {
    fn render(&self, sheet: &BoardFile) -> GrayImage {
        let tags = tags();
        let t_camera_object = t_camera_object();
        let lift = Pose::from_translation(DVec3::Z * self.moved_m);
        let t_camera_gripper = t_camera_object * lift * t_object_gripper();
        let body = |body: Body, slide: f64| PlacedBoard {
            board: &tags.board,
            body,
            dictionary: &tags.dictionary,
            t_camera_body: t_camera_gripper * Pose::from_translation(DVec3::X * slide),
        };
        let placed = [
            PlacedBoard {
                board: &sheet.board,
                body: Body::Object,
                dictionary: &sheet.dictionary,
                t_camera_body: t_camera_object,
            },
            body(Body::Gripper, 0.0),
            body(Body::FingerLeft, -0.5 * self.opening_m),
            body(Body::FingerRight, 0.5 * self.opening_m),
        ];
        let conditions = ImageConditions {
            psf_px: self.blur_px,
            ..ImageConditions::default()
        };
        render(&camera(), &placed, &conditions, self.seed).image
    }
}

fn annotator() -> Annotator {
    Annotator::new(sheet("DICT_6X6_250"), tags(), camera(), FullSearch::IfSmall).unwrap()
}

fn render_all(images: &[TestImage]) -> Vec<(String, GrayImage)> {
    let sheet = sheet("DICT_6X6_250");
    let render = |(i, image): (usize, &TestImage)| (format!("{i}"), image.render(&sheet));
    images.iter().enumerate().map(render).collect()
}

fn annotate(images: &[(String, GrayImage)]) -> Result<Annotation> {
    annotator().annotate(images.iter().map(|(name, image)| (name.clone(), image)))
}

fn frames(annotation: &Annotation) -> &[String] {
    &annotation.record.quality.as_ref().unwrap().frames
}

fn error_mm(record: &PoseRecord) -> f64 {
    1e3 * DVec3::from_array(record.t_m).distance(t_object_gripper().translation_m)
}

#[test]
fn single_image_gives_pose_covariance_and_quality() {
    let found = annotate(&render_all(&[TestImage::default()])).unwrap();
    let record = &found.record;
    assert!(error_mm(record) < 0.2, "{} mm", error_mm(record));
    let [w, x, y, z] = record.q_wxyz;
    let found = Pose::from_rotation(DQuat::from_xyzw(x, y, z, w));
    assert!(w >= 0.0 && found.rotation_from(&t_object_gripper()).length() < 0.003);
    let covariance = record.covariance.as_ref().unwrap();
    assert_eq!(covariance.len(), 36);
    let sigma_mm = 1e3 * (covariance[0] + covariance[7] + covariance[14]).sqrt();
    assert!((0.01..0.5).contains(&sigma_mm), "{sigma_mm}");
    let quality = record.quality.as_ref().unwrap();
    assert!(
        quality.markers[0] >= 12 && quality.markers[1] == 6,
        "{quality:?}"
    );
    assert!(
        !quality.ambiguous && quality.notes.is_empty(),
        "{quality:?}"
    );
    assert!(
        (quality.opening_m.unwrap() - 0.08).abs() < 3e-4,
        "{quality:?}"
    );
    assert!(quality.tags_reprojection_px < 0.2 && record.reprojection_px.unwrap() < 0.2);
}

#[test]
fn last_sharp_images_before_closing_are_selected() {
    let still = |seed: u64| TestImage {
        seed,
        ..TestImage::default()
    };
    let images = render_all(&[
        // Before the gripper came to rest.
        TestImage {
            moved_m: 0.01,
            ..still(1)
        },
        still(2),
        TestImage {
            blur_px: 1.4,
            ..still(3)
        },
        still(4),
        // Closing.
        TestImage {
            opening_m: 0.076,
            ..still(5)
        },
        TestImage {
            opening_m: 0.06,
            moved_m: 0.002,
            ..still(6)
        },
    ]);
    let found = annotate(&images).unwrap();
    assert_eq!(frames(&found), ["1", "3"]);
    assert_eq!(found.shown_image, "3");
    let quality = found.record.quality.as_ref().unwrap();
    assert!(
        quality.spread_m > 0.0 && quality.spread_m < 3e-4,
        "{quality:?}"
    );
    assert!(error_mm(&found.record) < 0.2);
}

#[test]
fn invalid_images_are_diagnosed() {
    let error = |image: &GrayImage| annotator().observe(image).unwrap_err().to_string();
    let whole = TestImage::default().render(&sheet("DICT_6X6_250"));
    let empty = GrayImage::from_pixel(whole.width(), whole.height(), Luma([90]));
    assert!(error(&empty).contains("the sheet"), "{}", error(&empty));
    let small = imageops::crop_imm(&whole, 0, 0, 640, 360).to_image();
    assert!(error(&small).contains("640×360"), "{}", error(&small));
    let mirrored = imageops::flip_horizontal(&whole);
    assert!(
        error(&mirrored).contains("mirrored"),
        "{}",
        error(&mirrored)
    );
    let other = TestImage::default().render(&sheet("36h11"));
    let text = error(&other);
    assert!(text.contains("36h11"), "{text}");
    // The upper half has the tags of the body, the lower half the sheet.
    let mut no_tags = whole.clone();
    let mut no_sheet = whole.clone();
    for (x, y, level) in whole.enumerate_pixels() {
        let hidden = if y < 315 { &mut no_tags } else { &mut no_sheet };
        hidden.put_pixel(x, y, Luma([level[0] / 255 * 90 + 90]));
    }
    let text = error(&no_tags);
    assert!(
        text.contains("the gripper's tags") || text.contains("one finger"),
        "{text}"
    );
    assert!(
        error(&no_sheet).contains("the sheet"),
        "{}",
        error(&no_sheet)
    );
    let none: [(String, GrayImage); 0] = [];
    assert!(
        annotate(&none)
            .unwrap_err()
            .to_string()
            .contains("no image")
    );
}

/// The image with all markers covered but `kept`.
fn with_only(image: &GrayImage, kept: &[u32]) -> GrayImage {
    let observation = annotator().observe(image).unwrap();
    let mut covered = image.clone();
    for detection in observation
        .detections
        .iter()
        .filter(|d| !kept.contains(&d.id))
    {
        let [x, y] = (detection.corners_px.iter().sum::<glam::DVec2>() / 4.0)
            .to_array()
            .map(|c| c as u32);
        for (dx, dy) in (0..7).flat_map(|dx| (0..7).map(move |dy| (dx, dy))) {
            covered.put_pixel(x + dx - 3, y + dy - 3, Luma([90]));
        }
        // Interrupt the border.
        for dx in 0..40 {
            let column = (x + dx).saturating_sub(20).min(image.width() - 1);
            (0..3).for_each(|dy| covered.put_pixel(column, y + dy - 1, Luma([205])));
        }
    }
    covered
}

#[test]
fn few_markers_are_noted() {
    let image = TestImage::default().render(&sheet("DICT_6X6_250"));
    let tags: Vec<u32> = (240..246).collect();
    let half = with_only(&image, &[&[9, 10, 11][..], &tags].concat());
    let found = annotate(&[("half".to_owned(), half)]).unwrap();
    let notes = &found.record.quality.as_ref().unwrap().notes;
    assert!(
        notes.iter().any(|n| n.contains("only 3 of 14")),
        "{notes:?}"
    );
    assert!(error_mm(&found.record) < 5.0);

    let sheet_ids: Vec<u32> = (0..14).collect();
    let single = with_only(&image, &[&sheet_ids[..], &[242]].concat());
    let found = annotate(&[("single".to_owned(), single)]).unwrap();
    let quality = found.record.quality.as_ref().unwrap();
    assert_eq!(quality.markers[1], 1);
    let notes = quality.notes.join("; ");
    assert!(notes.contains("one tag"), "{notes}");
    assert_eq!(quality.ambiguous, notes.contains("ambiguous"), "{notes}");
}

#[test]
fn incompatible_boards_are_rejected() {
    let text = |sheet: BoardFile, tags: BoardFile| {
        Annotator::new(sheet, tags, camera(), FullSearch::IfSmall)
            .map(|_| ())
            .unwrap_err()
            .to_string()
    };
    let sheet = sheet("DICT_6X6_250");
    assert!(text(tags(), tags()).contains("not a sheet"));
    assert!(text(sheet.clone(), sheet.clone()).contains("no marker of a gripper"));
    let mut clashing = sheet;
    clashing.board.markers[0].id = 240;
    assert!(text(clashing, tags()).contains("240"));
}

#[test]
fn overlay_has_axes_markers_and_mesh() {
    let image = TestImage::default().render(&sheet("DICT_6X6_250"));
    let mut annotator = annotator();
    let observation = annotator.observe(&image).unwrap();
    let grey = image::DynamicImage::ImageLuma8(image).to_rgb8();
    let mut drawn = grey.clone();
    let mesh = gripcast_geometry::builtin("box").unwrap();
    let content = OverlayContent {
        mesh: Some(&mesh),
        lines: vec!["BOX".to_owned()],
    };
    overlay(&mut drawn, &observation, annotator.intrinsics(), &content);
    let coloured = |is: fn(&[u8; 3]) -> bool| drawn.pixels().filter(|p| is(&p.0)).count();
    assert!(
        coloured(|[r, g, b]| *r > 200 && *g < 90 && *b < 90) > 50,
        "x axes"
    );
    assert!(
        coloured(|[r, g, b]| *r > 200 && *g > 180 && *b < 90) > 100,
        "mesh"
    );
    assert!(
        coloured(|[r, g, b]| *r < 90 && *g > 180 && *b > 180) > 300,
        "markers"
    );
    let changed = grey
        .pixels()
        .zip(drawn.pixels())
        .filter(|(a, b)| a != b)
        .count();
    assert!(changed < grey.pixels().len() / 4, "{changed}");
    // A pose behind the camera draws nothing.
    let mut behind = observation;
    behind.object.t_camera_body.translation_m = DVec3::new(50.0, 0.0, -0.2);
    overlay(&mut drawn, &behind, annotator.intrinsics(), &content);
}

/// The image with other levels.
fn changed(image: &GrayImage, level: impl Fn(f64) -> f64) -> GrayImage {
    let mut changed = image.clone();
    for pixel in changed.iter_mut() {
        *pixel = level(f64::from(*pixel)).round().clamp(0.0, 255.0) as u8;
    }
    changed
}

fn notes_of(image: GrayImage) -> (f64, String) {
    let record = annotate(&[("0".to_owned(), image)]).unwrap().record;
    let notes = record.quality.as_ref().unwrap().notes.join("; ");
    (error_mm(&record), notes)
}

#[test]
fn linear_levels_are_recognised_by_the_residual() {
    let image = TestImage::default().render(&sheet("DICT_6X6_250"));
    let linear = |v: f64| 255.0 * f64::from(gripcast_imaging::srgb_decode(v as u8));
    let (error, notes) = notes_of(changed(&image, linear));
    assert!(error < 0.2, "{error} mm: {notes}");
    assert!(notes.contains("taken as linear"), "{notes}");
}

#[test]
fn clipping_and_blur_are_noted() {
    let sheet = sheet("DICT_6X6_250");
    let image = TestImage::default().render(&sheet);
    let (_, notes) = notes_of(changed(&image, |v| 1.5 * v));
    assert!(notes.contains("overexposed"), "{notes}");
    let blurred = TestImage {
        blur_px: 1.7,
        ..TestImage::default()
    };
    let (_, notes) = notes_of(blurred.render(&sheet));
    assert!(notes.contains("blurred by"), "{notes}");
}

#[test]
fn marker_that_is_there_twice_is_not_used() {
    let sheet = sheet("DICT_6X6_250");
    let mut image = TestImage::default().render(&sheet);
    let mut annotator = annotator();
    let before = annotator.observe(&image).unwrap();
    // A copy of one of the sheet's markers in an empty corner.
    let copied = before.object.markers.iter().find(|m| m.used).unwrap().id;
    let marker = before.detections.iter().find(|d| d.id == copied).unwrap();
    let (low, high) = marker.corners_px.iter().fold(
        (glam::DVec2::INFINITY, glam::DVec2::NEG_INFINITY),
        |(low, high), c| (low.min(*c), high.max(*c)),
    );
    let size = high - low + 12.0;
    let whole = |v: f64| v as u32;
    let (left, top) = (whole(low.x - 6.0), whole(low.y - 6.0));
    let copy = imageops::crop_imm(&image, left, top, whole(size.x), whole(size.y)).to_image();
    imageops::replace(&mut image, &copy, 4, 4);
    let after = annotator.observe(&image).unwrap();
    let note = format!("marker {copied} is in the image 2 times");
    assert!(
        after.notes.iter().any(|n| n.contains(&note)),
        "{:?}",
        after.notes
    );
    assert_eq!(
        after.object.used_markers() + 1,
        before.object.used_markers()
    );
}

/// Images of one scene by cameras of different kinds; all have the pose of `truth.json`.
#[test]
fn field_images_are_right_or_noted() {
    let Some(folder) = gripcast_testing::shared("field/mesh-sim-pose/linear-camera") else {
        return;
    };
    let board = |name: &str| BoardFile::load(&folder.join(name)).unwrap();
    let intrinsics = gripcast_pose::load_intrinsics(&folder.join("cam.toml")).unwrap();
    let mut decoder = gripcast_imaging::Decoder::new().unwrap();
    // Column 3 of the matrix in truth.json, mm.
    let truth = DVec3::new(134.378_551, 181.124_795, -80.846_852);
    for (name, max_mm, expected) in [
        ("srgb", 0.15, ""),
        ("linear", 0.15, "taken as linear"),
        ("overexposed", f64::INFINITY, "overexposed"),
    ] {
        let bytes = std::fs::read(folder.join(format!("{name}.jpg"))).unwrap();
        let image = imageops::grayscale(&decoder.stored_image(&bytes).unwrap());
        let (sheet, tags) = (board("sheet.toml"), board("tags.toml"));
        let mut annotator = Annotator::new(sheet, tags, intrinsics, FullSearch::IfSmall).unwrap();
        let found = annotator.observe(&image).unwrap();
        let at_mm = 1e3 * found.relative.t_object_gripper.translation_m;
        let error_mm = at_mm.distance(truth);
        let notes = found.notes.join("; ");
        assert!(error_mm < max_mm, "{name}: {error_mm} mm");
        assert!(notes.contains(expected), "{name}: {notes}");
        assert_eq!(expected.is_empty(), notes.is_empty(), "{name}: {notes}");
    }
}
