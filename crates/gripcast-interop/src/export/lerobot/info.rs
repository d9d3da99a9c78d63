//! `meta/info.json`, and the pandas metadata of `meta/tasks.parquet`.

use serde_json::{Map, Value, json};

use super::features::Features;
use super::{DATA_FILE_BYTES, FILES_PER_CHUNK};
use gripcast_base::error::{Error, Result};
use gripcast_dataset::Descriptor;

/// Version of LeRobot's format.
const VERSION: &str = "v3.0";
/// LeRobot's default size of video files, which are not used here, MB.
const VIDEO_FILE_MB: usize = 200;

/// Totals of the export.
pub(super) struct Totals<'a> {
    pub(super) grasps: usize,
    pub(super) frames: usize,
    /// Frames per second; 1 where frames are steps, not samples in time.
    pub(super) fps: u32,
    pub(super) tasks: usize,
    /// Splits with their first episodes.
    pub(super) splits: &'a [(String, usize)],
}

/// Returns the contents of `info.json`.
///
/// # Errors
/// `Internal`: a defect of gripcast.
pub(super) fn info(
    descriptor: &Descriptor,
    features: &Features,
    totals: &Totals<'_>,
) -> Result<Vec<u8>> {
    let info = json!({
        "codebase_version": VERSION,
        "robot_type": descriptor.rig,
        "total_episodes": totals.grasps,
        "total_frames": totals.frames,
        "total_tasks": totals.tasks,
        "chunks_size": FILES_PER_CHUNK,
        "data_files_size_in_mb": DATA_FILE_BYTES >> 20,
        "video_files_size_in_mb": VIDEO_FILE_MB,
        "fps": totals.fps,
        "splits": splits(totals),
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": null,
        "features": features.to_json(),
        "gripcast": {
            "dataset": descriptor.name,
            "licence": descriptor.licence,
            "label_definition": descriptor.label_definition,
        },
    });
    let mut text = serde_json::to_vec_pretty(&info)
        .map_err(|e| Error::internal("cannot write info.json").because(e))?;
    text.push(b'\n');
    Ok(text)
}

/// Ranges of episodes by split; empty splits are omitted.
fn splits(totals: &Totals<'_>) -> Value {
    let ends = totals.splits.iter().skip(1).map(|(_, first)| *first);
    let ends = ends.chain([totals.grasps]);
    let ranges = totals.splits.iter().zip(ends);
    let ranges = ranges.filter(|((_, first), end)| first < end);
    let named = ranges.map(|((name, first), end)| (name.clone(), json!(format!("{first}:{end}"))));
    Value::Object(named.collect::<Map<_, _>>())
}

/// Pandas metadata that makes the column `task` the index of the table.
pub(super) fn tasks_metadata() -> String {
    let column = |name: &str, kind: &str, numpy: &str| {
        json!({
            "name": name,
            "field_name": name,
            "pandas_type": kind,
            "numpy_type": numpy,
            "metadata": null,
        })
    };
    let metadata = json!({
        "index_columns": ["task"],
        "column_indexes": [{
            "name": null,
            "field_name": null,
            "pandas_type": "unicode",
            "numpy_type": "object",
            "metadata": {"encoding": "UTF-8"},
        }],
        "columns": [
            column("task_index", "int64", "int64"),
            column("task", "unicode", "object"),
        ],
        "creator": {"library": "gripcast", "version": "1"},
        "pandas_version": "2.2.0",
    });
    metadata.to_string()
}
