//! Reads and extends datasets.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PySlice};
use rayon::prelude::*;

use super::append::{Arguments, Writer};
use super::arrays::array;
use super::failure::Outcome;
use super::grasp_record::{Grasp, gel_of, stage_of};
use super::pose::Pose;
use super::predictor::Prediction;
use super::work::{detached, interruptible, pool};
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_base::files::{GraspId, ObjectName};
use gripcast_dataset as stored;
use gripcast_dataset::{
    GraspRecord, GroupKey, NewDataset, SplitFile, SplitPlan, Stage, TACTILE_SIZE,
};
use gripcast_imaging::{Decoder, TactileDifference};

/// Outcomes of a grasp.
const OUTCOMES: [&str; 3] = ["stable", "slip", "unlabelled"];

/// How a dataset is opened again, and with what.
type Reduced<'py> = (Bound<'py, PyAny>, (PathBuf, Vec<String>));

/// One name or several.
#[derive(FromPyObject)]
enum Names {
    One(String),
    Several(Vec<String>),
}

impl Names {
    fn list(self) -> Vec<String> {
        match self {
            Self::One(name) => vec![name],
            Self::Several(names) => names,
        }
    }
}

/// The grasps of a dataset, in the order of their ids.
///
/// `len`, an index and a slice work as for a list; records and images are read when they are asked for.
/// It pickles by its path and works in forked workers, so that it can be the data set of a torch
/// `DataLoader` with a `collate_fn`. Grasps that another program adds are seen by a new `Dataset`.
///
/// `append_grasp` locks the dataset until `close`, the end of a `with` block or of the object.
#[pyclass(frozen, module = "gripcast")]
pub(crate) struct Dataset {
    dataset: Arc<stored::Dataset>,
    ids: Mutex<Vec<GraspId>>,
    /// None for slices and selections.
    writer: Option<Mutex<Writer>>,
}

impl Dataset {
    fn whole(dataset: stored::Dataset, ids: Vec<GraspId>) -> Self {
        Self {
            dataset: Arc::new(dataset),
            ids: Mutex::new(ids),
            writer: Some(Mutex::default()),
        }
    }

    fn with(&self, ids: Vec<GraspId>) -> Self {
        selection(&self.dataset, ids)
    }

    fn list(&self) -> MutexGuard<'_, Vec<GraspId>> {
        self.ids.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn read(&self, py: Python<'_>, id: &GraspId) -> Outcome<Grasp> {
        let (record, json) = detached(py, || {
            let read = self.dataset.grasp_with_json(id);
            read.map_err(|e| explained(&self.dataset, e))
        })?;
        Ok(Grasp {
            dataset: Arc::clone(&self.dataset),
            record,
            json,
        })
    }
}

impl Dataset {
    /// Reads pixel values of each grasp on all cores: grasps × 240 × 320 × 3.
    fn batch<T: numpy::Element + Copy + 'static>(
        &self,
        py: Python<'_>,
        values: impl Fn(&stored::Dataset, &mut Decoder, &GraspRecord) -> Result<Vec<T>>
        + Send
        + Sync
        + 'static,
    ) -> Outcome<Py<PyAny>> {
        let (dataset, ids) = (Arc::clone(&self.dataset), self.list().clone());
        let [width, height] = TACTILE_SIZE.map(|side| side as usize);
        let shape = [ids.len(), height, width, 3];
        let pool = pool(None)?;
        let all = interruptible(py, move |cancel| {
            let read = |decoder: &mut Option<Decoder>, id: &GraspId| {
                if cancel.load(Ordering::Relaxed) {
                    return Err(Error::internal("the call was interrupted"));
                }
                let decoder = match decoder {
                    Some(decoder) => decoder,
                    none => none.insert(Decoder::new()?),
                };
                values(&dataset, decoder, &dataset.grasp(id)?)
            };
            let read = pool.install(|| {
                let values = ids.par_iter().map_init(|| None, read);
                values.collect::<Result<Vec<Vec<T>>>>()
            });
            Ok(read.map_err(|e| explained(&dataset, e))?.concat())
        })?;
        Ok(array(py, all, &shape)?)
    }

    fn parts(&self, file: SplitFile) -> BTreeMap<String, Self> {
        let parts = file.splits.into_iter();
        parts
            .map(|(name, members)| (name, self.with(members.grasps.into_iter().collect())))
            .collect()
    }
}

/// Error of a dataset that was there.
fn gone(path: &Path) -> Option<Error> {
    let is_there = path.join("dataset.toml").exists();
    let error = || {
        Error::not_found("the dataset was moved or deleted")
            .at(path.display())
            .remedy("open it where it is now with Dataset(path)")
    };
    (!is_there).then(error)
}

#[pymethods]
impl Dataset {
    /// Opens a dataset for reading.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> Outcome<Self> {
        let (dataset, ids) = interruptible(py, move |_| {
            // Workers may be in another folder.
            let path = std::path::absolute(&path)
                .map_err(|e| Error::io("cannot open the dataset", e).at(path.display()))?;
            let dataset = stored::Dataset::open(path)?;
            let ids = dataset.ids()?;
            Ok((dataset, ids))
        })?;
        Ok(Self::whole(dataset, ids))
    }

    /// Creates a dataset in a folder that is missing or empty. `label_definition` says what stable and
    /// slip mean, `licence` is an SPDX expression; `name` is that of the folder unless given.
    #[staticmethod]
    #[pyo3(signature = (path, *, label_definition, licence, name = None, rig = "python"))]
    fn create(
        py: Python<'_>,
        path: PathBuf,
        label_definition: &str,
        licence: &str,
        name: Option<String>,
        rig: &str,
    ) -> Outcome<Self> {
        let folder_name = || {
            let name = path.file_name().unwrap_or_default();
            name.to_string_lossy().into_owned()
        };
        let new = NewDataset {
            name: name.unwrap_or_else(folder_name),
            rig: rig.to_owned(),
            licence: licence.to_owned(),
            label_definition: label_definition.to_owned(),
        };
        for (name, value) in [
            ("label_definition", &new.label_definition),
            ("licence", &new.licence),
            ("name", &new.name),
            ("rig", &new.rig),
        ] {
            if value.trim().is_empty() {
                return Err(Error::usage(format!("`{name}` must not be empty")).into());
            }
        }
        let dataset = interruptible(py, move |_| {
            let path = std::path::absolute(&path)
                .map_err(|e| Error::io("cannot create the dataset", e).at(path.display()))?;
            if path.join("dataset.toml").exists() {
                return Err(Error::usage("there is a dataset already")
                    .at(path.display())
                    .remedy("open it with Dataset(path), or choose another folder"));
            }
            drop(stored::DatasetWriter::open_or_create(&path, &new)?);
            stored::Dataset::open(path)
        })?;
        Ok(Self::whole(dataset, Vec::new()))
    }

    /// Appends a grasp and returns it. It is durable when this returns; after a crash before, the
    /// dataset is as if it had not been called.
    ///
    /// `initial` and `grasp` are the images before the gripper closed and after, by camera: left, right,
    /// rgb and external are height × width × 3, uint8, RGB; depth, in `grasp` only, is height × width,
    /// uint16, in units of `depth_unit_m`. `crop_profile` says how tactile images are cropped before
    /// models see them; full-v1 is for images that are cropped already. `markers` are the gel markers
    /// of the grasp by side, as `Grasp.markers` returns them, with the scale `m_per_px`. `captured_at` is
    /// a `datetime` with a time zone or RFC 3339, now unless given.
    ///
    /// `BusyError` if another program writes the dataset.
    #[pyo3(signature = (*, object, initial, grasp, outcome = "unlabelled", scene = "", operator = "", note = "", t_object_gripper = None, prediction = None, markers = None, m_per_px = None, depth_unit_m = 0.001, crop_profile = "full-v1", captured_at = None))]
    #[allow(clippy::too_many_arguments)]
    fn append_grasp(
        &self,
        py: Python<'_>,
        object: &str,
        initial: &Bound<'_, PyDict>,
        grasp: &Bound<'_, PyDict>,
        outcome: &str,
        scene: &str,
        operator: &str,
        note: &str,
        t_object_gripper: Option<&Pose>,
        prediction: Option<&Prediction>,
        markers: Option<&Bound<'_, PyDict>>,
        m_per_px: Option<f64>,
        depth_unit_m: f64,
        crop_profile: &str,
        captured_at: Option<&Bound<'_, PyAny>>,
    ) -> Outcome<Grasp> {
        let Some(writer) = &self.writer else {
            return Err(Error::usage("grasps cannot be appended to a selection")
                .remedy("append to the whole Dataset(path)")
                .into());
        };
        let arguments = Arguments {
            object,
            initial,
            grasp,
            outcome,
            scene,
            operator,
            note,
            t_object_gripper,
            prediction,
            markers,
            m_per_px,
            depth_unit_m,
            crop_profile,
            captured_at,
        };
        let new = arguments.read()?;
        let id = detached(py, || {
            let mut writer = writer.lock().unwrap_or_else(PoisonError::into_inner);
            let saved = writer.append(self.dataset.path(), new);
            Ok(saved.map_err(|e| explained(&self.dataset, e))?.id)
        })?;
        let mut ids = self.list();
        // Ids are in the order of the times.
        let at = ids.partition_point(|other| *other < id);
        ids.insert(at, id.clone());
        drop(ids);
        self.read(py, &id)
    }

    /// Writes the index of appended grasps and lets other programs write the dataset. Reading goes on.
    fn close(&self, py: Python<'_>) -> Outcome<()> {
        let Some(writer) = &self.writer else {
            return Ok(());
        };
        detached(py, || {
            let mut writer = writer.lock().unwrap_or_else(PoisonError::into_inner);
            writer.finish()
        })
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (*_error))]
    fn __exit__(&self, py: Python<'_>, _error: &Bound<'_, pyo3::types::PyTuple>) -> Outcome<()> {
        self.close(py)
    }

    /// Names of the splits that are stored with the dataset.
    #[getter]
    fn splits(&self, py: Python<'_>) -> Outcome<Vec<String>> {
        detached(py, || self.dataset.split_names())
    }

    /// The grasps of a stored split, by the name of its part (train, …).
    fn split(&self, py: Python<'_>, name: &str) -> Outcome<BTreeMap<String, Self>> {
        let file = detached(py, || {
            let split = self.dataset.split(name);
            split.map_err(|e| explained(&self.dataset, e))
        })?;
        Ok(self.parts(file))
    }

    /// Splits the whole dataset so that no object (or scene, by `by`) is in two parts, and stores the
    /// split. `fractions` are those of the grasps, by the name of the part; they sum to 1.
    #[pyo3(signature = (name, fractions, *, by = "object", seed = 0))]
    fn make_split(
        &self,
        py: Python<'_>,
        name: &str,
        fractions: BTreeMap<String, f64>,
        by: &str,
        seed: u64,
    ) -> Outcome<BTreeMap<String, Self>> {
        let plan = SplitPlan {
            name: name.to_owned(),
            by: match by {
                "object" => GroupKey::Object,
                "scene" => GroupKey::Scene,
                other => return Err(unknown_name("group", other, &["object", "scene"]).into()),
            },
            seed,
            fractions,
        };
        let dataset = Arc::clone(&self.dataset);
        let file = interruptible(py, move |_| {
            stored::split(&dataset, &plan).map_err(|e| explained(&dataset, e))
        })?;
        Ok(self.parts(file))
    }

    /// A pandas `DataFrame` with one row per grasp; the columns are those of metadata.jsonl.
    fn to_pandas<'py>(&self, py: Python<'py>) -> Outcome<Bound<'py, PyAny>> {
        let pandas = py.import("pandas")?;
        let ids = self.list().clone();
        let mut records = Vec::with_capacity(ids.len());
        for id in &ids {
            py.check_signals()?;
            records.push(self.read(py, id)?.record);
        }
        let lines = stored::metadata_jsonl(&records);
        let loads = py.import("json")?.getattr("loads")?;
        let rows = lines.lines().map(|line| loads.call1((line,)));
        let rows = rows.collect::<PyResult<Vec<_>>>()?;
        Ok(pandas.getattr("DataFrame")?.call1((rows,))?)
    }

    /// Opens some grasps of a dataset.
    #[staticmethod]
    fn _open(py: Python<'_>, path: PathBuf, ids: Vec<String>) -> Outcome<Self> {
        let dataset = detached(py, || stored::Dataset::open(path))?;
        let ids = ids.iter().map(|id| GraspId::parse(id));
        let ids = ids.collect::<Result<Vec<_>>>()?;
        Ok(selection(&Arc::new(dataset), ids))
    }

    /// Folder of the dataset.
    #[getter]
    fn path(&self) -> &Path {
        self.dataset.path()
    }

    /// Name of the dataset.
    #[getter]
    fn name(&self) -> &str {
        &self.dataset.descriptor().name
    }

    /// What its labels mean.
    #[getter]
    fn label_definition(&self) -> &str {
        &self.dataset.descriptor().label_definition
    }

    /// Ids of the grasps.
    #[getter]
    fn ids(&self) -> Vec<String> {
        self.list().iter().map(ToString::to_string).collect()
    }

    /// The grasp with an id.
    fn grasp(&self, py: Python<'_>, id: &str) -> Outcome<Grasp> {
        self.read(py, &GraspId::parse(id)?)
    }

    /// The grasps of one or several objects, and of one or several outcomes (stable, slip, unlabelled).
    /// Reads all records.
    #[pyo3(signature = (*, object = None, outcome = None))]
    fn filter(
        &self,
        py: Python<'_>,
        object: Option<Names>,
        outcome: Option<Names>,
    ) -> Outcome<Self> {
        let objects = object.map(|names| {
            let names = names.list().into_iter();
            names
                .map(|name| name.parse())
                .collect::<Result<Vec<ObjectName>>>()
        });
        let objects = objects.transpose()?;
        let outcomes = outcome.map(|names| {
            let parse = |name: &String| {
                let outcome = stored::Outcome::by_name(name);
                outcome.ok_or_else(|| unknown_name("outcome", name, &OUTCOMES))
            };
            names.list().iter().map(parse).collect::<Result<Vec<_>>>()
        });
        let outcomes = outcomes.transpose()?;
        let mut kept = Vec::new();
        let ids = self.list().clone();
        for id in ids {
            py.check_signals()?;
            let record = self.read(py, &id)?.record;
            let is_object = objects.as_ref().is_none_or(|o| o.contains(&record.object));
            let is_outcome = outcomes
                .as_ref()
                .is_none_or(|o| o.contains(&record.outcome));
            if is_object && is_outcome {
                kept.push(id);
            }
        }
        Ok(self.with(kept))
    }

    /// Reads all files of the whole dataset and reports what is torn, missing, altered, duplicated or
    /// leaking.
    fn verify(&self, py: Python<'_>) -> Outcome<VerifyReport> {
        let path = self.dataset.path().to_owned();
        let pool = pool(None)?;
        let report = interruptible(py, move |_| {
            if let Some(error) = gone(&path) {
                return Err(error);
            }
            pool.install(|| stored::verify(&path, &|_, _| ()))
        })?;
        let problems = report.problems.into_iter().map(|problem| {
            let kind = serde_json::to_value(problem.kind)
                .map_err(|e| Error::internal("cannot name the kind of a problem").because(e))?;
            Ok(Problem {
                kind: kind.as_str().unwrap_or_default().to_owned(),
                grasp: problem.grasp.map(|id| id.to_string()),
                file: problem.file,
                detail: problem.detail,
                remedy: problem.remedy,
            })
        });
        let problems = problems.collect::<Result<Vec<_>>>()?.into_iter();
        Ok(VerifyReport {
            grasps: report.grasps,
            unlabelled: report.unlabelled,
            pending: report.pending,
            notes: report.notes,
            problems: problems
                .map(|problem| Py::new(py, problem))
                .collect::<PyResult<_>>()?,
        })
    }

    /// The images of a gel (left or right) of all grasps, cropped as models see them, decoded on all
    /// cores: grasps × 240 × 320 × 3, uint8, RGB. A slice gives a batch: `dataset[:32].tactile_images("left")`.
    #[pyo3(signature = (side, stage = "grasp"))]
    fn tactile_images(&self, py: Python<'_>, side: &str, stage: &str) -> Outcome<Py<PyAny>> {
        let (role, stage) = (gel_of(side)?, stage_of(stage)?);
        self.batch(py, move |dataset, decoder, record| {
            let image = dataset.tactile_image(decoder, record, stage, role)?;
            Ok(image.into_raw())
        })
    }

    /// Tactile differences of a gel of all grasps, grasp − initial, decoded on all cores:
    /// grasps × 240 × 320 × 3, int16, grey levels.
    fn tactile_differences(&self, py: Python<'_>, side: &str) -> Outcome<Py<PyAny>> {
        let role = gel_of(side)?;
        self.batch(py, move |dataset, decoder, record| {
            let mut image = |stage| dataset.tactile_image(decoder, record, stage, role);
            let difference =
                TactileDifference::between(&image(Stage::Initial)?, &image(Stage::Grasp)?)?;
            Ok(difference.levels().to_vec())
        })
    }

    fn __len__(&self) -> usize {
        self.list().len()
    }

    fn __getitem__<'py>(
        &self,
        py: Python<'py>,
        index: &Bound<'py, PyAny>,
    ) -> Outcome<Bound<'py, PyAny>> {
        if let Ok(slice) = index.cast::<PySlice>() {
            let ids = self.list().clone();
            let range = slice.indices(ids.len() as isize)?;
            let at = (0..range.slicelength as isize).map(|i| range.start + i * range.step);
            let ids = at.map(|at| ids[at as usize].clone()).collect();
            return Ok(Bound::new(py, self.with(ids))?.into_any());
        }
        let given: isize = index.extract()?;
        let ids = self.list();
        let count = ids.len();
        let at = if given < 0 {
            given.saturating_add_unsigned(count)
        } else {
            given
        };
        let id = usize::try_from(at).ok().and_then(|at| ids.get(at).cloned());
        drop(ids);
        let id = id.ok_or_else(|| {
            let text = format!("index {given} is out of range: there are {count} grasps");
            PyIndexError::new_err(text)
        })?;
        Ok(Bound::new(py, self.read(py, &id)?)?.into_any())
    }

    fn __iter__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let builtins = slf.py().import("builtins")?;
        let range = builtins.call_method1("range", (slf.get().list().len(),))?;
        builtins.call_method1("map", (slf.getattr("__getitem__")?, range))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<Reduced<'py>> {
        let this = slf.get();
        let open = slf.get_type().getattr("_open")?;
        Ok((open, (this.dataset.path().to_owned(), this.ids())))
    }

    fn __repr__(&self) -> String {
        format!(
            "<Dataset {}: {} grasps, {}>",
            self.name(),
            self.list().len(),
            self.dataset.path().display()
        )
    }
}

/// A `Dataset` of one grasp, for pickling it.
pub(crate) fn dataset_of(dataset: &Arc<stored::Dataset>, id: &GraspId) -> Dataset {
    selection(dataset, vec![id.clone()])
}

/// Some grasps of a dataset.
fn selection(dataset: &Arc<stored::Dataset>, ids: Vec<GraspId>) -> Dataset {
    Dataset {
        dataset: Arc::clone(dataset),
        ids: Mutex::new(ids),
        writer: None,
    }
}

/// An error about a file of a dataset, explained where the dataset is gone.
pub(crate) fn explained(dataset: &stored::Dataset, error: Error) -> Error {
    gone(dataset.path()).unwrap_or(error)
}

/// Result of a verification.
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct VerifyReport {
    /// Number of complete grasps.
    grasps: usize,
    /// Number of unlabelled grasps.
    unlabelled: usize,
    /// Number of initial frames without a grasp.
    pending: usize,
    /// Notes that are not problems.
    notes: Vec<String>,
    /// All problems, by kind, grasp and file.
    problems: Vec<Py<Problem>>,
}

#[pymethods]
impl VerifyReport {
    fn __repr__(&self) -> String {
        format!(
            "<VerifyReport: {} grasps, {} unlabelled, {} problems>",
            self.grasps,
            self.unlabelled,
            self.problems.len()
        )
    }
}

/// A problem of a dataset.
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct Problem {
    /// torn, missing-file, altered, … (`docs/reference/dataset-format.md`).
    kind: String,
    /// Affected grasp.
    grasp: Option<String>,
    /// Affected file, relative to the dataset.
    file: Option<String>,
    /// Description.
    detail: String,
    /// How to fix it.
    remedy: String,
}

#[pymethods]
impl Problem {
    fn __repr__(&self) -> String {
        let file = self.file.as_deref().or(self.grasp.as_deref());
        format!(
            "<Problem {}: {}: {}>",
            self.kind,
            file.unwrap_or_default(),
            self.detail
        )
    }
}
