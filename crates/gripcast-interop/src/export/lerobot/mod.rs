//! LeRobot format, version 3: a grasp is an episode of two frames, initial and grasp, or of its
//! sequence in the black box.
//!
//! Layout of the package `lerobot` 0.4: `meta/info.json`, `meta/stats.json`, `meta/tasks.parquet`,
//! `meta/episodes/` and `data/` in files of bounded size. Images are embedded; there are no videos.

mod features;
mod frames;
mod info;
mod sequences;
mod stats;
mod ticks;
mod tiff;

use super::format::{ExportContext, Writer};
use super::source::Grasp;
use features::Features;
use frames::{Frames, Place};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileName};
use gripcast_dataset::Outcome;
use gripcast_dataset::shard::{ColumnType, TableCell, TableWriter};
use info::{Totals, info, tasks_metadata};
use sequences::Sequences;
use stats::Stats;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Maximum size of a data file, bytes; LeRobot's default.
const DATA_FILE_BYTES: usize = 100 << 20;
/// Files per chunk directory; LeRobot's default.
const FILES_PER_CHUNK: usize = 1000;
/// Frames of an episode that is no sequence.
const PAIR: usize = 2;
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
    /// Number of frames of all grasps.
    total: usize,
    /// Where sequences come from; `None`: two frames per grasp.
    sequences: Option<Sequences<'a>>,
    /// Splits with their first episodes.
    splits: Vec<(String, usize)>,
}

impl<'a> LeRobot<'a> {
    /// # Errors
    /// `Input`: no camera has images of one size in all grasps. Those of the black box and of the
    /// files.
    pub(super) fn new(context: ExportContext<'a>) -> Result<Self> {
        let plan = context.plan.sequences.as_ref();
        let (features, notes) = Features::choose(context.survey, plan.is_some())?;
        let sequences = plan.map(|plan| Sequences::open(plan, context.dataset));
        let sequences = sequences.transpose()?;
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
            total: 0,
            sequences,
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

    /// Row of an episode with so many frames, which are not yet counted.
    fn episode(&self, grasp: &Grasp, frames: usize) -> Vec<TableCell<'static>> {
        let text = |text: String| TableCell::Text(Cow::Owned(text));
        let first = self.total;
        vec![
            integer(self.grasps),
            text(task_text(&grasp.record.object)),
            integer(frames),
            integer(first),
            integer(first + frames),
            integer(self.file / FILES_PER_CHUNK),
            integer(self.file % FILES_PER_CHUNK),
            integer(0),
            integer(0),
            text(grasp.record.id.to_string()),
            text(String::from_utf8_lossy(&grasp.json).into_owned()),
        ]
    }

    /// Place of the first frame of the next episode.
    fn first_place(&mut self, grasp: &Grasp, is_stable: bool) -> Place {
        Place {
            frame: 0,
            episode: self.grasps,
            index: self.total,
            task: self.task(&grasp.record.object),
            timestamp_s: 0.0,
            is_last: false,
            is_stable,
        }
    }

    /// Adds an episode of two frames; the result is as that of [`Writer::push`].
    fn push_pair(&mut self, grasp: &Grasp, is_stable: bool) -> Result<Option<Error>> {
        let images = match self.frames.images(grasp) {
            Ok(images) => images,
            Err(error) => return Ok(Some(error)),
        };
        self.make_room(images.bytes())?;
        let first = self.first_place(grasp, is_stable);
        self.episodes.push(self.episode(grasp, PAIR))?;
        for frame in self.frames.pair(&grasp.record, images, first) {
            self.stats.add(&frame);
            self.data.push(frame.into_cells())?;
        }
        self.total += PAIR;
        self.grasps += 1;
        Ok(None)
    }

    /// Adds an episode with the grasp's sequence; the result is as that of [`Writer::push`].
    fn push_sequence(&mut self, grasp: &Grasp, is_stable: bool) -> Result<Option<Error>> {
        let Some(sequences) = &mut self.sequences else {
            return Ok(None);
        };
        let sequence = match sequences.find(grasp, self.frames.features()) {
            Ok(sequence) => sequence,
            Err(error) => return Ok(Some(error)),
        };
        let fps = f64::from(sequences.fps());
        self.make_room(sequence.bytes)?;
        let first = self.first_place(grasp, is_stable);
        self.episodes.push(self.episode(grasp, sequence.len()))?;
        let Some(sequences) = &self.sequences else {
            return Ok(None);
        };
        let (frames, stats, data) = (&mut self.frames, &mut self.stats, &mut self.data);
        sequences.moments(&sequence, |moment| {
            let place = Place {
                frame: moment.index,
                index: first.index + moment.index,
                timestamp_s: moment.index as f64 / fps,
                is_last: sequence.is_last(moment.index),
                ..first
            };
            let row = frames.of_moment(grasp, &sequence, moment, place)?;
            stats.add(&row);
            data.push(row.into_cells())
        })?;
        self.total += sequence.len();
        self.grasps += 1;
        Ok(None)
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
        match self.sequences.is_some() {
            true => self.push_sequence(&grasp, is_stable),
            false => self.push_pair(&grasp, is_stable),
        }
    }

    fn finish(self: Box<Self>) -> Result<Vec<String>> {
        self.write_tasks()?;
        let totals = Totals {
            grasps: self.grasps,
            frames: self.total,
            fps: self.sequences.as_ref().map_or(1, Sequences::fps),
            tasks: self.tasks.len(),
            splits: &self.splits,
        };
        let info = info(self.context.descriptor, self.frames.features(), &totals)?;
        let folder = self.context.folder;
        folder.write("meta/info.json", &info)?;
        folder.write("meta/stats.json", &self.stats.to_json()?)?;
        self.episodes.finish()?;
        self.data.finish()?;
        let mut notes = self.notes;
        notes.extend(self.sequences.iter().flat_map(Sequences::notes));
        Ok(notes)
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
