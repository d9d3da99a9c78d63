//! Reads datasets.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::PySlice;

use super::failure::Outcome;
use super::grasp_record::Grasp;
use super::work::{detached, interruptible, pool};
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_base::files::{GraspId, ObjectName};
use gripcast_dataset as stored;

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
/// `DataLoader` with a `collate_fn`. Grasps that are added later are seen by a new `Dataset`.
#[pyclass(frozen, module = "gripcast")]
pub(crate) struct Dataset {
    dataset: Arc<stored::Dataset>,
    ids: Arc<[GraspId]>,
}

impl Dataset {
    fn with(&self, ids: Vec<GraspId>) -> Self {
        Self {
            dataset: Arc::clone(&self.dataset),
            ids: ids.into(),
        }
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
        Ok(Self {
            dataset: Arc::new(dataset),
            ids: ids.into(),
        })
    }

    /// Opens some grasps of a dataset.
    #[staticmethod]
    fn _open(py: Python<'_>, path: PathBuf, ids: Vec<String>) -> Outcome<Self> {
        let dataset = detached(py, || stored::Dataset::open(path))?;
        let ids = ids.iter().map(|id| GraspId::parse(id));
        Ok(Self {
            dataset: Arc::new(dataset),
            ids: ids.collect::<Result<Vec<_>>>()?.into(),
        })
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
    fn ids(&self) -> Vec<&str> {
        self.ids.iter().map(GraspId::as_str).collect()
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
        for id in self.ids.iter() {
            py.check_signals()?;
            let record = self.read(py, id)?.record;
            let is_object = objects.as_ref().is_none_or(|o| o.contains(&record.object));
            let is_outcome = outcomes
                .as_ref()
                .is_none_or(|o| o.contains(&record.outcome));
            if is_object && is_outcome {
                kept.push(id.clone());
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

    fn __len__(&self) -> usize {
        self.ids.len()
    }

    fn __getitem__<'py>(
        &self,
        py: Python<'py>,
        index: &Bound<'py, PyAny>,
    ) -> Outcome<Bound<'py, PyAny>> {
        if let Ok(slice) = index.cast::<PySlice>() {
            let range = slice.indices(self.ids.len() as isize)?;
            let at = (0..range.slicelength as isize).map(|i| range.start + i * range.step);
            let ids = at.map(|at| self.ids[at as usize].clone()).collect();
            return Ok(Bound::new(py, self.with(ids))?.into_any());
        }
        let given: isize = index.extract()?;
        let count = self.ids.len() as isize;
        let at = if given < 0 { given + count } else { given };
        if !(0..count).contains(&at) {
            let text = format!("index {given} is out of range: there are {count} grasps");
            return Err(PyIndexError::new_err(text).into());
        }
        Ok(Bound::new(py, self.read(py, &self.ids[at as usize])?)?.into_any())
    }

    fn __iter__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let builtins = slf.py().import("builtins")?;
        let range = builtins.call_method1("range", (slf.get().ids.len(),))?;
        builtins.call_method1("map", (slf.getattr("__getitem__")?, range))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<Reduced<'py>> {
        let this = slf.get();
        let ids = this.ids.iter().map(ToString::to_string).collect();
        let open = slf.get_type().getattr("_open")?;
        Ok((open, (this.dataset.path().to_owned(), ids)))
    }

    fn __repr__(&self) -> String {
        format!(
            "<Dataset {}: {} grasps, {}>",
            self.name(),
            self.ids.len(),
            self.dataset.path().display()
        )
    }
}

/// A `Dataset` of one grasp, for pickling it.
pub(crate) fn dataset_of(dataset: &Arc<stored::Dataset>, id: &GraspId) -> Dataset {
    Dataset {
        dataset: Arc::clone(dataset),
        ids: [id.clone()].into(),
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
