//! Errors of Python: the exceptions of `gripcast._errors`.

use std::error::Error as _;

use pyo3::prelude::*;

use gripcast_base::error::{Error, ErrorKind};

/// Result of a function of the module.
pub(crate) type Outcome<T> = Result<T, Failure>;

/// An error of gripcast or of Python.
pub(crate) enum Failure {
    Gripcast(Error),
    Python(PyErr),
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::Gripcast(error)
    }
}

impl From<PyErr> for Failure {
    fn from(error: PyErr) -> Self {
        Self::Python(error)
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Python(error) => error,
            Failure::Gripcast(error) => {
                Python::attach(|py| exception(py, &error).unwrap_or_else(|e| e))
            }
        }
    }
}

/// Names of options whose argument in Python is not just the option with underscores.
const ARGUMENTS: [(&str, &str); 12] = [
    ("adjust", "adjust_s"),
    ("depth-m", "depths_m"),
    ("dt", "dt_s"),
    ("eps-v", "eps_v_m_s"),
    ("height", "height_m"),
    ("lift", "lift_m"),
    ("max-opening", "max_opening_m"),
    ("offset-x", "offset_m"),
    ("offset-y", "offset_m"),
    ("pose", "GraspPose"),
    ("shift-m", "shifts_m"),
    ("width", "opening_m"),
];

fn exception(py: Python<'_>, error: &Error) -> PyResult<PyErr> {
    let class = match error.kind() {
        ErrorKind::Usage => "UsageError",
        ErrorKind::Config => "ConfigError",
        ErrorKind::Input => "InputError",
        ErrorKind::NotFound => "NotFoundError",
        ErrorKind::Permission => "AccessError",
        ErrorKind::Io => "IoError",
        ErrorKind::Busy => "BusyError",
        ErrorKind::Internal => "InternalError",
        _ => "Error",
    };
    let mut what = in_python(error.what());
    if let Some(source) = error.source() {
        what = format!("{what}: {source}");
    }
    let remedy = error.remedy_text().map(in_python);
    let class = py.import("gripcast._errors")?.getattr(class)?;
    let value = class.call1((what, error.location(), remedy))?;
    Ok(PyErr::from_value(value))
}

/// Rewrites options of the command line as arguments: `--stop-force-n` is `stop_force_n`.
fn in_python(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find("--") {
        let (before, after) = rest.split_at(at);
        let name = &after[2..];
        let end = name
            .find(|c: char| !(c.is_ascii_lowercase() || c == '-'))
            .unwrap_or(name.len());
        let (name, after) = name.split_at(end);
        let begins_word = !before.ends_with(|c: char| c.is_alphanumeric() || c == '-');
        out.push_str(before);
        if begins_word && name.starts_with(|c: char| c.is_ascii_lowercase()) {
            let known = ARGUMENTS.iter().find(|(option, _)| *option == name);
            let argument = known.map_or(name.replace('-', "_"), |(_, to)| (*to).to_owned());
            out.push_str(&argument);
        } else {
            out.push_str("--");
            out.push_str(name);
        }
        rest = after;
    }
    out.push_str(rest);
    out
}

/// `TypeError`-like errors of one argument, with its name.
pub(crate) fn argument<'py, T>(value: &Bound<'py, PyAny>, name: &str) -> PyResult<T>
where
    T: for<'a> FromPyObject<'a, 'py>,
{
    let extracted = value.extract::<T>().map_err(Into::<PyErr>::into);
    extracted.map_err(|error| {
        let py = value.py();
        let text = format!("argument `{name}`: {}", error.value(py));
        let named = error.get_type(py).call1((text,));
        named.map_or_else(|e| e, PyErr::from_value)
    })
}

/// Panics on purpose: the tests see that it becomes an `InternalError`. Not in wheels, which are built
/// without debug assertions.
#[cfg(debug_assertions)]
#[pyfunction]
#[pyo3(name = "_panic")]
#[allow(clippy::panic)]
pub(crate) fn panic_for_test(py: Python<'_>) -> Outcome<()> {
    super::work::detached(py, || panic!("on purpose"))
}
