//! LeRobot format, version 3: a grasp is an episode of two frames, initial and grasp.
//!
//! Layout of the package `lerobot` 0.4: `meta/info.json`, `meta/stats.json`, `meta/tasks.parquet`,
//! `meta/episodes/` and `data/` in files of bounded size. Images are embedded; there are no videos.

mod features;
mod frames;
mod info;
mod stats;
mod tiff;

use super::format::{ExportContext, Writer};
use super::source::Grasp;
use features::Features;
use frames::Frames;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileName};
use gripcast_dataset::Outcome;
use gripcast_dataset::shard::{ColumnType, TableCell, TableWriter};
use info::{Totals, info, tasks_metadata};
use stats::Stats;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Maximum size of a data file, bytes; LeRobot's default.
const DATA_FILE_BYTES: usize = 100 << 20;
/// Files per chunk directory; LeRobot's default.
const FILES_PER_CHUNK: usize = 1000;
/// Frames per episode.
const FRAMES: usize = 2;
/// Columns of the episodes; those with `gripcast/` are extensions.
const EPISODES: [(&str, ColumnType); 11] = [
    ("episode_index", ColumnType::Int64),
    ("tasks", ColumnType::TextList),
    ("length", ColumnType::Int64),
    ("dataset_from_index", ColumnType::Int64),
    ("dataset_to_index", ColumnType::Int64),
    ("data/chunk_index", ColumnType::Int64),
    ("data/file_index", ColumnType::Int64),
    ("meta/episodes/chunk_index", ColumnType::Int64),
    ("meta/episodes/file_index", ColumnType::Int64),
    ("gripcast/id", ColumnType::Text),
    ("gripcast/record", ColumnType::Text),
];

/// Writes the dataset.
pub(super) struct LeRobot<'a> {
    context: ExportContext<'a>,
    frames: Frames,
    stats: Stats,
    notes: Vec<String>,
    tasks: BTreeMap<String, usize>,
    episodes: TableWriter,
    data: TableWriter,
    /// Index of the open data file.
    file: usize,
    grasps: usize,
    /// Splits with their first episodes.
    splits: Vec<(String, usize)>,
}

impl<'a> LeRobot<'a> {
    /// # Errors
    /// `Input`: no camera has images of one size in all grasps. Those of the files.
    pub(super) fn new(context: ExportContext<'a>) -> Result<Self> {
        let (features, notes) = Features::choose(context.survey)?;
        let episodes = EPISODES.map(|(name, kind)| (name.to_owned(), kind));
        let path = file_path(context, &["meta", "episodes"], 0)?;
        let episodes = TableWriter::create(path, episodes.to_vec(), &[])?;
        let path = file_path(context, &["data"], 0)?;
        let data = TableWriter::create(path, features.columns(), &[])?;
        Ok(Self {
            context,
            stats: Stats::new(&features),
            frames: Frames::new(features)?,
            notes,
            tasks: BTreeMap::new(),
            episodes,
            data,
            file: 0,
            grasps: 0,
            splits: Vec::new(),
        })
    }

    /// Starts another data file if the open one is full.
    fn make_room(&mut self, size: usize) -> Result<()> {
        if self.data.rows() == 0 || self.data.bytes() + size <= DATA_FILE_BYTES {
            return Ok(());
        }
        self.file += 1;
        let path = file_path(self.context, &["data"], self.file)?;
        let next = TableWriter::create(path, self.frames.features().columns(), &[])?;
        std::mem::replace(&mut self.data, next).finish()
    }

    fn task(&mut self, object: &str) -> usize {
        let next = self.tasks.len();
        let task = task_text(object);
        *self.tasks.entry(task).or_insert(next)
    }

    fn episode(&self, grasp: &Grasp) -> Vec<TableCell<'static>> {
        let text = |text: String| TableCell::Text(Cow::Owned(text));
        let first = self.grasps * FRAMES;
        vec![
            integer(self.grasps),
            text(task_text(&grasp.record.object)),
            integer(FRAMES),
            integer(first),
            integer(first + FRAMES),
            integer(self.file / FILES_PER_CHUNK),
            integer(self.file % FILES_PER_CHUNK),
            integer(0),
            integer(0),
            text(grasp.record.id.to_string()),
            text(String::from_utf8_lossy(&grasp.json).into_owned()),
        ]
    }

    fn write_tasks(&self) -> Result<()> {
        let meta = self.context.folder.root().top().join("meta");
        let path = meta.join("tasks.parquet");
        let columns = [
            ("task_index", ColumnType::Int64),
            ("task", ColumnType::Text),
        ];
        let columns = columns.map(|(name, kind)| (name.to_owned(), kind)).to_vec();
        let metadata = [("pandas", tasks_metadata())];
        let mut table = TableWriter::create(path, columns, &metadata)?;
        let mut tasks: Vec<(&String, &usize)> = self.tasks.iter().collect();
        tasks.sort_by_key(|(_, index)| **index);
        for (task, index) in tasks {
            let task = TableCell::Text(Cow::Owned(task.clone()));
            table.push(vec![integer(*index), task])?;
        }
        table.finish()
    }
}

impl Writer for LeRobot<'_> {
    fn begin_split(&mut self, split: &str) -> Result<()> {
        self.splits.push((split.to_owned(), self.grasps));
        Ok(())
    }

    fn push(&mut self, grasp: Grasp) -> Result<Option<Error>> {
        let is_stable = match grasp.record.outcome {
            Outcome::Stable => true,
            Outcome::Slip => false,
            Outcome::Unlabelled => {
                let what = "the label was removed during the export";
                return Ok(Some(Error::input(what)));
            }
        };
        let images = match self.frames.images(&grasp) {
            Ok(images) => images,
            Err(error) => return Ok(Some(error)),
        };
        self.make_room(images.bytes())?;
        let task = self.task(&grasp.record.object);
        self.episodes.push(self.episode(&grasp))?;
        for frame in frames::rows(is_stable, self.grasps, task, images) {
            self.stats.add(&frame);
            self.data.push(frame.into_cells())?;
        }
        self.grasps += 1;
        Ok(None)
    }

    fn finish(self: Box<Self>) -> Result<Vec<String>> {
        self.write_tasks()?;
        let totals = Totals {
            grasps: self.grasps,
            tasks: self.tasks.len(),
            splits: &self.splits,
        };
        let info = info(self.context.descriptor, self.frames.features(), &totals)?;
        let folder = self.context.folder;
        folder.write("meta/info.json", &info)?;
        folder.write("meta/stats.json", &self.stats.to_json()?)?;
        self.episodes.finish()?;
        self.data.finish()?;
        Ok(self.notes)
    }
}

/// Task description for LeRobot.
fn task_text(object: &str) -> String {
    format!("grasp the {object}")
}

fn integer(value: usize) -> TableCell<'static> {
    TableCell::Integer(value as i64)
}

/// Path of a numbered file in a directory of the export, which is created.
fn file_path(
    context: ExportContext<'_>,
    folder: &[&'static str],
    file: usize,
) -> Result<BeneathPath> {
    let top = context.folder.root().top();
    let folder = folder.iter().fold(top, |path, name| path.join(*name));
    let chunk = FileName::parse(&format!("chunk-{:03}", file / FILES_PER_CHUNK))?;
    let folder = context.folder.folder(folder.join(&chunk))?;
    let name = FileName::parse(&format!("file-{:03}.parquet", file % FILES_PER_CHUNK))?;
    Ok(folder.join(&name))
}
