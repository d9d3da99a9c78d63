//! Imports files written by deepdish (`tests/peers/feeling_of_success.py`) and synthetic ones.

use std::fs;
use std::path::{Path, PathBuf};

use hdf5_pure::{AttrValue, FileBuilder};
use image::{Rgb, RgbImage};
use tempfile::TempDir;

use super::run::sources;
use super::*;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::shard::{ShardEngine, ShardRow, ShardSet, SplitFractions};
use gripcast_imaging::{Decoder, encode_jpeg};

const DEEPDISH: &[u8] = include_bytes!("../../../../tests/data/import/deepdish.h5");
const BLOSC: &[u8] = include_bytes!("../../../../tests/data/import/deepdish-blosc.h5");

/// Temporary directory for files and datasets.
struct Workspace(TempDir);

impl Workspace {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }

    fn out(&self) -> PathBuf {
        self.0.path().join("dataset")
    }

    fn import(&self, files: &[PathBuf], split: &str) -> Result<ImportReport> {
        import_feeling_of_success(files, &self.out(), &split.parse()?, &|_, _| {})
    }

    #[track_caller]
    fn refused(&self, bytes: &[u8], expected: &str) -> Error {
        let path = self.file("refused.h5", bytes);
        let error = self.import(&[path], "test").unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains(expected) && text.contains("refused.h5"),
            "{text}"
        );
        assert!(!self.out().exists(), "{text}");
        error
    }
}

fn rows(out: &Path, split: &str) -> Vec<ShardRow> {
    let set = ShardSet::open(out).unwrap();
    set.rows(split).unwrap().map(Result::unwrap).collect()
}

fn colour(jpeg: &[u8]) -> [u8; 3] {
    let image = Decoder::new().unwrap().stored_image(jpeg).unwrap();
    assert_eq!(image.dimensions(), (320, 240));
    image.get_pixel(160, 120).0
}

#[track_caller]
fn near(found: [u8; 3], expected: [u8; 3]) {
    let is_near = found.iter().zip(expected).all(|(a, b)| a.abs_diff(b) < 6);
    assert!(is_near, "{found:?} {expected:?}");
}

/// A grasp of a synthetic file; `None` omits a key.
#[derive(Clone)]
struct GraspSpec {
    label: Option<AttrValue>,
    object: Option<&'static str>,
    during: Option<(Vec<u8>, Vec<u64>)>,
}

impl GraspSpec {
    fn new() -> Self {
        Self {
            label: Some(AttrValue::I64(1)),
            object: Some("duck"),
            during: Some((vec![7; 6 * 8 * 3], vec![6, 8, 3])),
        }
    }

    fn with(change: impl FnOnce(&mut Self)) -> Self {
        let mut spec = Self::new();
        change(&mut spec);
        spec
    }
}

fn write(list: &str, specs: &[GraspSpec]) -> Vec<u8> {
    let mut file = FileBuilder::new();
    let mut data = file.create_group(list);
    for (number, spec) in specs.iter().enumerate() {
        let mut grasp = data.create_group(&format!("i{number}"));
        if let Some(label) = &spec.label {
            grasp.set_attr("is_gripping", label.clone());
        }
        if let Some(object) = spec.object {
            grasp.set_attr("object_name", AttrValue::String(object.to_owned()));
        }
        for key in [
            "gelsightA_before",
            "gelsightB_before",
            "gelsightB_during",
            "kinectA_rgb_during",
        ] {
            grasp
                .create_dataset(key)
                .with_u8_data(&[90; 6 * 8 * 3])
                .with_shape(&[6, 8, 3]);
        }
        if let Some((bytes, shape)) = &spec.during {
            grasp
                .create_dataset("gelsightA_during")
                .with_u8_data(bytes)
                .with_shape(shape);
        }
        data.add_group(grasp.finish());
    }
    file.add_group(data.finish());
    file.finish().unwrap()
}

#[test]
fn imports_files_of_deepdish() {
    let bench = Workspace::new();
    let path = bench.file("calandra_corl2017_000.h5", DEEPDISH);
    let report = bench.import(&[path], "test").unwrap();
    assert!(report.is_finished && report.left_out.is_empty());
    let counts = &report.splits["test"];
    assert_eq!((counts.stable, counts.slip, counts.objects), (4, 8, 2));
    let rows = rows(&bench.out(), "test");
    assert_eq!(rows.len(), 12);
    for (number, row) in rows.iter().enumerate() {
        let facts = &row.facts;
        assert_eq!(facts.id, format!("calandra_corl2017_000-i{number}"));
        assert_eq!(facts.object, ["soap bar", "duck"][number % 2]);
        assert_eq!(facts.outcome.label() == 1, number % 3 == 0);
        assert_eq!(facts.engine, ShardEngine::Real);
        assert_eq!(facts.crop_profile, "gelsight-2017-full-v1");
        assert_eq!((facts.mass_kg, facts.stop_force_n), (None, None));
        assert_eq!(facts.t_object_gripper, None);
        near(colour(&row.images.initial_left), [200, 40, 40]);
        near(colour(&row.images.grasp_left), [40, 200, 40]);
        near(colour(&row.images.initial_right), [40, 40, 200]);
        near(colour(&row.images.grasp_right), [200, 200, 40]);
        near(colour(&row.images.grasp_rgb), [200, 40, 200]);
    }
}

#[test]
fn object_is_in_one_split() {
    let bench = Workspace::new();
    let files = ["a.h5", "b.h5"].map(|name| bench.file(name, DEEPDISH));
    let report = bench.import(&files, "train=0.5,test=0.5").unwrap();
    let objects = |split| -> Vec<String> {
        let rows = rows(&bench.out(), split);
        assert_eq!(rows.len(), 12);
        rows.into_iter().map(|row| row.facts.object).collect()
    };
    let (train, test) = (objects("train"), objects("test"));
    assert!(train.iter().all(|object| !test.contains(object)));
    assert_eq!(report.splits["train"].objects, 1);
    let error = bench.import(&files[..1], "train=0.9,a=0.05,b=0.05");
    assert!(error.unwrap_err().to_string().contains("only 2 objects"));
}

#[test]
fn labels_names_and_images_may_have_several_types() {
    let bench = Workspace::new();
    let jpeg = encode_jpeg(&RgbImage::from_pixel(64, 48, Rgb([10, 220, 30])), 95).unwrap();
    let length = jpeg.len() as u64;
    let specs = [
        GraspSpec::with(|s| s.label = Some(AttrValue::U8(0))),
        GraspSpec::with(|s| s.label = Some(AttrValue::F64(1.0))),
        GraspSpec::with(|s| s.label = Some(AttrValue::I64Array(vec![1]))),
        GraspSpec::with(|s| s.during = Some((jpeg, vec![length]))),
    ];
    let path = bench.file("forms.h5", &write("_top", &specs));
    let report = bench.import(&[path], "test").unwrap();
    let counts = &report.splits["test"];
    assert_eq!((counts.stable, counts.slip), (3, 1), "{report:?}");
    let rows = rows(&bench.out(), "test");
    near(colour(&rows[3].images.grasp_left), [10, 220, 30]);
}

#[test]
fn other_files_are_refused_before_writing() {
    let bench = Workspace::new();
    let error = bench.refused(b"kinect", "not an HDF5 file");
    assert!(error.remedy_text().unwrap().contains("calandra_corl2017"));
    bench.refused(b"", "not an HDF5 file");
    bench.refused(
        &write("steps", &[GraspSpec::new()]),
        "`data` not found; the file has steps",
    );
    bench.refused(&write("data", &[]), "no grasps in `data`");
    let one = |change: fn(&mut GraspSpec)| write("data", &[GraspSpec::with(change)]);
    bench.refused(
        &one(|s| s.during = None),
        "`gelsightA_during` not found; the file has gelsightA_before, gelsightB_before, gelsightB_during, \
         is_gripping, kinectA_rgb_during, object_name",
    );
    bench.refused(&one(|s| s.label = None), "`is_gripping` not found");
    bench.refused(&one(|s| s.object = None), "`object_name` not found");
    for name in [" ", "a/b", "../../x", "/etc/x", "a\u{1b}[2J"] {
        let spec = GraspSpec::with(|s| s.object = Some(name));
        bench.refused(&write("data", &[spec]), "object_name: invalid object name");
    }
    bench.refused(
        &one(|s| s.label = Some(AttrValue::I64(2))),
        "expected 0 or 1 in `is_gripping`, found 2",
    );
    bench.refused(
        &one(|s| s.label = Some(AttrValue::String("yes".to_owned()))),
        "expected one number in `is_gripping`",
    );
    bench.refused(
        &one(|s| s.during = Some((vec![1; 48], vec![6, 8]))),
        "expected [height, width, 3], or the bytes of a JPEG or PNG in `gelsightA_during`",
    );
    let mut file = FileBuilder::new();
    file.create_dataset("data").with_u8_data(b"pickled");
    bench.refused(&file.finish().unwrap(), "expected a group `data`");
    let gone = bench.import(&[bench.0.path().join("gone.h5")], "test");
    assert_eq!(gone.unwrap_err().kind(), ErrorKind::NotFound);
    let folder = bench.import(&[bench.0.path().to_owned()], "test");
    assert_eq!(folder.unwrap_err().kind(), ErrorKind::Input);
}

#[test]
fn damaged_grasps_are_left_out_and_listed() {
    let unreadable = Workspace::new();
    let spec = GraspSpec::with(|s| s.during = Some((b"GIF89a".to_vec(), vec![6])));
    let path = unreadable.file("a.h5", &write("data", &[spec]));
    let error = unreadable.import(&[path], "test").unwrap_err().to_string();
    assert!(
        error.contains("no readable grasp in the split `test`"),
        "{error}"
    );
    assert!(error.contains("gelsightA_during"), "{error}");
    let bench = Workspace::new();
    let specs = [
        GraspSpec::new(),
        GraspSpec::with(|s| s.label = Some(AttrValue::I64(-1))),
        GraspSpec::with(|s| s.during = Some((b"\xff\xd8\xff\xe0 cut".to_vec(), vec![8]))),
        GraspSpec::with(|s| s.during = Some((b"GIF89a".to_vec(), vec![6]))),
        GraspSpec::new(),
    ];
    let path = bench.file("a.h5", &write("data", &specs));
    let report = bench.import(&[path], "test").unwrap();
    let left_out: Vec<&str> = report.left_out.iter().map(|one| &*one.id).collect();
    assert_eq!(left_out, ["a-i1", "a-i2", "a-i3"], "{report:?}");
    assert!(report.left_out[1].reason.contains("gelsightA_during"));
    let ids: Vec<String> = rows(&bench.out(), "test")
        .into_iter()
        .map(|r| r.facts.id)
        .collect();
    assert_eq!(ids, ["a-i0", "a-i4"]);
}

#[test]
fn unsupported_compression_has_a_remedy() {
    let error = Workspace::new().refused(BLOSC, "compression filter 32001");
    assert!(error.remedy_text().unwrap().contains("ptrepack"));
}

#[test]
fn interrupted_import_is_restarted_only_in_its_directory() {
    let bench = Workspace::new();
    let files = [bench.file("a.h5", DEEPDISH)];
    let stopped = std::panic::catch_unwind(|| {
        let split = SplitFractions::single("test").unwrap();
        import_feeling_of_success(&files, &bench.out(), &split, &|done, _| {
            assert!(done < 7, "stopped");
        })
    });
    assert!(stopped.is_err());
    assert!(ShardSet::open(bench.out()).is_err());
    let other = bench.import(&[bench.file("b.h5", DEEPDISH)], "test");
    let text = other.unwrap_err().to_string();
    assert!(text.contains("another unfinished import"), "{text}");
    let report = bench.import(&files, "test").unwrap();
    assert_eq!(report.splits["test"].stable, 4);
    assert_eq!(ImportReport::read(&bench.out()).unwrap(), report);
    let second = bench.import(&files, "test").unwrap_err();
    assert!(second.to_string().contains("a finished import"), "{second}");
    fs::remove_file(bench.out().join("import.json")).unwrap();
    let full = bench.import(&files, "test").unwrap_err();
    assert!(
        full.to_string().contains("the directory contains data"),
        "{full}"
    );
    let twice = bench.import(&[files[0].clone(), files[0].clone()], "test");
    assert_eq!(twice.unwrap_err().kind(), ErrorKind::Usage);
}

#[test]
fn import_does_not_resume_through_a_link() {
    let bench = Workspace::new();
    let files = [bench.file("a.h5", DEEPDISH)];
    let split = SplitFractions::single("test").unwrap();
    let report = ImportReport::new("feeling-of-success", sources(&files).unwrap(), &split);
    report.claim(&bench.out()).unwrap();
    let elsewhere = bench.0.path().join("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    std::os::unix::fs::symlink(&elsewhere, bench.out().join("data")).unwrap();
    bench.import(&files, "test").unwrap_err();
    assert_eq!(fs::read_dir(&elsewhere).unwrap().count(), 0);
}

/// Whether the import detected the damage; its output is complete in any case.
fn detects(damaged: &[u8]) -> bool {
    let bench = Workspace::new();
    let imported = bench.import(&[bench.file("a.h5", damaged)], "test");
    let Ok(report) = imported else {
        // No complete dataset.
        assert!(ShardSet::open(bench.out()).is_err());
        return true;
    };
    assert_eq!(ImportReport::read(&bench.out()).unwrap(), report);
    let counts = &report.splits["test"];
    assert_eq!(
        rows(&bench.out(), "test").len(),
        counts.stable + counts.slip
    );
    !report.left_out.is_empty() || counts.stable + counts.slip < 12
}

#[test]
fn damaged_files_give_errors_or_reports() {
    let mut stream = 1_u64;
    let mut random = || {
        stream = stream
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (stream >> 33) as usize
    };
    for fraction in 1..8 {
        assert!(
            detects(&DEEPDISH[..DEEPDISH.len() * fraction / 8]),
            "{fraction}"
        );
    }
    let mut detected = 0;
    for _ in 0..60 {
        let mut damaged = DEEPDISH.to_vec();
        for _ in 0..40 {
            let offset = random() % damaged.len();
            damaged[offset] = random() as u8;
        }
        detected += usize::from(detects(&damaged));
    }
    // Damaged pixels of a raw image are not detectable.
    assert!(detected > 0);
}
