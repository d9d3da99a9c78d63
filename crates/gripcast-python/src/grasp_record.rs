//! One grasp of a dataset.

use std::sync::Arc;

use pyo3::prelude::*;

use super::arrays::{array, image_array};
use super::dataset::{dataset_of, explained};
use super::failure::Outcome;
use super::pose::Pose;
use super::predictor::Prediction;
use super::work::detached;
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_dataset::{Dataset, GraspRecord, MARKERS, Stage};
use gripcast_imaging::{Decoder, DepthView, Role, TactileDifference};
use gripcast_nn::predict::PredictedLabel;

/// A grasp of a dataset. Images are decoded when they are asked for.
#[pyclass(frozen, module = "gripcast")]
pub(crate) struct Grasp {
    pub(crate) dataset: Arc<Dataset>,
    pub(crate) record: GraspRecord,
    pub(crate) json: Vec<u8>,
}

pub(crate) fn stage_of(name: &str) -> Result<Stage> {
    let found = Stage::ALL.into_iter().find(|stage| stage.name() == name);
    found.ok_or_else(|| unknown_name("stage", name, &Stage::ALL.map(Stage::name)))
}

pub(crate) fn role_of(name: &str) -> Result<Role> {
    let found = Role::ALL.into_iter().find(|role| role.name() == name);
    found.ok_or_else(|| unknown_name("role", name, &Role::ALL.map(Role::name)))
}

pub(crate) fn gel_of(name: &str) -> Result<Role> {
    match name {
        "left" => Ok(Role::Left),
        "right" => Ok(Role::Right),
        _ => Err(unknown_name("side", name, &["left", "right"])),
    }
}

impl Grasp {
    /// Reads a file of the grasp.
    fn load<T: Send>(&self, py: Python<'_>, read: impl FnOnce() -> Result<T> + Send) -> Outcome<T> {
        detached(py, || read().map_err(|e| explained(&self.dataset, e)))
    }

    fn place(&self, role: Role, stage: Stage) -> String {
        let (path, id) = (self.dataset.path().display(), &self.record.id);
        format!("{path}: grasps/{id} {role} {}", stage.name())
    }
}

#[pymethods]
impl Grasp {
    /// Id, the name of its folder.
    #[getter]
    fn id(&self) -> &str {
        self.record.id.as_str()
    }

    /// Name of the object.
    #[getter]
    fn object(&self) -> &str {
        self.record.object.as_str()
    }

    /// Scene.
    #[getter]
    fn scene(&self) -> &str {
        self.record.scene.as_str()
    }

    /// Operator of the gripper.
    #[getter]
    fn operator(&self) -> &str {
        self.record.operator.as_str()
    }

    /// stable, slip or unlabelled.
    #[getter]
    fn outcome(&self) -> String {
        self.record.outcome.to_string()
    }

    /// Whether a virtual rig took it.
    #[getter]
    fn is_simulated(&self) -> bool {
        self.record.is_simulated()
    }

    /// Time of the grasp frame, RFC 3339 UTC.
    #[getter]
    fn captured_at(&self) -> &str {
        &self.record.grasp.captured_at
    }

    /// The prediction before the lift; None without one.
    #[getter]
    fn prediction(&self) -> Option<Prediction> {
        let prediction = self.record.prediction.as_ref()?;
        let label = PredictedLabel::new(
            prediction.shown_p_stable(),
            prediction.threshold,
            prediction.ood_score,
        );
        let label = match (&prediction.unsure_reason, prediction.set) {
            (Some(_), _) => PredictedLabel::Unsure,
            (None, Some(set)) => label.within(set.stable, set.slip),
            (None, None) => label,
        };
        Some(Prediction {
            p_stable: prediction.p_stable,
            threshold: prediction.threshold,
            inputs: prediction.inputs.clone(),
            geometry_m: prediction.geometry.map(|geometry| geometry.to_array()),
            predicted: label.name(),
            ood_score: prediction.ood_score,
            unsure_reason: prediction.unsure_reason.clone(),
            engine_ms: prediction.engine_ms,
            model: prediction.model.clone(),
            model_sha256: prediction.model_sha256.clone(),
            lift: None,
        })
    }

    /// Pose of the gripper in the object's frame; None where it is not annotated.
    #[getter]
    fn t_object_gripper(&self) -> Outcome<Option<Pose>> {
        let pose = self.record.pose.as_ref();
        let pose = pose.map(|pose| pose.t_object_gripper().map_err(|e| e.at(self.id())));
        Ok(pose.transpose()?.map(Pose))
    }

    /// The whole record, as in `grasp.json`.
    #[getter]
    fn record<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        py.import("json")?.call_method1("loads", (&self.json[..],))
    }

    /// Cameras with an image of a stage (initial or grasp): left, right, rgb, depth, external.
    #[pyo3(signature = (stage = "grasp"))]
    fn roles(&self, stage: &str) -> Outcome<Vec<&'static str>> {
        let cameras = &self.record.stage(stage_of(stage)?).cameras;
        Ok(cameras.keys().map(|role| role.name()).collect())
    }

    /// The image of a camera at its own size: height × width × 3, uint8, RGB.
    #[pyo3(signature = (role, stage = "grasp"))]
    fn image(&self, py: Python<'_>, role: &str, stage: &str) -> Outcome<Py<PyAny>> {
        let (role, stage) = (role_of(role)?, stage_of(stage)?);
        if role == Role::Depth {
            return Err(Error::usage("the depth camera has no colour image")
                .remedy("use `depth_m()`")
                .into());
        }
        let image = self.load(py, || {
            let frame = self.dataset.load_frame(&self.record, stage, role)?;
            let image = Decoder::new()?.decode_full(&frame);
            image.map_err(|e| Error::from(e).at(self.place(role, stage)))
        })?;
        Ok(image_array(py, image)?)
    }

    /// The depth image: height × width, float32, m; NaN where it is unknown.
    fn depth_m(&self, py: Python<'_>) -> Outcome<Py<PyAny>> {
        let (role, stage) = (Role::Depth, Stage::Grasp);
        let (values, shape) = self.load(py, || {
            let frame = self.dataset.load_frame(&self.record, stage, role)?;
            let camera = self.record.stage(stage).cameras.get(&role);
            let unit_m = camera
                .and_then(|camera| camera.depth_unit_m)
                .ok_or_else(|| {
                    Error::input("the record has no unit of the depth").at(self.place(role, stage))
                })?;
            let depth = Decoder::new()?.depth(&frame);
            let depth = depth.map_err(|e| Error::from(e).at(self.place(role, stage)))?;
            let metres = depth.as_raw().iter().map(|&counts| match counts {
                0 => f32::NAN,
                counts => (f64::from(counts) * unit_m) as f32,
            });
            let shape = [depth.height() as usize, depth.width() as usize];
            Ok((metres.collect::<Vec<f32>>(), shape))
        })?;
        Ok(array(py, values, &shape)?)
    }

    /// Camera whose view the depth image shows, as `Predictor.predict` takes it: "colour", aligned to
    /// the colour image, or "left-imager", that of a D435; None without depth or for another camera.
    #[getter]
    fn depth_view(&self) -> Option<&'static str> {
        let camera = self.record.grasp.cameras.get(&Role::Depth)?;
        let view = DepthView::of_camera(self.record.is_simulated(), &camera.product);
        view.map(DepthView::name)
    }

    /// The image of a gel (left or right), cropped as models see it: 240 × 320 × 3, uint8, RGB.
    #[pyo3(signature = (side, stage = "grasp"))]
    fn tactile_image(&self, py: Python<'_>, side: &str, stage: &str) -> Outcome<Py<PyAny>> {
        let (role, stage) = (gel_of(side)?, stage_of(stage)?);
        let image = self.load(py, || {
            let mut decoder = Decoder::new()?;
            self.dataset
                .tactile_image(&mut decoder, &self.record, stage, role)
        })?;
        Ok(image_array(py, image)?)
    }

    /// Tactile difference of a gel, grasp − initial: 240 × 320 × 3, int16, grey levels.
    fn tactile_difference(&self, py: Python<'_>, side: &str) -> Outcome<Py<PyAny>> {
        let role = gel_of(side)?;
        let difference = self.load(py, || {
            let mut decoder = Decoder::new()?;
            let mut image = |stage| {
                self.dataset
                    .tactile_image(&mut decoder, &self.record, stage, role)
            };
            TactileDifference::between(&image(Stage::Initial)?, &image(Stage::Grasp)?)
        })?;
        let shape = [difference.height() as usize, difference.width() as usize, 3];
        Ok(array(py, difference.levels().to_vec(), &shape)?)
    }

    /// Names of the field arrays of a gel.
    #[pyo3(signature = (side, stage = "grasp"))]
    fn fields(&self, side: &str, stage: &str) -> Outcome<Vec<String>> {
        let fields = &self.record.stage(stage_of(stage)?).fields;
        let fields = fields.get(&gel_of(side)?).into_iter().flatten();
        Ok(fields.map(|(name, _)| name.to_string()).collect())
    }

    /// A field array of a gel, float32; the record says what its axes are.
    #[pyo3(signature = (name, side, stage = "grasp"))]
    fn field(&self, py: Python<'_>, name: &str, side: &str, stage: &str) -> Outcome<Py<PyAny>> {
        let (role, stage) = (gel_of(side)?, stage_of(stage)?);
        let field = self.load(py, || self.dataset.field(&self.record, stage, role, name))?;
        Ok(array(py, field.values().to_vec(), field.shape())?)
    }

    /// The gel markers: rows × columns × 5, float32: rest x, rest y, displacement x, displacement y
    /// (px of the cropped image), confidence; NaN where there is none. None where they are not stored.
    #[pyo3(signature = (side, stage = "grasp"))]
    fn markers(&self, py: Python<'_>, side: &str, stage: &str) -> Outcome<Option<Py<PyAny>>> {
        let fields = self.fields(side, stage)?;
        match fields.iter().any(|name| name == MARKERS) {
            true => self.field(py, MARKERS, side, stage).map(Some),
            false => Ok(None),
        }
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        let dataset = Bound::new(py, dataset_of(&self.dataset, &self.record.id))?;
        Ok((dataset.getattr("grasp")?, (self.id().to_owned(),)))
    }

    fn __repr__(&self) -> String {
        format!(
            "<Grasp {}: {}, {}>",
            self.id(),
            self.object(),
            self.outcome()
        )
    }
}
