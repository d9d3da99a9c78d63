//! Follows gel markers through images.

use std::sync::atomic::Ordering;

use image::RgbImage;
use pyo3::prelude::*;

use super::arrays::{array, column, image};
use super::failure::Outcome;
use super::placement::check;
use super::sensor::profile as named_profile;
use super::work::interruptible;
use gripcast_base::error::{Error, ErrorKind};
use gripcast_base::number::NumberRange;
use gripcast_shear::{ExpectedMarkers, ShearFrame, ShearProblem, ShearTracker, USUAL_M_PER_PX};
use gripcast_tactile::SensorProfile;

/// Values of a lattice point: rest x, rest y, displacement x, displacement y, confidence.
const VALUES: usize = 5;

/// Follows the skin of a gel through images.
///
/// `frames` are images of one gel, cropped: height × width × 3, uint8, RGB, all of the same size.
/// `initial` is the index of the one that shows the untouched gel; earlier ones are tracked from it
/// backwards and have no slip ratio. `profile` (a `SensorProfile`, a name or a file) gives scale and
/// markers; `m_per_px` the scale alone. Without a scale, lengths in mm are None.
#[pyfunction]
#[pyo3(signature = (frames, *, initial = 0, profile = None, m_per_px = None))]
pub(crate) fn track_markers(
    py: Python<'_>,
    frames: Vec<Bound<'_, PyAny>>,
    initial: usize,
    profile: Option<&Bound<'_, PyAny>>,
    m_per_px: Option<f64>,
) -> Outcome<MarkerTrack> {
    check("m_per_px", m_per_px, NumberRange::POSITIVE)?;
    if profile.is_some() && m_per_px.is_some() {
        let error = Error::usage("`profile` contradicts `m_per_px`");
        return Err(error.remedy("omit one of them").into());
    }
    if initial >= frames.len() {
        return Err(Error::usage(format!(
            "`initial` must be the index of one of {} frames, found {initial}",
            frames.len()
        ))
        .into());
    }
    let mut images: Vec<RgbImage> = Vec::with_capacity(frames.len());
    for (index, frame) in frames.iter().enumerate() {
        py.check_signals()?;
        images.push(image(frame, &format!("frames[{index}]"))?);
    }
    let profile = profile.map(named_profile).transpose()?;
    let scale = m_per_px.or(profile.as_ref().map(|profile| profile.geometry.pixel_m));
    let (source, tracked) = interruptible(py, move |cancel| {
        let expected = profile.as_ref().map(SensorProfile::expected_markers);
        let expected = expected.unwrap_or(ExpectedMarkers::Unknown);
        let untouched = &images[initial];
        let m_per_px = scale.unwrap_or(USUAL_M_PER_PX);
        let mut tracker = ShearTracker::new(untouched, m_per_px, expected)
            .map_err(|e| e.at(format!("frames[{initial}]")))?;
        let before = images[..initial].iter().map(Some);
        let before = tracker.clone().backwards(before).into_iter().flatten();
        let mut tracked: Vec<ShearFrame> = before.collect();
        for image in &images[initial..] {
            if cancel.load(Ordering::Relaxed) {
                let what = "the tracking was interrupted";
                return Err(Error::new(ErrorKind::Interrupted, what));
            }
            tracked.push(tracker.update(image));
        }
        Ok((tracker.source().name(), tracked))
    })?;
    MarkerTrack::new(py, source, &tracked, scale)
}

/// Motion of a gel's skin in n images.
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct MarkerTrack {
    /// markers or texture: what was followed.
    source: &'static str,
    /// Scale, m/px; None if it is not known.
    m_per_px: Option<f64>,
    /// n × rows × columns × 5, float32: rest x, rest y, displacement x, displacement y (px),
    /// confidence; NaN without a gel marker, for the displacement of a lost one and in images that are
    /// left out. None for a gel without markers.
    markers: Option<Py<PyAny>>,
    /// n × 2, float64, mm: mean displacement along x and y.
    mean_displacement_mm: Option<Py<PyAny>>,
    /// n, float64, mm: largest displacement.
    max_displacement_mm: Option<Py<PyAny>>,
    /// n, float64: fraction of the gel markers that are tracked.
    tracked_fraction: Py<PyAny>,
    /// n, float64: fraction of the image in contact.
    contact_fraction: Py<PyAny>,
    /// n, float64: how much of the contact slips; NaN where it is not known.
    slip_ratio: Py<PyAny>,
    /// n, float64: mean divergence of the displacement.
    divergence: Py<PyAny>,
    /// n, float64: mean curl of the displacement.
    curl: Py<PyAny>,
    /// n lists of sentences: what is wrong with an image.
    problems: Vec<Vec<String>>,
}

impl MarkerTrack {
    fn new(
        py: Python<'_>,
        source: &'static str,
        frames: &[ShearFrame],
        m_per_px: Option<f64>,
    ) -> Outcome<Self> {
        let count = frames.len();
        let is_used = |frame: &ShearFrame| !frame.problems.iter().any(|p| p.excludes_image());
        let summary = |frame: &ShearFrame| frame.summary.filter(|_| is_used(frame));
        let field = frames.iter().find_map(|frame| frame.field.as_ref());
        let markers = field.map(|field| {
            let lost = vec![f32::NAN; field.rows * field.columns * VALUES];
            let of_frame = |frame: &ShearFrame| {
                let field = frame.field.as_ref().filter(|_| is_used(frame));
                field.map_or_else(|| lost.clone(), |field| field.to_array().0)
            };
            let values = frames.iter().flat_map(of_frame).collect();
            array::<f32>(py, values, &[count, field.rows, field.columns, VALUES])
        });
        let means = frames.iter().flat_map(|frame| {
            let mean = summary(frame).map(|s| s.mean_displacement_mm);
            mean.unwrap_or([f64::NAN; 2])
        });
        let numbers = |value: fn(&gripcast_shear::ShearSummary) -> Option<f64>| {
            column(py, frames.iter().map(|frame| value(&summary(frame)?)))
        };
        let known = m_per_px.is_some();
        let mean_mm = array::<f64>(py, means.collect(), &[count, 2])?;
        let max_mm = numbers(|s| Some(s.max_displacement_mm))?;
        let problems = frames.iter().map(|frame| {
            let texts = frame
                .problems
                .iter()
                .map(|problem: &ShearProblem| problem.text());
            texts.collect()
        });
        Ok(Self {
            source,
            m_per_px,
            markers: markers.transpose()?,
            mean_displacement_mm: known.then_some(mean_mm),
            max_displacement_mm: known.then_some(max_mm),
            tracked_fraction: numbers(|s| Some(s.tracked_fraction))?,
            contact_fraction: numbers(|s| Some(s.contact_fraction))?,
            slip_ratio: numbers(|s| s.slip_ratio)?,
            divergence: numbers(|s| Some(s.divergence))?,
            curl: numbers(|s| Some(s.curl))?,
            problems: problems.collect(),
        })
    }
}

#[pymethods]
impl MarkerTrack {
    fn __repr__(&self) -> String {
        let wrong = self.problems.iter().filter(|list| !list.is_empty()).count();
        format!(
            "<MarkerTrack of {}: {} images, {wrong} with problems>",
            self.source,
            self.problems.len()
        )
    }
}
