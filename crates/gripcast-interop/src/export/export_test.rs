//! Exports a small dataset in every format and reads the files with independent code. One file,
//! because all formats share the fixture and its readers.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use flate2::read::ZlibDecoder;
use parquet::file::reader::{FileReader as _, SerializedFileReader};
use parquet::record::{Row, RowAccessor as _};
use serde_json::Value;

use super::{ExportFormat, ExportPlan, ExportReport, export};
use gripcast_base::error::{ErrorKind, Result};
use gripcast_dataset::sample::{capture, meta, new_dataset};
use gripcast_dataset::shard::{ShardEngine, ShardOutcome, ShardRow, ShardSet};
use gripcast_dataset::{
    Dataset, DatasetWriter, GraspId, GroupKey, Outcome, PoseRecord, SplitPlan, Stage, StageCapture,
    split,
};
use gripcast_imaging::{CropProfile, Decoder, Role, decode_png_grey16, jpeg::inspect};

const FORMATS: [ExportFormat; 5] = [
    ExportFormat::Parquet,
    ExportFormat::WebDataset,
    ExportFormat::LeRobot,
    ExportFormat::Zarr,
    ExportFormat::Training,
];

/// A stable mug with a pose and padded images without Huffman tables; a slipped bottle; a sponge
/// without label, depth and prediction.
fn dataset() -> (tempfile::TempDir, Vec<GraspId>) {
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, _) =
        DatasetWriter::open_or_create(dir.path().join("d"), &new_dataset()).unwrap();
    let mut ids = Vec::new();
    for (number, object) in (0..).zip(["mug", "bottle", "sponge"]) {
        let mut stages = [capture(2 * number + 1), capture(2 * number + 2)];
        let mut meta = meta(object);
        if number == 0 {
            for stage in &mut stages {
                let left = &mut stage.cameras.get_mut(&Role::Left).unwrap().frame;
                left.data = bare(&left.data).into();
            }
        }
        if number == 2 {
            stages
                .iter_mut()
                .for_each(|s| drop(s.cameras.remove(&Role::Depth)));
            meta.prediction = None;
        }
        let pending = writer.save_initial(&stages[0], Vec::new()).unwrap();
        let record = writer.save_grasp(&pending, &stages[1], meta).unwrap();
        let at = "2026-11-20T11:00:00Z".parse().unwrap();
        match number {
            0 => {
                writer
                    .set_outcome(&record.id, Outcome::Stable, at, None)
                    .unwrap();
                writer.set_pose(&record.id, pose()).unwrap();
            }
            1 => drop(
                writer
                    .set_outcome(&record.id, Outcome::Slip, at, None)
                    .unwrap(),
            ),
            _ => {}
        }
        ids.push(record.id);
    }
    (dir, ids)
}

fn pose() -> PoseRecord {
    PoseRecord {
        t_m: [0.5, -0.25, 0.125],
        q_wxyz: [1.0, 0.0, 0.0, 0.0],
        frame: "t_object_gripper".into(),
        covariance: None,
        reprojection_px: None,
        corrected_by_hand: true,
        quality: None,
    }
}

/// A JPEG as some cameras send it: without Huffman tables, with padding.
fn bare(jpeg: &[u8]) -> Vec<u8> {
    let mut out = jpeg[..2].to_vec();
    let mut offset = 2;
    while jpeg[offset + 1] != 0xda {
        let end =
            offset + 2 + usize::from(u16::from_be_bytes([jpeg[offset + 2], jpeg[offset + 3]]));
        if jpeg[offset + 1] != 0xc4 {
            out.extend_from_slice(&jpeg[offset..end]);
        }
        offset = end;
    }
    out.extend_from_slice(&jpeg[offset..]);
    out.extend([0; 40]);
    out
}

fn run(root: &Path, out: &Path, plan: &ExportPlan) -> Result<ExportReport> {
    let dataset = Dataset::open(root.join("d"))?;
    export(&dataset, out, plan, &|done, all| {
        assert!(done <= all);
        assert!(!out.exists(), "renamed before it is complete");
    })
}

/// Contents of all files by name, or of the single file.
fn contents(out: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut paths = vec![out.to_owned()];
    while let Some(path) = paths.pop() {
        if path.is_dir() {
            paths.extend(fs::read_dir(path).unwrap().map(|e| e.unwrap().path()));
        } else {
            let name = path.strip_prefix(out).unwrap().to_owned();
            files.insert(name, fs::read(path).unwrap());
        }
    }
    files
}

fn names(out: &Path) -> Vec<String> {
    let name = |path: PathBuf| path.to_string_lossy().into_owned();
    contents(out).into_keys().map(name).collect()
}

fn rows(path: &Path) -> Vec<Row> {
    let file = SerializedFileReader::new(fs::File::open(path).unwrap()).unwrap();
    let rows = file.get_row_iter(None).unwrap();
    rows.map(std::result::Result::unwrap).collect()
}

/// Index of a column.
fn column_index(row: &Row, column: &str) -> usize {
    row.get_column_iter()
        .position(|(name, _)| name == column)
        .unwrap()
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn equal_datasets_give_equal_bytes() {
    let (dir, _) = dataset();
    for format in FORMATS {
        let plan = ExportPlan::new(format);
        let [a, b] = ["a", "b"].map(|name| dir.path().join(format!("{name}-{format}.zip")));
        let report = run(dir.path(), &a, &plan).unwrap();
        run(dir.path(), &b, &plan).unwrap();
        assert_eq!(contents(&a), contents(&b), "{format}");
        assert_eq!(report.files, contents(&a).len());
        assert_eq!(
            report.bytes,
            contents(&a).values().map(|f| f.len() as u64).sum::<u64>()
        );
        assert!(report.left_out.is_empty());
    }
}

#[test]
fn parquet_has_one_row_per_grasp_with_nulls() {
    let (dir, ids) = dataset();
    let out = dir.path().join("out");
    let report = run(dir.path(), &out, &ExportPlan::new(ExportFormat::Parquet)).unwrap();
    assert_eq!(report.grasps, 3);
    assert_eq!(names(&out), ["data/train-00000-of-00001.parquet"]);
    let rows = rows(&out.join("data/train-00000-of-00001.parquet"));
    for (row, id) in rows.iter().zip(&ids) {
        assert_eq!(
            row.get_string(column_index(row, "id")).unwrap(),
            id.as_str()
        );
        let record: Value =
            serde_json::from_str(row.get_string(column_index(row, "record")).unwrap()).unwrap();
        assert_eq!(record["id"], id.as_str());
    }
    let labels = rows
        .iter()
        .map(|row| row.get_long(column_index(row, "label")).ok());
    assert_eq!(labels.collect::<Vec<_>>(), [Some(1), Some(0), None]);
    let is_null = |row: usize, column: &str| {
        let field = rows[row]
            .get_column_iter()
            .find(|(name, _)| *name == column);
        *field.unwrap().1 == parquet::record::Field::Null
    };
    assert!(!is_null(0, "pose_t_m") && is_null(1, "pose_t_m"));
    assert!(!is_null(1, "predicted_p_stable") && is_null(2, "predicted_p_stable"));
    let left = rows[0]
        .get_group(column_index(&rows[0], "grasp_left"))
        .unwrap();
    assert_eq!(left.get_string(1).unwrap(), "grasp.left.jpg");
    let header = inspect(left.get_bytes(0).unwrap().data()).unwrap();
    assert!(header.has_huffman_tables);
    let depth = rows[2].get_group(column_index(&rows[2], "grasp_depth"));
    assert!(depth.is_err() || depth.unwrap().get_bytes(0).is_err());
}

#[test]
fn shards_are_bounded_and_numbered() {
    let (dir, ids) = dataset();
    let mut plan = ExportPlan::new(ExportFormat::Parquet);
    plan.shard_bytes = 1;
    let out = dir.path().join("parquet");
    run(dir.path(), &out, &plan).unwrap();
    let shard = |i: usize| format!("data/train-{i:05}-of-00003.parquet");
    assert_eq!(names(&out), [shard(0), shard(1), shard(2)]);
    let row = &rows(&out.join(shard(2)))[0];
    assert_eq!(row.get_string(0).unwrap(), ids[2].as_str());
    plan.format = ExportFormat::WebDataset;
    let out = dir.path().join("tar");
    run(dir.path(), &out, &plan).unwrap();
    assert_eq!(names(&out).len(), 3);
}

/// Key of a sample, and extension and bytes of each of its files.
type Sample = (String, Vec<(String, Vec<u8>)>);

/// Samples of a tar file.
fn samples(path: &Path) -> Vec<Sample> {
    let mut samples: Vec<Sample> = Vec::new();
    let file = fs::File::open(path).unwrap();
    for entry in tar::Archive::new(file).entries().unwrap() {
        let mut entry = entry.unwrap();
        let header = entry.header();
        assert_eq!((header.mtime().unwrap(), header.uid().unwrap()), (0, 0));
        let name = entry.path().unwrap().to_string_lossy().into_owned();
        let (key, rest) = name.split_once('.').unwrap();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        match samples.last_mut().filter(|(last, _)| last == key) {
            Some((_, files)) => files.push((rest.to_owned(), bytes)),
            None => samples.push((key.to_owned(), vec![(rest.to_owned(), bytes)])),
        }
    }
    samples
}

/// Name of a JSON value's type; lists with the types of their elements.
fn type_of(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(_) => "bool".to_owned(),
        Value::Number(number) if number.is_f64() => "float".to_owned(),
        Value::Number(_) => "int".to_owned(),
        Value::String(_) => "text".to_owned(),
        Value::Array(list) => format!("{:?}", list.iter().map(type_of).collect::<Vec<_>>()),
        Value::Object(_) => "object".to_owned(),
    }
}

#[test]
fn webdataset_samples_have_equal_fields_and_types() {
    let (dir, ids) = dataset();
    let out = dir.path().join("out");
    let report = run(dir.path(), &out, &ExportPlan::new(ExportFormat::WebDataset)).unwrap();
    let lacking = "grasp_depth: black where `has_grasp_depth` is false, 1 grasps";
    assert_eq!(report.notes, [lacking]);
    let samples = samples(&out.join("train-000000.tar"));
    let found: Vec<&str> = samples.iter().map(|(key, _)| key.as_str()).collect();
    assert_eq!(found, ids.iter().map(GraspId::as_str).collect::<Vec<_>>());
    let mut types = Vec::new();
    for (key, files) in &samples {
        let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
        let expected = [
            "json",
            "initial_left.jpg",
            "initial_right.jpg",
            "initial_rgb.png",
            "grasp_left.jpg",
            "grasp_right.jpg",
            "grasp_rgb.png",
            "grasp_depth.png",
        ];
        assert_eq!(names, expected);
        let facts: Value = serde_json::from_slice(&files[0].1).unwrap();
        let record = fs::read_to_string(dir.path().join(format!("d/grasps/{key}/grasp.json")));
        assert_eq!(facts["record"], record.unwrap());
        let of_sample: BTreeMap<String, String> = facts
            .as_object()
            .unwrap()
            .iter()
            .map(|(name, value)| (name.clone(), type_of(value)))
            .collect();
        assert!(!of_sample.values().any(|kind| kind.contains("null")));
        types.push(of_sample);
        for (name, bytes) in files.iter().filter(|(name, _)| name.ends_with("jpg")) {
            let header = inspect(bytes).unwrap();
            assert!(
                header.has_huffman_tables && header.end == bytes.len(),
                "{name}"
            );
        }
    }
    assert!(types.iter().all(|of_sample| *of_sample == types[0]));
    let facts =
        |sample: usize| -> Value { serde_json::from_slice(&samples[sample].1[0].1).unwrap() };
    let (mug, sponge) = (facts(0), facts(2));
    assert_eq!((&mug["label"], &sponge["label"]), (&1.into(), &(-1).into()));
    assert_eq!(
        (&mug["has_pose"], &sponge["has_pose"]),
        (&true.into(), &false.into())
    );
    assert_eq!(sponge["has_prediction"], false);
    assert_eq!(sponge["predicted_p_stable"], -1.0);
    assert_eq!(
        (&sponge["labelled_at"], &sponge["predicted_model"]),
        (&"".into(), &"".into())
    );
    assert_eq!(
        sponge["pose_q_wxyz"],
        serde_json::json!([0.0, 0.0, 0.0, 0.0])
    );
    assert_eq!(sponge["has_grasp_depth"], false);
    let depth = |sample: usize| decode_png_grey16(&samples[sample].1[7].1).unwrap();
    assert_eq!(depth(0).dimensions(), depth(2).dimensions());
    assert!(depth(2).iter().all(|count| *count == 0));
}

#[test]
fn path_that_readers_take_for_a_pattern_is_noted() {
    let (dir, _) = dataset();
    for (name, is_noted) in [("kitchen [1]", true), ("a*b", true), ("kitchen 1", false)] {
        let out = dir.path().join(name);
        let report = run(dir.path(), &out, &ExportPlan::new(ExportFormat::Parquet)).unwrap();
        let notes = report.notes.iter();
        assert_eq!(
            notes.filter(|note| note.contains("pattern")).count() == 1,
            is_noted,
            "{name}"
        );
    }
}

#[test]
fn webdataset_field_has_one_image_format() {
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, _) =
        DatasetWriter::open_or_create(dir.path().join("d"), &new_dataset()).unwrap();
    for number in 0..2 {
        let mut closed = capture(2 * number + 2);
        if number == 1 {
            // Another camera, which sends JPEG.
            let left = closed.cameras[&Role::Left].clone();
            closed.cameras.insert(Role::Rgb, left);
        }
        let pending = writer
            .save_initial(&capture(2 * number + 1), Vec::new())
            .unwrap();
        writer.save_grasp(&pending, &closed, meta("mug")).unwrap();
    }
    let out = dir.path().join("out");
    let report = run(dir.path(), &out, &ExportPlan::new(ExportFormat::WebDataset)).unwrap();
    assert_eq!(
        report.notes,
        ["grasp_rgb: 1 JPEG images became PNG, as the others are"]
    );
    let samples = samples(&out.join("train-000000.tar"));
    let (_, files) = &samples[1];
    let bytes = |wanted: &str| &files.iter().find(|(name, _)| name == wanted).unwrap().1;
    let mut decoder = Decoder::new().unwrap();
    let mut pixels = |bytes: &[u8]| decoder.stored_image(bytes).unwrap();
    assert!(bytes("grasp_rgb.png").starts_with(b"\x89PNG"));
    assert_eq!(
        pixels(bytes("grasp_rgb.png")),
        pixels(bytes("grasp_left.jpg"))
    );
}

#[test]
fn lerobot_episode_is_two_frames_of_a_labelled_grasp() {
    let (dir, ids) = dataset();
    let out = dir.path().join("out");
    let report = run(dir.path(), &out, &ExportPlan::new(ExportFormat::LeRobot)).unwrap();
    assert_eq!((report.grasps, report.unlabelled), (2, 1));
    assert!(report.notes.is_empty() && report.left_out.is_empty());
    let info = json(&out.join("meta/info.json"));
    assert_eq!(info["codebase_version"], "v3.0");
    assert_eq!(
        (&info["total_episodes"], &info["total_frames"]),
        (&2.into(), &4.into())
    );
    assert_eq!(info["splits"]["train"], "0:2");
    let left = &info["features"]["observation.images.left"];
    assert_eq!(left["shape"], serde_json::json!([8, 16, 3]));
    let frames = rows(&out.join("data/chunk-000/file-000.parquet"));
    let rewards = frames
        .iter()
        .map(|f| f.get_float(column_index(f, "next.reward")).unwrap());
    assert_eq!(rewards.collect::<Vec<_>>(), [0.0, 1.0, 0.0, 0.0]);
    let done = frames
        .iter()
        .map(|f| f.get_bool(column_index(f, "next.done")).unwrap());
    assert_eq!(done.collect::<Vec<_>>(), [false, true, false, true]);
    let poses = frames.iter().map(|f| {
        let pose = f
            .get_list(column_index(f, "observation.pose"))
            .unwrap()
            .elements();
        pose[0].clone()
    });
    let poses: Vec<_> = poses.map(|x| format!("{x}")).collect();
    assert_eq!(poses, ["0.5", "0.5", "NaN", "NaN"]);
    // Three channels, although the tactile images of the sample are grey.
    let image = frames[0]
        .get_group(column_index(&frames[0], "observation.images.left"))
        .unwrap();
    let image = image::load_from_memory(image.get_bytes(0).unwrap().data()).unwrap();
    assert_eq!(image.color(), image::ColorType::Rgb8);
    let episodes = rows(&out.join("meta/episodes/chunk-000/file-000.parquet"));
    let last = &episodes[1];
    assert_eq!(
        last.get_string(column_index(last, "gripcast/id")).unwrap(),
        ids[1].as_str()
    );
    assert_eq!(
        last.get_long(column_index(last, "dataset_from_index"))
            .unwrap(),
        2
    );
    let stats = json(&out.join("meta/stats.json"));
    assert_eq!(stats["next.success"]["mean"], serde_json::json!([0.25]));
    assert_eq!(stats["observation.pose"]["count"], serde_json::json!([2]));
    assert_eq!(
        stats["observation.images.rgb"]["mean"]
            .as_array()
            .unwrap()
            .len(),
        3
    );
}

#[test]
fn zarr_chunk_is_the_cropped_and_resized_image() {
    let (dir, ids) = dataset();
    let out = dir.path().join("out.zarr");
    let mut plan = ExportPlan::new(ExportFormat::Zarr);
    plan.size = (6, 4);
    let report = run(dir.path(), &out, &plan).unwrap();
    assert_eq!(report.notes, ["depth left out: images of 2 grasps"]);
    let array = json(&out.join("data/left/.zarray"));
    assert_eq!(array["shape"], serde_json::json!([6, 4, 6, 3]));
    let inflate = |name: &str| {
        let mut bytes = Vec::new();
        let mut stream = ZlibDecoder::new(fs::File::open(out.join(name)).unwrap());
        stream.read_to_end(&mut bytes).unwrap();
        bytes
    };
    let stored = dir
        .path()
        .join(format!("d/grasps/{}/grasp.left.jpg", ids[1]));
    let image = Decoder::new()
        .unwrap()
        .decode_file(
            &fs::read(stored).unwrap(),
            Some(&CropProfile::GSMINI_SEVENTH),
            6,
            4,
        )
        .unwrap();
    assert_eq!(inflate("data/left/3.0.0.0"), image.into_raw());
    let ends: Vec<i64> = inflate("meta/episode_ends/0")[..24]
        .chunks(8)
        .map(|b| i64::from_le_bytes(b.try_into().unwrap()))
        .collect();
    assert_eq!(ends, [2, 4, 6]);
    assert_eq!(inflate("meta/outcome/0")[..3], [1, 0, 255]);
    assert_eq!(json(&out.join("meta/object/.zarray"))["dtype"], "<U6");
    let bottle = &inflate("meta/object/0")[24..48];
    assert_eq!(
        bottle.iter().copied().step_by(4).collect::<Vec<u8>>(),
        b"bottle"
    );
    plan.size = (0, 4);
    let error = run(dir.path(), &dir.path().join("no"), &plan).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Usage);
}

#[test]
fn training_sample_has_the_pixels_of_the_live_path() {
    let (dir, ids) = dataset();
    let out = dir.path().join("out");
    let report = run(dir.path(), &out, &ExportPlan::new(ExportFormat::Training)).unwrap();
    assert_eq!((report.grasps, report.unlabelled), (2, 1));
    assert!(report.left_out.is_empty() && report.notes.is_empty());
    let set = ShardSet::open(&out).unwrap();
    let rows: Vec<ShardRow> = set.rows("test").unwrap().map(Result::unwrap).collect();
    let [mug, bottle] = &rows[..] else {
        panic!("{} rows", rows.len());
    };
    let facts = |row: &ShardRow| {
        let f = &row.facts;
        (f.id.clone(), f.object.clone(), f.outcome, f.engine)
    };
    let real = ShardEngine::Real;
    let stable = (ids[0].to_string(), "mug".into(), ShardOutcome::Stable, real);
    let slip = (
        ids[1].to_string(),
        "bottle".into(),
        ShardOutcome::Slip,
        real,
    );
    assert_eq!((facts(mug), facts(bottle)), (stable, slip));
    let pose = mug.facts.t_object_gripper.unwrap();
    assert_eq!(pose.translation_m.to_array(), [0.5, -0.25, 0.125]);
    assert!(bottle.facts.t_object_gripper.is_none() && bottle.facts.mass_kg.is_none());
    assert_eq!(mug.facts.crop_profile, "gsmini-seventh-v1");
    let dataset = Dataset::open(dir.path().join("d")).unwrap();
    let record = dataset.grasp(&ids[1]).unwrap();
    let mut decoder = Decoder::new().unwrap();
    for (role, stored) in [
        (Role::Left, &bottle.images.grasp_left),
        (Role::Right, &bottle.images.grasp_right),
    ] {
        let frame = dataset.load_frame(&record, Stage::Grasp, role).unwrap();
        let live = decoder.decode(&frame, Some(&CropProfile::GSMINI_SEVENTH), 320, 240);
        assert_eq!(decoder.stored_image(stored).unwrap(), live.unwrap());
    }
    assert_ne!(bottle.images.initial_left, bottle.images.grasp_left);
    let colour = decoder.stored_image(&bottle.images.grasp_rgb).unwrap();
    assert_eq!(colour.dimensions(), (320, 240));
    assert_eq!(mug.images.grasp_depth, None, "the lenses are unknown");
}

#[test]
fn depth_of_a_d435_is_in_training_samples_as_the_colour_image_shows_it() {
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, _) =
        DatasetWriter::open_or_create(dir.path().join("d"), &new_dataset()).unwrap();
    let mut stages = [capture(1), capture(2)];
    for stage in &mut stages {
        let depth = stage.cameras.get_mut(&Role::Depth).unwrap();
        depth.product = "Intel(R) RealSense(TM) Depth Camera 435".into();
        // A wall at 150 mm.
        depth.depth_unit_m = Some(5e-4);
        depth.frame.data = [44, 1].repeat(16 * 8).into();
    }
    let pending = writer.save_initial(&stages[0], Vec::new()).unwrap();
    let saved = writer.save_grasp(&pending, &stages[1], meta("mug"));
    let at = "2026-11-20T11:00:00Z".parse().unwrap();
    let id = saved.unwrap().id;
    writer.set_outcome(&id, Outcome::Slip, at, None).unwrap();
    drop(writer);
    let out = dir.path().join("out");
    run(dir.path(), &out, &ExportPlan::new(ExportFormat::Training)).unwrap();
    let set = ShardSet::open(&out).unwrap();
    let row = set.rows("test").unwrap().next().unwrap().unwrap();
    let depth = decode_png_grey16(&row.images.grasp_depth.unwrap()).unwrap();
    assert_eq!(depth.dimensions(), (320, 240));
    assert!(depth.iter().all(|count| *count == 150), "the whole wall");
}

#[test]
fn grasps_without_required_data_are_listed() {
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, _) =
        DatasetWriter::open_or_create(dir.path().join("d"), &new_dataset()).unwrap();
    let at = "2026-11-20T11:00:00Z".parse().unwrap();
    let mut save = |number: u32, change: &dyn Fn(&mut StageCapture)| {
        let mut stages = [capture(2 * number + 1), capture(2 * number + 2)];
        stages.iter_mut().for_each(change);
        let pending = writer.save_initial(&stages[0], Vec::new()).unwrap();
        let saved = writer.save_grasp(&pending, &stages[1], meta(" Blue  MUG"));
        let id = saved.unwrap().id;
        writer.set_outcome(&id, Outcome::Slip, at, None).unwrap();
        id
    };
    let complete = save(0, &|_| {});
    let no_rgb = save(1, &|stage| drop(stage.cameras.remove(&Role::Rgb)));
    let no_right = save(2, &|stage| drop(stage.cameras.remove(&Role::Right)));
    let other_profile = save(3, &|stage| {
        let left = stage.cameras.get_mut(&Role::Left).unwrap();
        left.crop_profile = Some("gsmini-fifteen-v1".into());
    });
    let out = dir.path().join("out");
    let report = run(dir.path(), &out, &ExportPlan::new(ExportFormat::Training)).unwrap();
    let named: Vec<(&str, &str)> = report
        .left_out
        .iter()
        .map(|one| (&*one.id, &*one.reason))
        .collect();
    let [(a, no_colour), (b, no_touch), (c, other_crop)] = named[..] else {
        panic!("{named:?}");
    };
    assert_eq!(
        [a, b, c],
        [no_rgb.as_str(), no_right.as_str(), other_profile.as_str()]
    );
    assert!(no_colour.contains("grasp rgb"), "{no_colour}");
    assert!(no_touch.contains("initial right"), "{no_touch}");
    assert!(other_crop.contains("gsmini-fifteen-v1") && other_crop.contains("gsmini-seventh-v1"));
    let set = ShardSet::open(&out).unwrap();
    let facts: Vec<_> = set.facts("test").unwrap().map(Result::unwrap).collect();
    assert_eq!(facts.len(), 1);
    assert_eq!(facts[0].object, "blue mug");
    fs::remove_dir_all(dir.path().join("d/grasps").join(complete.as_str())).unwrap();
    let nothing = dir.path().join("nothing");
    let plan = ExportPlan::new(ExportFormat::Training);
    let error = run(dir.path(), &nothing, &plan).unwrap_err();
    assert!(
        error.remedy_text().unwrap().contains("the format requires"),
        "{error}"
    );
}

#[test]
fn damaged_grasps_are_left_out_and_listed() {
    let (dir, ids) = dataset();
    let image = dir
        .path()
        .join(format!("d/grasps/{}/grasp.left.jpg", ids[0]));
    // Same size and still a complete image: only the hash differs.
    let mut bytes = fs::read(&image).unwrap();
    let offset = bytes.len() - 20;
    bytes[offset] ^= 1;
    fs::write(&image, bytes).unwrap();
    let record = dir.path().join(format!("d/grasps/{}/grasp.json", ids[1]));
    let text = fs::read(&record).unwrap();
    fs::write(&record, &text[..text.len() / 2]).unwrap();
    for format in [
        ExportFormat::Parquet,
        ExportFormat::WebDataset,
        ExportFormat::Zarr,
    ] {
        let out = dir.path().join(format.name());
        let report = run(dir.path(), &out, &ExportPlan::new(format)).unwrap();
        assert_eq!(report.grasps, 1, "{format}");
        let named: Vec<&String> = report.left_out.iter().map(|one| &one.id).collect();
        assert_eq!(named, [ids[0].as_str(), ids[1].as_str()]);
        assert!(
            report.left_out[0].reason.contains("grasp.left.jpg"),
            "{report:?}"
        );
        assert!(
            report.left_out[1].reason.contains("grasp.json"),
            "{report:?}"
        );
    }
    fs::remove_file(
        dir.path()
            .join(format!("d/grasps/{}/grasp.rgb.png", ids[2])),
    )
    .unwrap();
    let before = fs::read_dir(dir.path()).unwrap().count();
    for format in FORMATS {
        let out = dir.path().join("nothing");
        let error = run(dir.path(), &out, &ExportPlan::new(format)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{format}");
        assert!(error.remedy_text().is_some(), "{format}");
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), before);
}

#[test]
fn splits_are_exported_separately() {
    let (dir, _) = dataset();
    let root = dir.path().join("d");
    let plan = SplitPlan {
        name: "halves".into(),
        by: GroupKey::Object,
        seed: 1,
        fractions: BTreeMap::from([("train".into(), 0.5), ("test".into(), 0.5)]),
    };
    let requested = ExportPlan {
        only_split: Some("test".into()),
        ..ExportPlan::new(ExportFormat::Parquet)
    };
    let error = run(dir.path(), &dir.path().join("early"), &requested).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Usage);
    let file = split(&Dataset::open(&root).unwrap(), &plan).unwrap();
    let test = file.splits["test"].grasps.len();
    let report = run(dir.path(), &dir.path().join("test"), &requested).unwrap();
    assert_eq!(report.splits, BTreeMap::from([("test".to_owned(), test)]));
    assert_eq!(
        names(&dir.path().join("test")),
        ["data/test-00000-of-00001.parquet"]
    );
    let all = ExportPlan {
        split_file: Some("halves".into()),
        ..ExportPlan::new(ExportFormat::Zarr)
    };
    let report = run(dir.path(), &dir.path().join("all"), &all).unwrap();
    assert_eq!(
        (report.grasps, report.not_in_split, report.splits.len()),
        (3, 0, 2)
    );
    let plan = SplitPlan {
        name: "thirds".into(),
        fractions: BTreeMap::from([("train".into(), 0.5), ("val".into(), 0.5)]),
        ..plan
    };
    split(&Dataset::open(&root).unwrap(), &plan).unwrap();
    let training = ExportPlan {
        split_file: Some("thirds".into()),
        ..ExportPlan::new(ExportFormat::Training)
    };
    let report = run(dir.path(), &dir.path().join("thirds"), &training).unwrap();
    let splits: Vec<&str> = report.splits.keys().map(String::as_str).collect();
    assert!(!splits.contains(&"val"), "{splits:?}");
    assert_eq!(report.grasps, 2);
    let set = ShardSet::open(dir.path().join("thirds")).unwrap();
    assert!(
        set.splits()
            .all(|split| ["train", "validation"].contains(&split))
    );
    for (file, split) in [("halve", None), ("../d", None), ("halves", Some("trian"))] {
        let invalid = ExportPlan {
            split_file: Some(file.into()),
            only_split: split.map(str::to_owned),
            ..ExportPlan::new(ExportFormat::Zarr)
        };
        let error = run(dir.path(), &dir.path().join("no"), &invalid).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Usage, "{file}");
    }
}

#[test]
fn split_names_that_are_paths_are_refused() {
    let (dir, _) = dataset();
    let root = dir.path().join("d");
    let plan = SplitPlan {
        name: "halves".into(),
        by: GroupKey::Object,
        seed: 1,
        fractions: BTreeMap::from([("train".into(), 0.5), ("test".into(), 0.5)]),
    };
    split(&Dataset::open(&root).unwrap(), &plan).unwrap();
    let path = root.join("splits/halves.json");
    let text = fs::read_to_string(&path).unwrap();
    let absolute = dir.path().join("planted").display().to_string();
    for name in ["../../planted", "a/b", "..", &absolute] {
        fs::write(&path, text.replace("\"test\"", &format!("{name:?}"))).unwrap();
        for format in FORMATS {
            let requested = ExportPlan {
                split_file: Some("halves".into()),
                ..ExportPlan::new(format)
            };
            let error = run(dir.path(), &dir.path().join("out"), &requested).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Input, "{name} {format}: {error}");
        }
        let mut found: Vec<_> = fs::read_dir(dir.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        found.sort();
        assert_eq!(found, ["d"], "{name}");
    }
}

#[test]
fn empty_dataset_and_occupied_target_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, _) =
        DatasetWriter::open_or_create(dir.path().join("d"), &new_dataset()).unwrap();
    let out = dir.path().join("out");
    for format in FORMATS {
        let error = run(dir.path(), &out, &ExportPlan::new(format)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.what().contains("no grasps"), "{error}");
    }
    let pending = writer.save_initial(&capture(1), Vec::new()).unwrap();
    writer
        .save_grasp(&pending, &capture(2), meta("mug"))
        .unwrap();
    let mut plan = ExportPlan::new(ExportFormat::Parquet);
    plan.only_labelled = true;
    let error = run(dir.path(), &out, &plan).unwrap_err();
    assert!(error.what().contains("is labelled"), "{error}");
    plan.only_labelled = false;
    let error = run(dir.path(), &dir.path().join("d/grasps/x"), &plan).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Usage);
    fs::write(&out, b"mine").unwrap();
    let dataset = Dataset::open(dir.path().join("d")).unwrap();
    let error = export(&dataset, &out, &plan, &|_, _| {}).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Input);
    assert_eq!(fs::read(&out).unwrap(), b"mine");
}
