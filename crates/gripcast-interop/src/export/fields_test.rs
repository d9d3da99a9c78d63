//! Field arrays and lift frames in every format, read with independent code.

use std::fs;
use std::io::Read as _;
use std::path::Path;

use flate2::read::ZlibDecoder;
use parquet::file::reader::{FileReader as _, SerializedFileReader};
use parquet::record::{Field, ListAccessor as _, Row, RowAccessor as _};
use serde_json::{Value, json};

use super::{ExportFormat, ExportPlan, ExportReport, export};
use gripcast_base::files::npy::Array;
use gripcast_dataset::sample::{capture, capture_with_fields, lift, meta, new_dataset};
use gripcast_dataset::{Dataset, DatasetWriter, FieldArray, Outcome};
use gripcast_imaging::Role;

/// A grasp without fields, one with fields, one with fields and lift frames; of the third the
/// markers of the right gel are of another shape than of the second.
fn dataset(root: &Path) -> Dataset {
    let (mut writer, _) = DatasetWriter::open_or_create(root, &new_dataset()).unwrap();
    for number in 0..3 {
        let take = |at: u32| {
            let mut stage = match number {
                0 => capture(at),
                _ => capture_with_fields(at),
            };
            if number > 0 {
                let shape = [1, number as usize, 5];
                let values = vec![at as f32; shape.iter().product()];
                let right = FieldArray::markers(Role::Right, values, shape, 2.9e-5);
                stage.fields.push(right.unwrap());
            }
            stage
        };
        let pending = writer
            .save_initial(&take(2 * number + 1), Vec::new())
            .unwrap();
        let record = writer
            .save_grasp(&pending, &take(2 * number + 2), meta("mug"))
            .unwrap();
        let at = "2026-11-20T11:00:00Z".parse().unwrap();
        writer
            .set_outcome(&record.id, Outcome::Stable, at, None)
            .unwrap();
        if number == 2 {
            writer.append_lift(&record.id, &lift(7), 2.0).unwrap();
        }
    }
    Dataset::open(root).unwrap()
}

fn run(format: ExportFormat) -> (tempfile::TempDir, ExportReport) {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(&dir.path().join("d"));
    let out = dir.path().join("out");
    let report = export(&dataset, &out, &ExportPlan::new(format), &|_, _| {}).unwrap();
    assert_eq!((report.grasps, report.left_out.len()), (3, 0));
    (dir, report)
}

fn rows(path: &Path) -> Vec<Row> {
    let file = SerializedFileReader::new(fs::File::open(path).unwrap()).unwrap();
    let rows = file.get_row_iter(None).unwrap();
    rows.map(Result::unwrap).collect()
}

fn column(row: &Row, name: &str) -> usize {
    let mut columns = row.get_column_iter();
    columns
        .position(|(found, _)| found == name)
        .unwrap_or_else(|| panic!("no column {name}"))
}

/// The values of nested lists, row by row.
fn flat(field: &Field) -> Vec<f32> {
    match field {
        Field::ListInternal(list) => list.elements().iter().flat_map(flat).collect(),
        Field::Float(value) => vec![*value],
        Field::Null => Vec::new(),
        other => panic!("{other:?}"),
    }
}

fn values(row: &Row, name: &str) -> Vec<f32> {
    let (_, field) = row.get_column_iter().nth(column(row, name)).unwrap();
    flat(field)
}

fn expected(number: u32) -> Vec<f32> {
    capture_with_fields(number).fields[0]
        .values
        .values()
        .to_vec()
}

const OTHER_SHAPES: &str = "field markers of right left out: its arrays have different shapes, \
                            components or units";

#[test]
fn parquet_has_arrays_of_any_size_and_lift_images() {
    let (dir, report) = run(ExportFormat::Parquet);
    assert!(report.notes.is_empty(), "{:?}", report.notes);
    let rows = rows(&dir.path().join("out/data/train-00000-of-00001.parquet"));
    assert!(values(&rows[0], "grasp_left_markers").is_empty());
    assert_eq!(values(&rows[1], "initial_left_markers"), expected(3));
    assert_eq!(values(&rows[2], "grasp_left_markers"), expected(6));
    assert_eq!(values(&rows[1], "grasp_right_markers").len(), 5);
    assert_eq!(values(&rows[2], "grasp_right_markers").len(), 10);
    let at = column(&rows[2], "lift_left");
    let frames = rows[2].get_list(at).unwrap();
    let sent = lift(7);
    for (index, frame) in sent[&Role::Left].iter().enumerate() {
        let stored = frames.get_group(index).unwrap();
        assert_eq!(stored.get_bytes(0).unwrap().data(), &frame.data[..]);
    }
    assert_eq!(frames.len(), 3);
    assert!(rows[1].get_list(at).is_err(), "null");
}

#[test]
fn webdataset_has_an_array_and_a_lift_in_every_sample() {
    let (dir, report) = run(ExportFormat::WebDataset);
    assert_eq!(report.notes, [OTHER_SHAPES]);
    let mut archive =
        tar::Archive::new(fs::File::open(dir.path().join("out/train-000000.tar")).unwrap());
    let mut arrays = Vec::new();
    let mut lifts = Vec::new();
    let mut facts = Vec::new();
    for entry in archive.entries().unwrap() {
        let mut entry = entry.unwrap();
        let name = entry.path().unwrap().to_string_lossy().into_owned();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        if name.ends_with(".grasp_left_markers.npy") {
            arrays.push(Array::from_npy(&bytes).unwrap());
        } else if name.ends_with(".lift_right.mjpeg") {
            lifts.push(bytes);
        } else if name.ends_with(".json") {
            facts.push(serde_json::from_slice::<Value>(&bytes).unwrap());
        }
    }
    assert_eq!(arrays.len(), 3);
    assert!(arrays[0].values().iter().all(|value| value.is_nan()));
    assert_eq!(arrays[0].shape(), [2, 3, 5]);
    assert_eq!(arrays[2].values(), expected(6));
    let sent: Vec<u8> = lift(7)[&Role::Right]
        .iter()
        .flat_map(|f| f.data.to_vec())
        .collect();
    assert_eq!(lifts, [vec![], vec![], sent]);
    let flags = |name: &str| facts.iter().map(|f| f[name].clone()).collect::<Vec<_>>();
    assert_eq!(flags("has_grasp_left_markers"), [false, true, true]);
    assert_eq!(flags("has_lift_left"), [false, false, true]);
    assert_eq!(flags("has_force"), [false, true, true]);
    assert_eq!(flags("force_left_n"), [-1.0, 12.5, 12.5]);
    assert_eq!(flags("force_left_is_calibrated"), [-1, 1, 1]);
    assert_eq!(flags("force_right_n"), [-1.0; 3]);
    assert_eq!(facts[1]["force_left_shear_n"], json!([0.5, -0.75]));
}

#[test]
fn lerobot_names_the_components_of_tactile_arrays() {
    let (dir, report) = run(ExportFormat::LeRobot);
    let lift = |role: &str| format!("lift frames of {role} left out: 1 grasps");
    assert_eq!(
        report.notes,
        [OTHER_SHAPES.to_owned(), lift("left"), lift("right")]
    );
    let out = dir.path().join("out");
    let read = |name: &str| -> Value {
        serde_json::from_slice(&fs::read(out.join(name)).unwrap()).unwrap()
    };
    let feature = &read("meta/info.json")["features"]["observation.tactile.left"];
    assert_eq!(feature["dtype"], "float32");
    assert_eq!(feature["shape"], json!([2, 3, 5]));
    assert_eq!(feature["names"]["components"][3], "dy_px");
    let force = &read("meta/info.json")["features"]["observation.force"];
    assert_eq!(
        (&force["shape"], &force["names"][4]),
        (&json!([8]), &json!("right_n"))
    );
    let frames = rows(&out.join("data/chunk-000/file-000.parquet"));
    let of = |frame: usize| values(&frames[frame], "observation.tactile.left");
    assert!(of(0).iter().all(|value| value.is_nan()) && of(0).len() == 30);
    assert_eq!((of(2), of(5)), (expected(3), expected(6)));
    let stats = &read("meta/stats.json")["observation.tactile.left"];
    let of_component = |at: usize| {
        let frames = [3, 4, 5, 6].map(expected);
        let of_frame = |f: &Vec<f32>| f.iter().skip(at).step_by(5).copied().collect::<Vec<_>>();
        frames
            .iter()
            .flat_map(of_frame)
            .fold(f32::INFINITY, f32::min)
    };
    let minima: Vec<f32> = (0..5).map(of_component).collect();
    assert_eq!(stats["min"], json!(minima));
    assert_eq!(stats["count"], json!([24]));
}

#[test]
fn zarr_rows_of_grasps_without_the_field_are_nan() {
    let (dir, report) = run(ExportFormat::Zarr);
    assert!(report.notes.contains(&OTHER_SHAPES.to_owned()));
    let out = dir.path().join("out");
    let read = |name: &str| -> Value {
        serde_json::from_slice(&fs::read(out.join(name)).unwrap()).unwrap()
    };
    assert_eq!(read("meta/force_n/.zarray")["shape"], json!([3, 2]));
    assert_eq!(
        read("meta/force_shear_n/.zarray")["shape"],
        json!([3, 2, 2])
    );
    let array = read("data/left_markers/.zarray");
    assert_eq!(array["shape"], json!([6, 2, 3, 5]));
    assert_eq!(
        (&array["dtype"], &array["fill_value"]),
        (&json!("<f4"), &json!("NaN"))
    );
    let described = &read(".zattrs")["fields"]["left_markers"];
    assert_eq!(described["units"], json!(["px", "px", "px", "px", "1"]));
    let mut bytes = Vec::new();
    let chunk = fs::File::open(out.join("data/left_markers/0.0.0.0")).unwrap();
    ZlibDecoder::new(chunk).read_to_end(&mut bytes).unwrap();
    let (values, _) = bytes.as_chunks::<4>();
    let values: Vec<f32> = values.iter().map(|v| f32::from_le_bytes(*v)).collect();
    assert!(values[..60].iter().all(|value| value.is_nan()));
    assert_eq!(values[60..90], expected(3));
    assert_eq!(values[150..180], expected(6));
}

#[test]
fn training_shards_say_that_they_lack_fields() {
    let (_dir, report) = run(ExportFormat::Training);
    assert!(
        report
            .notes
            .contains(&"field markers of left left out".to_owned())
    );
}
