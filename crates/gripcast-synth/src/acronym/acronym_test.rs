//! Generated files in ACRONYM's format.

use std::fs;
use std::path::Path;

use glam::DVec3;
use hdf5_pure::FileBuilder;
use tempfile::TempDir;

use super::*;
use gripcast_base::error::{Error, ErrorKind};
use gripcast_base::files::Root;
use gripcast_geometry::{builtin, save_mesh};

/// Contents of a file; none omits the key.
struct FileContents {
    transforms: Option<(Vec<f64>, Vec<u64>)>,
    results: Option<Vec<i64>>,
    mesh_file: Option<&'static str>,
    scale: Option<f64>,
    gripper: &'static str,
}

/// Hand 0.2 m above the object, pointing down, closing along x.
fn matrix(x: f64) -> [f64; 16] {
    #[rustfmt::skip]
    let rows = [
        1.0, 0.0, 0.0, x,
        0.0, -1.0, 0.0, 0.0,
        0.0, 0.0, -1.0, 0.2,
        0.0, 0.0, 0.0, 1.0,
    ];
    rows
}

impl FileContents {
    fn new() -> Self {
        let transforms = [matrix(0.0), matrix(0.01), matrix(0.02)].concat();
        Self {
            transforms: Some((transforms, vec![3, 4, 4])),
            results: Some(vec![1, 0, 1]),
            mesh_file: Some("meshes/Mug/10f6.obj"),
            scale: Some(0.5),
            gripper: "panda",
        }
    }

    fn write(&self) -> Vec<u8> {
        let mut file = FileBuilder::new();
        let mut object = file.create_group("object");
        let number = |group: &mut hdf5_pure::GroupBuilder, key, value| {
            group
                .create_dataset(key)
                .with_f64_data(&[value])
                .with_shape(&[]);
        };
        if let Some(name) = self.mesh_file {
            object
                .create_dataset("file")
                .with_vlen_strings(&[name])
                .with_shape(&[]);
        }
        if let Some(scale) = self.scale {
            number(&mut object, "scale", scale);
        }
        file.add_group(object.finish());
        let mut gripper = file.create_group("gripper");
        gripper
            .create_dataset("type")
            .with_strings(&[self.gripper])
            .unwrap()
            .with_shape(&[]);
        number(&mut gripper, "configuration", 0.04);
        file.add_group(gripper.finish());
        let mut grasps = file.create_group("grasps");
        if let Some((values, shape)) = &self.transforms {
            grasps
                .create_dataset("transforms")
                .with_f64_data(values)
                .with_shape(shape);
        }
        if let Some(results) = &self.results {
            let mut qualities = grasps.create_group("qualities");
            let mut flex = qualities.create_group("flex");
            flex.create_dataset("object_in_gripper")
                .with_i64_data(results);
            qualities.add_group(flex.finish());
            grasps.add_group(qualities.finish());
        }
        file.add_group(grasps.finish());
        file.finish().unwrap()
    }

    fn read(&self) -> gripcast_base::error::Result<AcronymSet> {
        read_bytes(&self.write())
    }
}

fn read_bytes(bytes: &[u8]) -> gripcast_base::error::Result<AcronymSet> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("Mug_10f6_0.5.h5");
    fs::write(&path, bytes).unwrap();
    read_acronym(&path)
}

#[track_caller]
fn refused(contents: &FileContents, expected: &str) -> Error {
    let error = contents.read().unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Input, "{error}");
    let text = error.to_string();
    assert!(
        text.contains(expected) && text.contains("Mug_10f6_0.5.h5"),
        "{text}"
    );
    error
}

#[test]
fn object_and_grasps_are_read() {
    let set = FileContents::new().read().unwrap();
    assert_eq!(set.name, "Mug_10f6_0.5");
    let object = &set.object;
    assert_eq!(object.mesh_file, "meshes/Mug/10f6.obj");
    assert_eq!(object.category.as_deref(), Some("Mug"));
    assert_eq!(object.scale, 0.5);
    let results: Vec<_> = set.grasps.iter().map(|g| (g.number, g.stable)).collect();
    assert_eq!(results, [(0, true), (1, false), (2, true)]);
    assert!(set.skipped.is_empty());
    let pose = set.grasps[1].t_object_gripper;
    let expected = DVec3::new(0.01, 0.0, 0.2 - PANDA_GEL_CENTER_M);
    assert!(pose.translation_m.distance(expected) < 1e-12, "{pose:?}");
    assert!(pose.transform_vector(DVec3::Z).distance(-DVec3::Z) < 1e-12);
    assert!(pose.transform_vector(DVec3::X).distance(DVec3::X) < 1e-12);
}

#[test]
fn invalid_grasps_are_skipped_and_listed() {
    let mut contents = FileContents::new();
    let mut bad = matrix(0.0);
    bad[5] = f64::NAN;
    let mut skewed = matrix(0.0);
    skewed[1] = 0.5;
    let transforms = [bad, matrix(0.01), skewed].concat();
    contents.transforms = Some((transforms, vec![3, 4, 4]));
    let set = contents.read().unwrap();
    assert_eq!(set.grasps.len(), 1);
    assert_eq!(set.grasps[0].number, 1);
    let skipped: Vec<_> = set.skipped.iter().map(|s| s.number).collect();
    assert_eq!(skipped, [0, 2]);
    assert!(
        set.skipped[1].reason.contains("orthonormal"),
        "{:?}",
        set.skipped
    );
    contents.results = Some(vec![1, 7, 1]);
    refused(
        &contents,
        "none of the 3 grasps can be used; grasp 0: its matrix has NaN",
    );
}

#[test]
fn missing_keys_are_named() {
    let without = |change: fn(&mut FileContents), expected: &str| {
        let mut contents = FileContents::new();
        change(&mut contents);
        let error = refused(&contents, expected);
        assert!(error.remedy_text().is_some());
    };
    without(|s| s.transforms = None, "`grasps/transforms` not found");
    without(
        |s| s.results = None,
        "`grasps/qualities/flex/object_in_gripper` not found",
    );
    without(|s| s.mesh_file = None, "`object/file` not found");
    without(|s| s.scale = None, "`object/scale` not found");
}

#[test]
fn invalid_shapes_and_numbers_are_refused() {
    let with = |change: fn(&mut FileContents), expected: &str| {
        let mut contents = FileContents::new();
        change(&mut contents);
        refused(&contents, expected);
    };
    with(
        |s| s.transforms = Some((vec![0.0; 36], vec![3, 3, 4])),
        "found shape [3, 3, 4]",
    );
    with(
        |s| s.transforms = Some((vec![0.0; 48], vec![48])),
        "found shape [48]",
    );
    with(|s| s.results = Some(vec![1, 0]), "found shape [2]");
    with(|s| s.gripper = "robotiq", "found \"robotiq\"");
    for scale in [0.0, -1.0, f64::NAN, 1e-9, 1e4] {
        let mut contents = FileContents::new();
        contents.scale = Some(scale);
        refused(&contents, "`object/scale`");
    }
}

#[test]
fn invalid_hdf5_is_refused() {
    let error = read_bytes(b"{\"object\": \"meshes/Mug/10f6.obj\"}").unwrap_err();
    assert!(error.to_string().contains("not an HDF5 file"), "{error}");
    assert!(
        read_bytes(b"")
            .unwrap_err()
            .to_string()
            .contains("not an HDF5 file")
    );
    let gone = read_acronym(Path::new("/no/such/file.h5")).unwrap_err();
    assert_eq!(gone.kind(), ErrorKind::NotFound);
    assert!(read_acronym(&std::env::temp_dir()).is_err());
}

#[test]
fn damaged_files_do_not_panic() {
    let whole = FileContents::new().write();
    for fraction in 1..16 {
        let cut = &whole[..whole.len() * fraction / 16];
        assert!(read_bytes(cut).is_err(), "{fraction}/16");
    }
    let mut stream = gripcast_base::random::SeedStream::named(1, "damage");
    for _ in 0..200 {
        let mut damaged = whole.clone();
        for _ in 0..4 {
            let at = stream.index(damaged.len());
            damaged[at] = stream.bits() as u8;
        }
        // Any result but a panic.
        let _ = read_bytes(&damaged);
    }
}

#[test]
fn meshes_are_confined_to_their_root() {
    let mut object = FileContents::new().read().unwrap().object;
    let dir = TempDir::new().unwrap();
    let root = Root::new(dir.path().join("meshes-root"));
    let error = object.load_mesh(&root).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::NotFound);
    let path = root.path().join("meshes/Mug/10f6.obj");
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let mesh = builtin("box").unwrap().scaled(2.0);
    save_mesh(&path, &mesh).unwrap();
    let size = object.load_mesh(&root).unwrap().mesh.bounds().extent();
    assert!(size.distance(DVec3::new(0.04, 0.04, 0.06)) < 1e-9, "{size}");
    let secret = dir.path().join("secret.obj");
    save_mesh(&secret, &mesh).unwrap();
    std::os::unix::fs::symlink(&secret, root.path().join("link.obj")).unwrap();
    let absolute = secret.to_str().unwrap();
    for outside in [
        absolute,
        "../secret.obj",
        "meshes/../../secret.obj",
        "link.obj",
    ] {
        outside.clone_into(&mut object.mesh_file);
        let error = object.load_mesh(&root).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{outside:?}: {error}");
    }
}
