//! Sensor profiles.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;

use super::arrays::image_array;
use super::failure::Outcome;
use super::placement::check;
use super::work::{detached, interruptible, pool};
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_base::number::NumberRange;
use gripcast_imaging::CropProfile;
use gripcast_sim::grasp::Finger;
use gripcast_tactile::calibrate::{self, CalibrateOptions, ModelChoice, ReadOptions, Split, Terms};
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
        Ok(Self::of(Profile::named_or_load(name)?))
    }

    fn of(profile: Profile) -> Self {
        Self(Arc::new(Sensor {
            profile,
            renderers: Mutex::default(),
        }))
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

    /// Fits a profile to presses of a ball, as `gripcast render calibrate` does.
    ///
    /// `presses` is a folder with an image without contact and images of a ball of the diameter
    /// `ball_m` (m) pressed into the gel, with or without a presses.json. Half of the presses, drawn by
    /// `seed`, are fitted (`train_fraction`), the others are scored. `model` is polynomial or leds.
    /// `m_per_px` is the scale of the stored images; `fit_scale` searches it within 15 %.
    #[staticmethod]
    #[pyo3(signature = (presses, *, ball_m = None, m_per_px = None, name = "sensor", serial = "", model = "polynomial", train_fraction = 0.5, fit_scale = false, crop = "full-v1", crop_profile = "gsmini-seventh-v1", seed = 0))]
    #[allow(clippy::too_many_arguments)]
    fn fit(
        py: Python<'_>,
        presses: PathBuf,
        ball_m: Option<f64>,
        m_per_px: Option<f64>,
        name: &str,
        serial: &str,
        model: &str,
        train_fraction: f64,
        fit_scale: bool,
        crop: &str,
        crop_profile: &str,
        seed: u64,
    ) -> Outcome<SensorFit> {
        check("ball_m", ball_m, NumberRange::POSITIVE)?;
        check("m_per_px", m_per_px, NumberRange::POSITIVE)?;
        // NaN is refused, too.
        if !(train_fraction > 0.0 && train_fraction <= 1.0) {
            return Err(Error::usage(format!(
                "`train_fraction` must be above 0 and at most 1, found {train_fraction}"
            ))
            .into());
        }
        let options = CalibrateOptions {
            read: ReadOptions {
                ball_diameter_m: ball_m,
                pixel_m: m_per_px,
                crop: CropProfile::by_name(crop)?,
                ..ReadOptions::from_folder(&presses)
            },
            split: Split::Random {
                train_fraction,
                max_fitted: None,
                seed,
            },
            model: match model {
                "polynomial" => ModelChoice::Polynomial(Terms::default()),
                "leds" => ModelChoice::Leds,
                other => return Err(unknown_name("model", other, &["polynomial", "leds"]).into()),
            },
            fit_scale,
            name: name.to_owned(),
            serial: serial.to_owned(),
            crop_profile: CropProfile::by_name(crop_profile)?,
            ..CalibrateOptions::from_folder(&presses)
        };
        let pool = pool(None)?;
        let fitted = interruptible(py, move |_| pool.install(|| calibrate::run(&options)))?;
        let report = serde_json::to_string(&fitted.report)
            .map_err(|e| Error::internal("cannot write the report as JSON").because(e))?;
        Ok(SensorFit {
            profile: Py::new(py, Self::of(fitted.profile))?,
            fve: fitted.report.score.fve,
            image: image_array(py, fitted.image)?,
            notes: fitted.report.notes,
            report: py
                .import("json")?
                .call_method1("loads", (report,))?
                .unbind(),
        })
    }

    /// Writes the profile to a .toml file, with its background as a .png beside it.
    fn save(&self, py: Python<'_>, path: PathBuf) -> Outcome<()> {
        if path.extension().is_none_or(|suffix| suffix != "toml") {
            let what = "`path` must end in .toml";
            return Err(Error::usage(what).at(path.display()).into());
        }
        detached(py, || self.profile().save(&path))
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

/// A sensor profile fitted to presses.
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct SensorFit {
    /// The fitted profile.
    profile: Py<SensorProfile>,
    /// Fraction of the variance in the contacts that it explains, on the presses that were not fitted.
    fve: f64,
    /// Real, rendered and residual images of scored presses: height × width × 3, uint8, RGB.
    image: Py<PyAny>,
    /// What to check before the profile is used, one sentence each.
    notes: Vec<String>,
    /// Scores, presses and chosen terms, as `gripcast render calibrate --json` prints them.
    report: Py<PyAny>,
}

#[pymethods]
impl SensorFit {
    fn __repr__(&self) -> String {
        format!(
            "<SensorFit {}: FVE {:.3}>",
            self.profile.get().name(),
            self.fve
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
