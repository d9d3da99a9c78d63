use super::*;
use gripcast_base::error::ErrorKind;

const GOOD: &str = r#"schema = 1
id = "bench-1"

[cameras.left]
product = "GelSight Mini"
serial = "2BNN4ZE7"
format = "MJPG"
width = 3280
height = 2464
fps = 25
crop_profile = "gsmini-seventh-v1"
controls = { auto_exposure = 1, exposure_time_absolute = 180 }

[cameras.right]
product = "GelSight Mini"
serial = "28F5K4RR"
format = "MJPG"
width = 3280
height = 2464
fps = 25
crop_profile = "gsmini-seventh-v1"

[cameras.depth]
source = "replay"
path = "depth"
format = "Z16"
width = 640
height = 480
fps = 30
depth_unit_m = 0.001
"#;

fn rejection(from: &str, to: &str) -> String {
    assert!(GOOD.contains(from), "{from}");
    let error = RigFile::parse(&GOOD.replacen(from, to, 1)).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Config, "{error}");
    error.to_string()
}

#[test]
fn file_round_trips() {
    let rig = RigFile::parse(GOOD).unwrap();
    assert_eq!(
        rig.cameras[&Role::Left].controls["exposure_time_absolute"],
        180
    );
    assert_eq!(rig.cameras[&Role::Depth].source, SourceKind::Replay);
    let again = RigFile::parse(&toml::to_string(&rig).unwrap()).unwrap();
    assert_eq!(again, rig);
}

#[test]
fn misspelt_keys_are_reported_with_line_and_nearest_name() {
    assert_eq!(
        rejection("product =", "produkt ="),
        "line 5: unknown field `produkt`\n  → did you mean `product`?"
    );
    assert_eq!(
        rejection("[cameras.left]", "[cameras.lefft]"),
        "line 4: unknown variant `lefft`\n  → did you mean `left`?"
    );
    assert_eq!(
        rejection("\"MJPG\"", "\"MJPEG\""),
        "line 7: unknown variant `MJPEG`\n  → did you mean `MJPG`?"
    );
    assert_eq!(
        rejection("auto_exposure", "exposure_auto"),
        "[cameras.left]: unknown control `exposure_auto`\n  → did you mean `auto_exposure`?"
    );
    assert!(rejection("auto_exposure", "gian").contains("did you mean `gain`?"));
    assert!(rejection("auto_exposure", "f").contains("use one of auto_exposure, "));
    assert!(rejection("fps = 25", "fps = fast").starts_with("line 10: "));
    assert!(rejection("width = 3280\n", "").contains("missing field `width`"));
}

#[test]
fn invalid_files_are_rejected() {
    for (from, to, expected) in [
        (
            "schema = 1",
            "schema = 2\nfuture = true",
            "expected rig file schema 1, found 2",
        ),
        ("schema = 1\n", "", "`schema` is missing"),
        ("bench-1", "../x", "found `../x`"),
        (
            "[cameras.right]",
            "[cameras.external]",
            "the camera `right` is missing",
        ),
        (
            "product = \"GelSight Mini\"\n",
            "",
            "[cameras.left]: `product` is missing",
        ),
        ("width = 3280", "width = 0", "found 0×2464"),
        ("fps = 25", "fps = 0", "at most 1000, found 0"),
        ("fps = 25", "fps = inf", "at most 1000, found inf"),
        (
            "crop_profile = \"gsmini-seventh-v1\"\n",
            "",
            "`crop_profile` is missing",
        ),
        (
            "format = \"MJPG\"",
            "format = \"Z16\"",
            "role left does not support format Z16",
        ),
        ("depth_unit_m = 0.001\n", "", "`depth_unit_m` is missing"),
        (
            "depth_unit_m = 0.001",
            "depth_unit_m = -1.0",
            "at most 1, found -1",
        ),
        (
            "path = \"depth\"\n",
            "",
            "[cameras.depth]: `path` is missing",
        ),
        ("28F5K4RR", "2BNN4ZE7", "are the same camera"),
    ] {
        let message = rejection(from, to);
        assert!(message.contains(expected), "{from} → {to}: {message}");
    }
}

#[test]
fn equal_serials_require_ports() {
    let twins = GOOD.replace("28F5K4RR", "2bnn-4ze7");
    let serial = |with: &str, text: &str| text.replacen("2BNN4ZE7\"\n", with, 1);
    let one_port = serial("2BNN4ZE7\"\nport = \"3-1\"\n", &twins);
    for text in [&twins, &one_port] {
        let error = RigFile::parse(text).unwrap_err().to_string();
        assert!(error.contains("have the same serial number"), "{error}");
        assert!(error.contains("`gripcast rig init` writes them"), "{error}");
    }
    let both = one_port.replace("2bnn-4ze7\"\n", "2bnn-4ze7\"\nport = \"3-2\"\n");
    RigFile::parse(&both).unwrap();
    RigFile::parse(&both.replace("3-2", "3-1")).unwrap_err();
}

#[test]
fn virtual_rig_is_valid() {
    let rig = RigFile::virtual_rig();
    rig.validate().unwrap();
    assert_eq!(RigFile::find_in("virtual", &[]).unwrap(), rig);
    assert!(
        rig.cameras
            .values()
            .all(|c| c.source == SourceKind::Virtual)
    );
    assert_eq!(rig.cameras.len(), 4);
    let marked = RigFile::find_in("virtual-markers", &[]).unwrap();
    marked.validate().unwrap();
    for (role, camera) in &marked.cameras {
        assert_eq!(camera.sensor_profile.is_some(), role.is_tactile());
    }
}

#[test]
fn rigs_are_found_by_name_and_path() {
    let directory = tempfile::tempdir().unwrap();
    let (first, second) = (directory.path().join("a"), directory.path().join("b"));
    fs::create_dir_all(&first).unwrap();
    fs::create_dir_all(&second).unwrap();
    fs::write(second.join("bench-1.toml"), GOOD).unwrap();
    let directories = [first.clone(), second.clone()];
    let rig = RigFile::find_in("bench-1", &directories).unwrap();
    assert_eq!(rig.id, "bench-1");
    assert_eq!(rig.cameras[&Role::Depth].path, Some(second.join("depth")));
    fs::write(
        first.join("bench-1.toml"),
        GOOD.replace("bench-1", "nearer"),
    )
    .unwrap();
    assert_eq!(
        RigFile::find_in("bench-1", &directories).unwrap().id,
        "nearer"
    );

    let error = RigFile::find_in("bench-2", &directories).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::NotFound);
    let text = error.to_string();
    assert!(text.contains("did you mean `bench-1`?"), "{text}");
    let known = "use one of virtual, virtual-markers, virtual-external, bench-1, ";
    assert!(text.contains(known), "{text}");

    let path = second.join("bench-1.toml");
    RigFile::find_in(path.to_str().unwrap(), &[]).unwrap();
    fs::write(&path, GOOD.replace("serial", "serail")).unwrap();
    let text = RigFile::load(&path).unwrap_err().to_string();
    assert!(
        text.contains("bench-1.toml: line 6: unknown field `serail`"),
        "{text}"
    );
    assert!(RigFile::load(&second.join("none.toml")).is_err());
}

#[test]
fn view_of_depth_images_follows_from_camera() {
    let mut rig = RigFile::virtual_rig();
    assert_eq!(rig.depth_view(), Some(DepthView::Colour));
    for source in [SourceKind::V4l2, SourceKind::Replay] {
        let depth = rig.cameras.get_mut(&Role::Depth).unwrap();
        depth.source = source;
        for (product, view) in [
            (
                "Intel(R) RealSense(TM) Depth Camera 435",
                Some(DepthView::LeftImager),
            ),
            ("Intel(R) RealSense(TM) Depth Camera 455", None),
            ("", None),
        ] {
            product.clone_into(&mut rig.cameras.get_mut(&Role::Depth).unwrap().product);
            assert_eq!(rig.depth_view(), view, "{source:?} {product}");
        }
    }
    rig.cameras.remove(&Role::Depth);
    assert_eq!(rig.depth_view(), None);
}
