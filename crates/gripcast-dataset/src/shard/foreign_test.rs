//! Files of other writers, and invalid rows.

use std::sync::Arc;

use parquet::file::writer::SerializedFileWriter;

use super::cell::Cell;
use super::columns::{columns, schema};
use super::group::write_group;
use super::reader::ShardReader;
use super::row::ShardRow;
use super::sample_rows::{sample_row, sample_rows};
use super::writer::properties;
use gripcast_base::error::{Error, Result};

/// A file of another writer with the same columns.
fn foreign(groups: &[Vec<Vec<Cell<'_>>>]) -> Vec<u8> {
    let properties = Arc::new(properties("another writer"));
    let mut writer = SerializedFileWriter::new(Vec::new(), schema().unwrap(), properties).unwrap();
    for group in groups {
        write_group(&mut writer, group).unwrap();
    }
    writer.into_inner().unwrap()
}

/// Five rows of our writer, and the first three of them from other writers
/// (`tests/peers/read_shards.py --rewrite`): Snappy and dictionaries; gzip, dictionaries, INT32
/// labels, a column of nulls, one missing and one too many; Zstandard, pages of version 2,
/// checksums.
const OURS: &[u8] = include_bytes!("../../../../tests/data/shard/gripcast-1.parquet");
pub(super) const DATASETS: &[u8] = include_bytes!("../../../../tests/data/shard/datasets.parquet");
pub(super) const PANDAS: &[u8] =
    include_bytes!("../../../../tests/data/shard/pandas-changed.parquet");
pub(super) const PYARROW: &[u8] = include_bytes!("../../../../tests/data/shard/pyarrow-v2.parquet");

#[test]
fn reads_files_of_pandas_datasets_and_pyarrow() {
    let ours = read(OURS.to_vec()).unwrap();
    assert_eq!(ours.len(), 5);
    assert!(ours.iter().any(|row| row.images.grasp_depth.is_some()));
    assert_eq!(read(DATASETS.to_vec()).unwrap(), ours[..3]);
    assert_eq!(read(PYARROW.to_vec()).unwrap(), ours[..3]);
    let mut changed = ours[..3].to_vec();
    for row in &mut changed {
        row.facts.fault = None;
        row.images.grasp_depth = None;
    }
    assert_eq!(read(PANDAS.to_vec()).unwrap(), changed);
}

fn read(bytes: Vec<u8>) -> Result<Vec<ShardRow>> {
    ShardReader::from_bytes("foreign.parquet", bytes)?
        .rows()
        .collect()
}

/// Error of a file with one cell of the second group's third row replaced.
fn with(column: &str, cell: Cell<'static>) -> Error {
    let rows = sample_rows(0, 8);
    let mut cells: Vec<Vec<Cell<'_>>> = rows.iter().map(ShardRow::cells).collect();
    let index = columns().position(|c| c.name == column).unwrap();
    cells[6][index] = cell;
    let second = cells.split_off(4);
    read(foreign(&[cells, second])).unwrap_err()
}

#[test]
fn reads_other_writers_in_small_batches() {
    let rows = sample_rows(0, 200);
    let cells: Vec<Vec<Cell<'_>>> = rows.iter().map(ShardRow::cells).collect();
    let shard = ShardReader::from_bytes("foreign", foreign(&[cells])).unwrap();
    assert_eq!(shard.info(), None);
    assert_eq!(shard.row_group(0).unwrap(), rows);
    let facts: Vec<_> = shard.facts().map(Result::unwrap).collect();
    assert!(facts.iter().eq(rows.iter().map(|row| &row.facts)));
    assert!(shard.rows().map(Result::unwrap).eq(rows));
}

#[test]
fn invalid_value_is_reported_with_its_row() {
    let error = with("label", Cell::Integer(-1)).to_string();
    let location = "foreign.parquet: row group 1: row 2: column label is -1";
    assert!(error.starts_with(location), "{error}");
    for (column, cell, expected) in [
        (
            "label",
            Cell::Integer(1),
            "column label is 1, expected 0 for outcome slip",
        ),
        ("label", Cell::Null, "column label is null"),
        (
            "outcome",
            Cell::text("unlabelled"),
            "expected slip or stable",
        ),
        (
            "engine",
            Cell::text("mujoco"),
            "expected fem or rigid or real",
        ),
        ("id", Cell::text(""), "column id is empty"),
        ("rendering", Cell::Integer(-3), "column rendering is -3"),
        ("rendering", Cell::Integer(1 << 40), "out of range"),
        ("seed", Cell::Integer(i64::MIN), "out of range"),
        (
            "friction",
            Cell::Number(f64::INFINITY),
            "column friction is inf",
        ),
        (
            "pose_t_m",
            Cell::Numbers(vec![0.0; 2]),
            "pose_t_m and pose_q_wxyz need 3 and 4 numbers",
        ),
        (
            "pose_t_m",
            Cell::Numbers(vec![0.0; 4]),
            "not a list of at most 3 numbers",
        ),
        (
            "pose_q_wxyz",
            Cell::Numbers(vec![0.0; 4]),
            "unit quaternion",
        ),
        (
            "pose_t_m",
            Cell::Null,
            "column pose_t_m is null, pose_q_wxyz",
        ),
        ("pose_q_wxyz", Cell::Null, "column pose_q_wxyz is null"),
        ("grasp_rgb", Cell::Null, "column grasp_rgb is null"),
    ] {
        let error = with(column, cell).to_string();
        assert!(error.contains(expected), "{error}");
        assert!(
            error.starts_with("foreign.parquet: row group 1: "),
            "{error}"
        );
    }
}

#[test]
fn lists_of_wrong_length_do_not_cancel_out() {
    let rows = sample_rows(0, 2);
    let mut cells: Vec<Vec<Cell<'_>>> = rows.iter().map(ShardRow::cells).collect();
    let index = columns().position(|c| c.name == "pose_t_m").unwrap();
    cells[0][index] = Cell::Numbers(vec![0.0; 2]);
    cells[1][index] = Cell::Numbers(vec![0.0; 4]);
    let error = read(foreign(&[cells])).unwrap_err().to_string();
    assert!(error.contains("not a list of at most 3 numbers"), "{error}");
}

#[test]
fn quaternion_of_another_writer_is_normalised() {
    let row = sample_row(3);
    let q = row.facts.t_object_gripper.unwrap().rotation;
    let mut cells = row.cells();
    let index = columns().position(|c| c.name == "pose_q_wxyz").unwrap();
    cells[index] = Cell::Numbers([q.w, q.x, q.y, q.z].map(|v| -1.0001 * v).to_vec());
    let read = read(foreign(&[vec![cells]])).unwrap();
    let found = read[0].facts.t_object_gripper.unwrap().rotation;
    assert!(
        found.w >= 0.0 && (found - q).length() < 1e-15,
        "{found} {q}"
    );
}
