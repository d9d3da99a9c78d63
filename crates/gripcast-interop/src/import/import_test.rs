//! Files that deepdish wrote (`tests/peers/feeling_of_success.py`), and others made up here.

use std::fs;
use std::path::{Path, PathBuf};

use hdf5_pure::{AttrValue, FileBuilder};
use image::{Rgb, RgbImage};
use tempfile::TempDir;

use super::run::sources;
use super::*;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::shard::{ShardEngine, ShardRow, ShardSet, Split};
use gripcast_imaging::{Decoder, encode_jpeg};

const DEEPDISH: &[u8] = include_bytes!("../../../../tests/data/import/deepdish.h5");
const BLOSC: &[u8] = include_bytes!("../../../../tests/data/import/deepdish-blosc.h5");

/// A place for files and datasets.
struct Bench(TempDir);

impl Bench {
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
    fn refused(&self, bytes: &[u8], on_progress: &str) -> Error {
        let path = self.file("refused.h5", bytes);
        let error = self.import(&[path], "test").unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains(on_progress) && text.contains("refused.h5"),
            "{text}"
        );
        assert!(!self.out().exists(), "{text}");
        error
    }
}

fn rows(out: &Path, part: &str) -> Vec<ShardRow> {
    let set = ShardSet::open(out).unwrap();
    set.rows(part).unwrap().map(Result::unwrap).collect()
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

/// A grasp of a made-up file; none leaves a key out.
#[derive(Clone)]
struct Sketch {
    label: Option<AttrValue>,
    object: Option<&'static str>,
    during: Option<(Vec<u8>, Vec<u64>)>,
}

impl Sketch {
    fn new() -> Self {
        Self {
            label: Some(AttrValue::I64(1)),
            object: Some("duck"),
            during: Some((vec![7; 6 * 8 * 3], vec![6, 8, 3])),
        }
    }

    fn with(change: impl FnOnce(&mut Self)) -> Self {
        let mut sketch = Self::new();
        change(&mut sketch);
        sketch
    }
}

fn write(list: &str, sketches: &[Sketch]) -> Vec<u8> {
    let mut file = FileBuilder::new();
    let mut data = file.create_group(list);
    for (number, sketch) in sketches.iter().enumerate() {
        let mut grasp = data.create_group(&format!("i{number}"));
        if let Some(label) = &sketch.label {
            grasp.set_attr("is_gripping", label.clone());
        }
        if let Some(object) = sketch.object {
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
        if let Some((bytes, shape)) = &sketch.during {
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
fn what_deepdish_wrote_is_imported() {
    let bench = Bench::new();
    let path = bench.file("calandra_corl2017_000.h5", DEEPDISH);
    let report = bench.import(&[path], "test").unwrap();
    assert!(report.is_finished && report.left_out.is_empty());
    let part = &report.parts["test"];
    assert_eq!((part.stable, part.slip, part.objects), (4, 8, 2));
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
fn objects_are_kept_together() {
    let bench = Bench::new();
    let files = ["a.h5", "b.h5"].map(|name| bench.file(name, DEEPDISH));
    let report = bench.import(&files, "train=0.5,test=0.5").unwrap();
    let objects = |part| -> Vec<String> {
        let rows = rows(&bench.out(), part);
        assert_eq!(rows.len(), 12);
        rows.into_iter().map(|row| row.facts.object).collect()
    };
    let (train, test) = (objects("train"), objects("test"));
    assert!(train.iter().all(|object| !test.contains(object)));
    assert_eq!(report.parts["train"].objects, 1);
    let error = bench.import(&files[..1], "train=0.9,a=0.05,b=0.05");
    assert!(error.unwrap_err().to_string().contains("only 2 objects"));
}

#[test]
fn labels_names_and_images_have_several_forms() {
    let bench = Bench::new();
    let jpeg = encode_jpeg(&RgbImage::from_pixel(64, 48, Rgb([10, 220, 30])), 95).unwrap();
    let length = jpeg.len() as u64;
    let sketches = [
        Sketch::with(|s| s.label = Some(AttrValue::U8(0))),
        Sketch::with(|s| s.label = Some(AttrValue::F64(1.0))),
        Sketch::with(|s| s.label = Some(AttrValue::I64Array(vec![1]))),
        Sketch::with(|s| s.during = Some((jpeg, vec![length]))),
    ];
    let path = bench.file("forms.h5", &write("_top", &sketches));
    let report = bench.import(&[path], "test").unwrap();
    let part = &report.parts["test"];
    assert_eq!((part.stable, part.slip), (3, 1), "{report:?}");
    let rows = rows(&bench.out(), "test");
    near(colour(&rows[3].images.grasp_left), [10, 220, 30]);
}

#[test]
fn files_of_another_kind_are_refused_before_anything_is_written() {
    let bench = Bench::new();
    let error = bench.refused(b"kinect", "this is no HDF5 file");
    assert!(error.remedy_text().unwrap().contains("calandra_corl2017"));
    bench.refused(b"", "this is no HDF5 file");
    bench.refused(
        &write("steps", &[Sketch::new()]),
        "no `data`; there is steps",
    );
    bench.refused(&write("data", &[]), "there is no grasp in `data`");
    let one = |change: fn(&mut Sketch)| write("data", &[Sketch::with(change)]);
    bench.refused(
        &one(|s| s.during = None),
        "no `gelsightA_during`; there is gelsightA_before, gelsightB_before, gelsightB_during, \
         is_gripping, kinectA_rgb_during, object_name",
    );
    bench.refused(&one(|s| s.label = None), "there is no `is_gripping`");
    bench.refused(&one(|s| s.object = None), "there is no `object_name`");
    for name in [" ", "a/b", "../../x", "/etc/x", "a\u{1b}[2J"] {
        let sketch = Sketch::with(|s| s.object = Some(name));
        bench.refused(
            &write("data", &[sketch]),
            "object_name: invalid object name",
        );
    }
    bench.refused(
        &one(|s| s.label = Some(AttrValue::I64(2))),
        "`is_gripping` must be 0 or 1, found 2",
    );
    bench.refused(
        &one(|s| s.label = Some(AttrValue::String("yes".to_owned()))),
        "`is_gripping` must be one number",
    );
    bench.refused(
        &one(|s| s.during = Some((vec![1; 48], vec![6, 8]))),
        "`gelsightA_during` must be [height, width, 3]",
    );
    let mut file = FileBuilder::new();
    file.create_dataset("data").with_u8_data(b"pickled");
    bench.refused(&file.finish().unwrap(), "`data` must be a group");
    let gone = bench.import(&[bench.0.path().join("gone.h5")], "test");
    assert_eq!(gone.unwrap_err().kind(), ErrorKind::NotFound);
    let folder = bench.import(&[bench.0.path().to_owned()], "test");
    assert_eq!(folder.unwrap_err().kind(), ErrorKind::Input);
}

#[test]
fn damaged_grasps_are_left_out_and_told() {
    let hopeless = Bench::new();
    let sketch = Sketch::with(|s| s.during = Some((b"GIF89a".to_vec(), vec![6])));
    let path = hopeless.file("a.h5", &write("data", &[sketch]));
    let error = hopeless.import(&[path], "test").unwrap_err().to_string();
    assert!(error.contains("no grasp of the part `test`"), "{error}");
    assert!(error.contains("gelsightA_during"), "{error}");
    let bench = Bench::new();
    let sketches = [
        Sketch::new(),
        Sketch::with(|s| s.label = Some(AttrValue::I64(-1))),
        Sketch::with(|s| s.during = Some((b"\xff\xd8\xff\xe0 cut".to_vec(), vec![8]))),
        Sketch::with(|s| s.during = Some((b"GIF89a".to_vec(), vec![6]))),
        Sketch::new(),
    ];
    let path = bench.file("a.h5", &write("data", &sketches));
    let report = bench.import(&[path], "test").unwrap();
    let left_out: Vec<&str> = report.left_out.iter().map(|one| &*one.id).collect();
    assert_eq!(left_out, ["a-i1", "a-i2", "a-i3"], "{report:?}");
    assert!(report.left_out[1].why.contains("gelsightA_during"));
    let ids: Vec<String> = rows(&bench.out(), "test")
        .into_iter()
        .map(|r| r.facts.id)
        .collect();
    assert_eq!(ids, ["a-i0", "a-i4"]);
}

#[test]
fn unknown_compression_is_named_with_its_remedy() {
    let error = Bench::new().refused(BLOSC, "compressed with the filter 32001");
    assert!(error.remedy_text().unwrap().contains("ptrepack"));
}

#[test]
fn a_stopped_import_is_begun_again_and_no_other_folder_is_touched() {
    let bench = Bench::new();
    let files = [bench.file("a.h5", DEEPDISH)];
    let stopped = std::panic::catch_unwind(|| {
        let split = Split::one("test").unwrap();
        import_feeling_of_success(&files, &bench.out(), &split, &|done, _| {
            assert!(done < 7, "stopped");
        })
    });
    assert!(stopped.is_err());
    assert!(ShardSet::open(bench.out()).is_err());
    let other = bench.import(&[bench.file("b.h5", DEEPDISH)], "test");
    let text = other.unwrap_err().to_string();
    assert!(text.contains("the beginning of another import"), "{text}");
    let report = bench.import(&files, "test").unwrap();
    assert_eq!(report.parts["test"].stable, 4);
    assert_eq!(ImportReport::read(&bench.out()).unwrap(), report);
    let again = bench.import(&files, "test").unwrap_err();
    assert!(again.to_string().contains("a finished import"), "{again}");
    fs::remove_file(bench.out().join("import.json")).unwrap();
    let full = bench.import(&files, "test").unwrap_err();
    assert!(full.to_string().contains("something else: data"), "{full}");
    let twice = bench.import(&[files[0].clone(), files[0].clone()], "test");
    assert_eq!(twice.unwrap_err().kind(), ErrorKind::Usage);
}

#[test]
fn a_begun_import_whose_folder_leads_elsewhere_is_not_gone_on_with() {
    let bench = Bench::new();
    let files = [bench.file("a.h5", DEEPDISH)];
    let split = Split::one("test").unwrap();
    let report = ImportReport::new("feeling-of-success", sources(&files).unwrap(), &split);
    report.claim(&bench.out()).unwrap();
    let elsewhere = bench.0.path().join("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    std::os::unix::fs::symlink(&elsewhere, bench.out().join("data")).unwrap();
    bench.import(&files, "test").unwrap_err();
    assert_eq!(fs::read_dir(&elsewhere).unwrap().count(), 0);
}

/// Whether the import noticed the damage; what it wrote is whole in any case.
fn notices(damaged: &[u8]) -> bool {
    let bench = Bench::new();
    let imported = bench.import(&[bench.file("a.h5", damaged)], "test");
    let Ok(report) = imported else {
        // Nothing that could be taken for a finished dataset.
        assert!(ShardSet::open(bench.out()).is_err());
        return true;
    };
    assert_eq!(ImportReport::read(&bench.out()).unwrap(), report);
    let part = &report.parts["test"];
    assert_eq!(rows(&bench.out(), "test").len(), part.stable + part.slip);
    !report.left_out.is_empty() || part.stable + part.slip < 12
}

#[test]
fn damaged_files_end_in_errors_or_reports() {
    let mut stream = 1_u64;
    let mut random = || {
        stream = stream
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (stream >> 33) as usize
    };
    for fraction in 1..8 {
        assert!(
            notices(&DEEPDISH[..DEEPDISH.len() * fraction / 8]),
            "{fraction}"
        );
    }
    let mut noticed = 0;
    for _ in 0..60 {
        let mut damaged = DEEPDISH.to_vec();
        for _ in 0..40 {
            let at = random() % damaged.len();
            damaged[at] = random() as u8;
        }
        noticed += usize::from(notices(&damaged));
    }
    // Damaged pixels of a raw image cannot be seen.
    assert!(noticed > 0);
}
