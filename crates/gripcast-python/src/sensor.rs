//! Sensor profiles.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;

use super::failure::Outcome;
use super::work::detached;
use gripcast_base::error::{Error, Result};
use gripcast_sim::grasp::Finger;
use gripcast_tactile::{ObjectDepthRenderer, SensorName, SensorProfile as Profile};

/// A sensor: geometry, gel, shading, background, noise and gel markers.
#[pyclass(frozen, module = "gripcast")]
#[derive(Clone)]
pub(crate) struct SensorProfile(Arc<Sensor>);

struct Sensor {
    profile: Profile,
    /// Renderers that are not in use; making one costs more than an image.
    renderers: Mutex<Vec<(Finger, ObjectDepthRenderer)>>,
}

impl SensorProfile {
    pub(crate) fn named(name: &str) -> Result<Self> {
        Ok(Self(Arc::new(Sensor {
            profile: Profile::named_or_load(name)?,
            renderers: Mutex::default(),
        })))
    }

    pub(crate) fn profile(&self) -> &Profile {
        &self.0.profile
    }

    /// Runs `work` with a renderer of the sensor on a finger.
    pub(crate) fn with_renderer<T>(
        &self,
        finger: Finger,
        work: impl FnOnce(&mut ObjectDepthRenderer) -> Result<T>,
    ) -> Result<T> {
        let idle = || {
            self.0
                .renderers
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
        };
        let kept = {
            let mut renderers = idle();
            let at = renderers.iter().position(|(of, _)| *of == finger);
            at.map(|at| renderers.swap_remove(at).1)
        };
        let mut renderer = match kept {
            Some(renderer) => renderer,
            None => ObjectDepthRenderer::new(&self.profile().clone().on_finger(finger))?,
        };
        let done = work(&mut renderer)?;
        idle().push((finger, renderer));
        Ok(done)
    }
}

#[pymethods]
impl SensorProfile {
    /// Names of the shipped profiles.
    #[classattr]
    #[allow(non_snake_case)]
    fn SHIPPED(py: Python<'_>) -> PyResult<Py<PyAny>> {
        let names = SensorName::all().map(SensorName::as_str);
        Ok(pyo3::types::PyTuple::new(py, names)?.into_any().unbind())
    }

    /// A shipped profile by name, or a file that ends in .toml.
    #[new]
    #[pyo3(signature = (name_or_path = PathBuf::from("gelsight-mini")))]
    #[pyo3(text_signature = "(name_or_path='gelsight-mini')")]
    fn new(py: Python<'_>, name_or_path: PathBuf) -> Outcome<Self> {
        let name = name_or_path.to_string_lossy().into_owned();
        detached(py, || Self::named(&name))
    }

    /// Name of the profile.
    #[getter]
    fn name(&self) -> &str {
        &self.profile().name
    }

    /// Serial of the sensor; empty for a generic profile.
    #[getter]
    fn serial(&self) -> &str {
        &self.profile().serial
    }

    /// Where its parameters come from.
    #[getter]
    fn provenance(&self) -> &str {
        &self.profile().provenance
    }

    /// Width and height of its images, px.
    #[getter]
    fn size_px(&self) -> (usize, usize) {
        let geometry = &self.profile().geometry;
        (geometry.width, geometry.height)
    }

    /// Scale of its images, m/px.
    #[getter]
    fn m_per_px(&self) -> f64 {
        self.profile().geometry.pixel_m
    }

    /// Crop of the camera frames that yields such images.
    #[getter]
    fn crop_profile(&self) -> &'static str {
        self.profile().crop_profile.name()
    }

    /// Whether the gel has markers.
    #[getter]
    fn has_markers(&self) -> bool {
        self.profile().markers.is_some()
    }

    fn __repr__(&self) -> String {
        let (width, height) = self.size_px();
        let markers = if self.has_markers() {
            "with"
        } else {
            "without"
        };
        format!(
            "<SensorProfile {}: {width} × {height} px, {:.1} µm/px, {markers} gel markers>",
            self.name(),
            1e6 * self.m_per_px()
        )
    }
}

/// A sensor by its profile or name.
pub(crate) fn sensor(value: &Bound<'_, PyAny>) -> Outcome<SensorProfile> {
    if let Ok(profile) = value.cast::<SensorProfile>() {
        return Ok(profile.get().clone());
    }
    let Ok(name) = value.extract::<PathBuf>() else {
        let found = value.get_type().name()?;
        let what = format!("`profile` must be a SensorProfile, a name or a path, found {found}");
        return Err(Error::usage(what).into());
    };
    detached(value.py(), || SensorProfile::named(&name.to_string_lossy()))
}

/// As [`sensor`], its parameters only.
pub(crate) fn profile(value: &Bound<'_, PyAny>) -> Outcome<Profile> {
    Ok(sensor(value)?.profile().clone())
}
