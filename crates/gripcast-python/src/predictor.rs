//! Predicts stability.

use std::path::PathBuf;
use std::sync::Arc;

use image::RgbImage;
use pyo3::prelude::*;

use super::arrays::{depth_counts, described, image};
use super::failure::Outcome;
use super::sensor::profile as named_profile;
use super::work::{detached, interruptible, pool};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{CropProfile, Depth, DepthImage, DepthView, ObjectTracker, crop_and_resize};
use gripcast_nn::predict::contract::{IMAGE_HEIGHT, IMAGE_WIDTH, InputName};
use gripcast_nn::predict::{InputImages, Model, SHIPPED, lift};
use gripcast_shear::{ExpectedMarkers, USUAL_M_PER_PX};
use gripcast_tactile::SensorProfile;

/// Unit of depth images, m.
const DEPTH_UNIT_M: f64 = 1e-3;

/// Copies the images of the left and the right gel.
fn both(images: &Bound<'_, PyAny>, name: &str) -> Outcome<[RgbImage; 2]> {
    let Ok([left, right]) = images.extract::<[Bound<'_, PyAny>; 2]>() else {
        let found = described(images);
        return Err(Error::input(format!(
            "`{name}` must be the images (left, right) of both gels; found {found}"
        ))
        .into());
    };
    let left = image(&left, &format!("{name}[0]"))?;
    Ok([left, image(&right, &format!("{name}[1]"))?])
}

/// A model that predicts whether a grasp is stable.
#[pyclass(frozen, module = "gripcast")]
pub(crate) struct Predictor {
    model: Arc<Model>,
    source: String,
}

#[pymethods]
impl Predictor {
    /// An ONNX file, `gripcast-vt` (built-in classifier) or `baseline-contact` (built-in heuristic).
    #[new]
    #[pyo3(signature = (model = PathBuf::from(SHIPPED)))]
    #[pyo3(text_signature = "(model='gripcast-vt')")]
    fn new(py: Python<'_>, model: PathBuf) -> Outcome<Self> {
        let source = model.to_string_lossy().into_owned();
        let name = source.clone();
        let pool = pool(None)?;
        let model = interruptible(py, move |_| pool.install(|| Model::by_name(&name)))?;
        Ok(Self {
            model: Arc::new(model),
            source,
        })
    }

    /// Predicts a grasp before the lift.
    ///
    /// `initial` and `grasp` are the images (left, right) of the gels with the gripper open and closed,
    /// `rgb` is the colour image with the gripper closed: height × width × 3, uint8, RGB. `depth` is
    /// the depth image: height × width, uint16, mm; its `depth_view` is `colour` if it is aligned to the
    /// colour image, `left-imager` for a D435's as it streams them. Inputs that are not given are
    /// missing: the model predicts from the others if it can (`Prediction.inputs`). Tactile
    /// images are cropped already and of 320 × 240 pixels, as those of `Grasp.tactile_image` and
    /// `render_tactile`, unless `crop` names a crop profile (`Predictor.crop_profile` for frames of a
    /// camera, `full-v1` for none).
    ///
    /// `lift` are the images (left, right) of the gels after `grasp`, in order and about 40 ms apart;
    /// `Prediction.lift` has the verdict on each. `profile` (a `SensorProfile`, a name or a file) is the
    /// sensor of these images, with their scale and gel markers; without it the images decide.
    /// `lift_depth` are the depth images at the same times, of the same camera as `depth`: with them
    /// the verdict also follows the motion of the object in the grip.
    #[allow(clippy::too_many_arguments)]
    #[pyo3(signature = (
        initial = None, grasp = None, rgb = None, depth = None, lift = None, *, depth_view = "colour",
        crop = None, profile = None, lift_depth = None
    ))]
    fn predict(
        &self,
        py: Python<'_>,
        initial: Option<Bound<'_, PyAny>>,
        grasp: Option<Bound<'_, PyAny>>,
        rgb: Option<Bound<'_, PyAny>>,
        depth: Option<Bound<'_, PyAny>>,
        lift: Option<Vec<Bound<'_, PyAny>>>,
        depth_view: &str,
        crop: Option<&str>,
        profile: Option<&Bound<'_, PyAny>>,
        lift_depth: Option<Vec<Bound<'_, PyAny>>>,
    ) -> Outcome<Prediction> {
        let views = DepthView::ALL.into_iter();
        let view = views.clone().find(|view| view.name() == depth_view);
        let view = view.ok_or_else(|| {
            let names: Vec<&str> = views.map(DepthView::name).collect();
            Error::usage(format!(
                "`depth_view`: expected {}, found `{depth_view}`",
                names.join(" or ")
            ))
        })?;
        let contract = self.model.contract();
        let crop = crop.map(CropProfile::by_name).transpose()?;
        if let Some(crop) = crop.filter(|crop| *crop != CropProfile::FULL) {
            contract.check_crop_profile(crop.name())?;
        }
        let initial = initial.map(|pair| both(&pair, "initial")).transpose()?;
        let grasp = grasp.map(|pair| both(&pair, "grasp")).transpose()?;
        let mut lift_images = Vec::new();
        for (index, pair) in lift.iter().flatten().enumerate() {
            py.check_signals()?;
            lift_images.push(both(pair, &format!("lift[{index}]"))?);
        }
        let profile = profile.map(named_profile).transpose()?;
        let rgb = rgb.map(|rgb| image(&rgb, "rgb")).transpose()?;
        let depth = depth
            .map(|depth| depth_counts(&depth, "depth"))
            .transpose()?;
        let mut lift_counts = Vec::new();
        for (index, image) in lift_depth.iter().flatten().enumerate() {
            lift_counts.push(depth_counts(image, &format!("lift_depth[{index}]"))?);
        }
        if lift_depth.is_some() {
            if depth.is_none() {
                return Err(missing("depth").into());
            }
            let (found, expected) = (lift_counts.len(), lift_images.len());
            if found != expected {
                let what =
                    format!("`lift_depth` has {found} images, expected {expected} as `lift`");
                return Err(Error::input(what).into());
            }
        }
        let gels = match (&initial, &grasp) {
            (Some(initial), Some(grasp)) => Some([initial, grasp]),
            (None, None) => None,
            (None, Some(_)) => return Err(missing("initial").into()),
            (Some(_), None) => return Err(missing("grasp").into()),
        };
        let has_lift = lift.is_some();
        if has_lift && gels.is_none() {
            return Err(missing("initial").into());
        }
        let pool = pool(None)?;
        let (found, lift) = detached(py, || {
            let found = pool.install(|| {
                self.model.predict_grasp(|input| {
                    let tactile = |gel: usize| {
                        let of = |pair: &[RgbImage; 2], name: &str| {
                            tactile(&pair[gel], crop.as_ref(), &format!("{name}[{gel}]"))
                        };
                        let both = |[initial, grasp]: [&[RgbImage; 2]; 2]| {
                            Ok::<_, Error>(InputImages::Tactile {
                                initial: of(initial, "initial")?,
                                grasp: of(grasp, "grasp")?,
                            })
                        };
                        gels.map(both).transpose()
                    };
                    match input {
                        InputName::TactileLeft => tactile(0),
                        InputName::TactileRight => tactile(1),
                        InputName::Rgb => {
                            let image = rgb.as_ref().map(|rgb| resized(rgb, &CropProfile::FULL));
                            Ok(image.transpose()?.map(InputImages::Rgb))
                        }
                        InputName::Depth => Ok(depth.clone().map(|image| {
                            let unit_m = DEPTH_UNIT_M;
                            InputImages::Depth(Depth { image, unit_m }, view)
                        })),
                    }
                })
            })?;
            let p_before = found.prediction.p_stable;
            let follow = |[initial, grasp]: [&[RgbImage; 2]; 2]| {
                let cropped = |pair: &[RgbImage; 2], name: &str| {
                    let of =
                        |gel: usize| tactile(&pair[gel], crop.as_ref(), &format!("{name}[{gel}]"));
                    Ok::<_, Error>([of(0)?, of(1)?])
                };
                let head = self.model.lift_head().ok_or_else(|| {
                    Error::input("the model has no verdict in the lift")
                        .remedy("use gripcast-vt, or train on a dataset with `lift_motion`")
                })?;
                let (initial, grasp) = (cropped(initial, "initial")?, cropped(grasp, "grasp")?);
                let images = lift_images.iter().enumerate();
                let images = images.map(|(index, pair)| cropped(pair, &format!("lift[{index}]")));
                let images = images.collect::<Result<Vec<_>>>()?;
                let counts = |image: &DepthImage| Depth {
                    image: image.clone(),
                    unit_m: DEPTH_UNIT_M,
                };
                let before = depth
                    .as_ref()
                    .filter(|_| !lift_counts.is_empty())
                    .map(counts);
                let tracker = before.and_then(|before| ObjectTracker::new(&before, view));
                let objects = (0..images.len()).map(|index| {
                    let image = counts(lift_counts.get(index)?);
                    tracker.as_ref()?.motion(&image, view)
                });
                let scale = profile.as_ref().map(|profile| profile.geometry.pixel_m);
                head.follow(
                    p_before,
                    initial.each_ref(),
                    grasp.each_ref(),
                    images.iter().map(<[RgbImage; 2]>::each_ref).zip(objects),
                    scale.unwrap_or(USUAL_M_PER_PX),
                    profile
                        .as_ref()
                        .map_or(ExpectedMarkers::Unknown, SensorProfile::expected_markers),
                )
            };
            let lift = gels.filter(|_| has_lift).map(follow).transpose()?;
            Ok::<_, Error>((found, lift))
        })?;
        let lift = lift.map(|verdicts| verdicts.into_iter().map(LiftVerdict::from).collect());
        Ok(Prediction {
            p_stable: found.prediction.p_stable,
            threshold: found.prediction.threshold,
            inputs: Some(found.prediction.modality.name().to_owned()),
            geometry_m: found.prediction.geometry.map(|g| g.to_array()),
            predicted: found.label.name(),
            ood_score: found.ood_score,
            unsure_reason: found.unsure_reason,
            engine_ms: found.prediction.engine_ms,
            model: contract.name.clone(),
            model_sha256: self.model.sha256().to_owned(),
            lift,
        })
    }

    /// Name of the model.
    #[getter]
    fn name(&self) -> &str {
        &self.model.contract().name
    }

    /// Hash of the ONNX file.
    #[getter]
    fn sha256(&self) -> &str {
        self.model.sha256()
    }

    /// Its inputs: tactile_left, tactile_right, rgb, depth.
    #[getter]
    fn inputs(&self) -> Vec<String> {
        let inputs = self.model.contract().modality.inputs();
        inputs.iter().map(ToString::to_string).collect()
    }

    /// Crop of the camera frames that it was trained with; `any` for a heuristic.
    #[getter]
    fn crop_profile(&self) -> &'static str {
        self.model.contract().crop_profile_name()
    }

    /// Smallest probability that is predicted to be stable.
    #[getter]
    fn threshold(&self) -> f64 {
        self.model.contract().threshold
    }

    /// Whether it is a heuristic and not trained.
    #[getter]
    fn is_heuristic(&self) -> bool {
        self.model.contract().is_heuristic()
    }

    fn __reduce__(&self, py: Python<'_>) -> (Py<PyAny>, (String,)) {
        let class = py.get_type::<Self>().into_any().unbind();
        (class, (self.source.clone(),))
    }

    fn __repr__(&self) -> String {
        format!(
            "<Predictor {}: inputs {}, threshold {}>",
            self.name(),
            self.inputs().join(", "),
            self.threshold()
        )
    }
}

fn missing(argument: &str) -> Error {
    Error::usage(format!(
        "expected `{argument}` beside the other tactile images, found None"
    ))
    .remedy("give `initial` and `grasp`, each the images of both gels, (left, right)")
}

fn tactile(image: &RgbImage, crop: Option<&CropProfile>, name: &str) -> Result<RgbImage> {
    let size = (IMAGE_WIDTH, IMAGE_HEIGHT);
    match crop {
        Some(crop) => resized(image, crop),
        None if image.dimensions() == size => Ok(image.clone()),
        None => {
            let (width, height) = image.dimensions();
            Err(Error::input(format!(
                "`{name}` must be cropped and of {IMAGE_WIDTH}×{IMAGE_HEIGHT} pixels, found \
                 {width}×{height}"
            ))
            .remedy(
                "for frames of a camera pass its `crop` profile, for cropped images of another size \
                 crop=\"full-v1\"",
            ))
        }
    }
}

fn resized(image: &RgbImage, crop: &CropProfile) -> Result<RgbImage> {
    Ok(crop_and_resize(image, crop, IMAGE_WIDTH, IMAGE_HEIGHT)?)
}

/// What a model says of a grasp.
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct Prediction {
    /// Probability that the grasp is stable.
    pub(crate) p_stable: f64,
    /// Smallest probability that is predicted to be stable.
    pub(crate) threshold: f64,
    /// Inputs that it is made from: V colour, T touch, D depth; None in older datasets.
    pub(crate) inputs: Option<String>,
    /// Extents of the object in the gripper frame as the model sees them, m: x, y and z bounds, y
    /// bounds at the height of the gels, y and z of the centre; None without camera images.
    pub(crate) geometry_m: Option<[f64; 10]>,
    /// stable, slip or unsure.
    pub(crate) predicted: &'static str,
    /// OOD score of the tactile images, 1 at the threshold; None where the model has none.
    pub(crate) ood_score: Option<f64>,
    /// Why the images cannot tell, one sentence; None where they can.
    pub(crate) unsure_reason: Option<String>,
    /// Inference time, ms.
    pub(crate) engine_ms: f64,
    /// Name of the model.
    pub(crate) model: String,
    /// Hash of the ONNX file.
    pub(crate) model_sha256: String,
    /// Verdict on each image of the lift; None without such images.
    pub(crate) lift: Option<Vec<LiftVerdict>>,
}

#[pymethods]
impl Prediction {
    fn __repr__(&self) -> String {
        let reason = self.unsure_reason.as_ref();
        format!(
            "<Prediction {}: p_stable {:.3}, threshold {}{}>",
            self.predicted,
            self.p_stable,
            self.threshold,
            reason.map_or(String::new(), |reason| format!("; {reason}"))
        )
    }
}

/// Verdict on an image of the lift.
#[pyclass(frozen, get_all, module = "gripcast")]
#[derive(Clone)]
pub(crate) struct LiftVerdict {
    /// Probability that the grasp holds.
    p_stable: f64,
    /// Whether it is at least the threshold of the verdict in the lift.
    is_stable: bool,
    /// Whether the contact is being lost: the alarm.
    is_slipping: bool,
}

impl From<lift::LiftVerdict> for LiftVerdict {
    fn from(verdict: lift::LiftVerdict) -> Self {
        Self {
            p_stable: verdict.p_stable,
            is_stable: verdict.is_stable,
            is_slipping: verdict.is_slipping,
        }
    }
}

#[pymethods]
impl LiftVerdict {
    fn __repr__(&self) -> String {
        let alarm = if self.is_slipping { ", slipping" } else { "" };
        let name = if self.is_stable { "stable" } else { "slip" };
        format!("<LiftVerdict {name}: p_stable {:.3}{alarm}>", self.p_stable)
    }
}
