//! Loads and runs a model file.

use std::panic::AssertUnwindSafe;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use tract_onnx::pb::ModelProto;
use tract_onnx::prelude::{
    Framework as _, InferenceModelExt as _, IntoRunnable as _, TValue, TVec, Tensor, TractResult,
    TypedRunnableModel, TypedSimpleState,
};
use tract_onnx::tract_core::internal::bail;
use tract_onnx::tract_core::ops::konst::Const;
use tract_onnx::tract_core::plan::eval;

use super::conformal::{self, ConformalLimits, ConformalScores};
use super::contract::{
    self, GEOMETRY, GEOMETRY_UNIT_M, InputName, Modality, ModelContract, contact_output,
    geometry_output, output_of,
};
use super::graph_check;
use super::grasp_head::{self, GraspHead};
use super::input::{InputTensor, ModelInput};
use super::lift::{self, LiftHead};
use super::native_engine::NativeEngine;
use super::onnx::{self, PYTORCH_EXPORT};
use super::ood::{self, OodDetector};
use gripcast_base::catch_panic::catch_panic;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::sha256_hex;
use gripcast_geometry::GraspGeometry;

/// A checked model, ready to run on the calling thread.
#[derive(Debug)]
pub struct Model {
    contract: ModelContract,
    sha256: String,
    load_ms: f64,
    ood_detector: Option<OodDetector>,
    grasp_head: GraspHead,
    lift_head: Option<LiftHead>,
    conformal_scores: Option<ConformalScores>,
    engine: Engine,
}

#[derive(Debug)]
enum Engine {
    /// For networks trained by gripcast.
    Native(Box<NativeEngine>),
    /// For any other graph.
    Tract {
        /// Inputs in the order of the graph.
        order: Vec<InputName>,
        /// Names of the outputs in the order of the graph.
        outputs: Vec<String>,
        model: Arc<TypedRunnableModel>,
    },
}

impl Engine {
    fn tract(proto: &ModelProto, contract: &ModelContract) -> Result<Self> {
        let outputs = proto.graph.iter().flat_map(|graph| &graph.output);
        Ok(Self::Tract {
            order: input_order(proto, contract),
            outputs: outputs.map(|output| output.name.clone()).collect(),
            model: guarded("build the model's graph", || optimise(proto))?,
        })
    }
}

/// Outputs of an engine for one grasp.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Values {
    pub(super) p_stable: f32,
    /// Geometry in units of 0.03 m, by camera input.
    pub(super) geometry: Vec<(InputName, [f32; GEOMETRY])>,
    /// Contact maps of the left and the right gel, as in the outputs; empty without touch.
    pub(super) contact: Vec<Vec<f32>>,
}

impl Values {
    /// Features of the grasp head.
    fn features(&self) -> Vec<f64> {
        let gels = match &self.contact[..] {
            [left, right] => grasp_head::gel_features([left, right]).to_vec(),
            _ => Vec::new(),
        };
        let extents = self.geometry.iter().flat_map(|(_, values)| values);
        gels.into_iter()
            .chain(extents.copied().map(f64::from))
            .collect()
    }
}

/// Prediction of one grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// Probability that the grasp is stable.
    pub p_stable: f64,
    /// The inputs that it is made from.
    pub modality: Modality,
    /// Minimum probability of a stable grasp.
    pub threshold: f64,
    /// Geometry of the grasp as the model sees it; none without camera images.
    pub geometry: Option<GraspGeometry>,
    /// Inference time of the model, ms.
    pub engine_ms: f64,
}

impl Model {
    /// Reads, checks and optimises a model file, then runs it once on zeros.
    ///
    /// # Errors
    /// When the file is unreadable, not an ONNX model, violates the [`ModelContract`], has
    /// unsupported operators or shapes, or predicts anything but a probability for zeros.
    pub fn load(path: &Path) -> Result<Self> {
        let started = Instant::now();
        let bytes = onnx::read(path)?;
        let mut model = Self::from_bytes(&bytes).map_err(|error| error.at(path.display()))?;
        model.load_ms = milliseconds_since(started);
        Ok(model)
    }

    /// As [`Model::load`], from the bytes of a file.
    ///
    /// # Errors
    /// As [`Model::load`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let started = Instant::now();
        let mut proto = onnx::decode(bytes)?;
        let contract = ModelContract::from_proto(&proto)?;
        let ood_detector = contract.other.get(ood::METADATA);
        let ood_detector = ood_detector
            .map(|text| OodDetector::from_metadata(text))
            .transpose()?;
        let grasp_head = contract.other.get(grasp_head::METADATA);
        let grasp_head = grasp_head
            .map(|text| GraspHead::from_metadata(text))
            .transpose()?
            .unwrap_or_default();
        check_readings(&grasp_head, &contract)?;
        let lift_head = contract.other.get(lift::METADATA);
        let lift_head = lift_head
            .map(|text| LiftHead::from_metadata(text))
            .transpose()?;
        let conformal_scores = contract.other.get(conformal::METADATA);
        let conformal_scores = conformal_scores
            .map(|text| ConformalScores::from_metadata(text))
            .transpose()?;
        proto
            .graph
            .iter_mut()
            .for_each(graph_check::bind_dimensions);
        let engine = match NativeEngine::new(&proto, contract.modality) {
            Some(native) => Engine::Native(Box::new(native)),
            None => Engine::tract(&proto, &contract)?,
        };
        let mut model = Self {
            contract,
            sha256: sha256_hex(bytes),
            load_ms: 0.0,
            ood_detector,
            grasp_head,
            lift_head,
            conformal_scores,
            engine,
        };
        let zeros = ModelInput::zeros(&model.contract)?;
        model.predict(&zeros).map_err(|error| {
            error.remedy("the file is damaged or was exported incorrectly: export it again")
        })?;
        model.load_ms = milliseconds_since(started);
        Ok(model)
    }

    /// As [`Model::from_bytes`], always on the tract engine.
    ///
    /// # Errors
    /// As [`Model::load`].
    pub fn with_tract(bytes: &[u8]) -> Result<Self> {
        let mut proto = onnx::decode(bytes)?;
        proto
            .graph
            .iter_mut()
            .for_each(graph_check::bind_dimensions);
        let mut model = Self::from_bytes(bytes)?;
        model.engine = Engine::tract(&proto, &model.contract)?;
        Ok(model)
    }

    /// The same model with the network's own predictions.
    pub(super) fn without_grasp_head(self) -> Self {
        Self {
            grasp_head: GraspHead::default(),
            ..self
        }
    }

    /// Prediction of the native engine for zeros; none if it does not support the graph.
    #[cfg(test)]
    pub(crate) fn native_prediction_for_zeros(
        proto: &ModelProto,
        contract: &ModelContract,
    ) -> Option<f32> {
        let zeros = ModelInput::zeros(contract).ok()?;
        let values = NativeEngine::new(proto, contract.modality)?.run(&zeros, contract.modality);
        values.map(|values| values.p_stable)
    }

    /// Whether the native engine runs it.
    pub fn is_native(&self) -> bool {
        matches!(self.engine, Engine::Native(_))
    }

    /// Contract of the model.
    #[must_use]
    pub fn contract(&self) -> &ModelContract {
        &self.contract
    }

    /// sha256 of the file, lower-case hex.
    #[must_use]
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Time from the file to the first prediction, ms.
    #[must_use]
    pub fn load_ms(&self) -> f64 {
        self.load_ms
    }

    /// OOD detector of the model, if any.
    #[must_use]
    pub fn ood_detector(&self) -> Option<&OodDetector> {
        self.ood_detector.as_ref()
    }

    /// Verdict in the lift, if the model has it.
    #[must_use]
    pub fn lift_head(&self) -> Option<&LiftHead> {
        self.lift_head.as_ref()
    }

    /// Scores for prediction sets, if any.
    #[must_use]
    pub fn conformal_scores(&self) -> Option<&ConformalScores> {
        self.conformal_scores.as_ref()
    }

    /// Limits of the prediction sets at an error rate in (0, 1).
    ///
    /// # Errors
    /// `Input` where the model has no scores.
    pub fn conformal_limits(&self, error_rate: f64) -> Result<ConformalLimits> {
        let scores = self.conformal_scores.as_ref().ok_or_else(|| {
            Error::input(format!(
                "the model `{}` has no conformal scores, so it has no sets at an error rate",
                self.contract.name
            ))
            .remedy(
                "compute them on labelled grasps that it was not trained on: gripcast predict \
                 conformal MODEL --data D --split validation --out FILE",
            )
        })?;
        Ok(scores.limits(error_rate))
    }

    /// Predicts one grasp from the available inputs.
    ///
    /// # Errors
    /// `Usage`: no prediction can be made from the available inputs. `Input`: the output is not a
    /// probability. When the engine fails.
    pub fn predict(&self, input: &ModelInput) -> Result<Prediction> {
        let started = Instant::now();
        let output = self.contract.output_from(|name| input.is_available(name));
        let output = output.ok_or_else(|| self.missing_input(input))?;
        let values = match &self.engine {
            Engine::Native(native) => native
                .run(input, output.modality)
                .ok_or_else(|| self.missing_input(input))?,
            Engine::Tract {
                order,
                outputs,
                model,
            } => {
                let name = output_of(output.modality, self.contract.modality);
                let used = |inputs: &[InputName]| -> Vec<InputName> {
                    let inputs = inputs.iter().copied();
                    inputs.filter(|name| output.modality.has(*name)).collect()
                };
                let (cameras, gels) = (used(&self.contract.geometry), used(&self.contract.contact));
                let names = [name].into_iter();
                let names = names.chain(cameras.iter().map(|input| geometry_output(*input)));
                let names = names.chain(gels.iter().map(|input| contact_output(*input)));
                let place = |name: String| outputs.iter().position(|output| *output == name);
                let places: Vec<Option<usize>> = names.map(place).collect();
                let mut found = run_tract(order, model, input, &places)?.into_iter();
                let p_stable = match found.next().as_deref() {
                    Some([p_stable]) => *p_stable,
                    _ => f32::NAN,
                };
                let geometry = cameras.into_iter().zip(found.by_ref());
                let geometry =
                    geometry.map(|(input, values)| Some((input, values.try_into().ok()?)));
                Values {
                    p_stable,
                    geometry: geometry.flatten().collect(),
                    contact: found.collect(),
                }
            }
        };
        let p_stable = values.p_stable;
        if !(0.0..=1.0).contains(&p_stable) {
            return Err(Error::input(format!(
                "invalid output {p_stable} of the model `{}`: expected `{}` between 0 and 1",
                self.contract.name,
                contract::OUTPUT
            )));
        }
        let p_stable = match self.grasp_head.of(output.modality) {
            Some(estimator) => estimator.probability(f64::from(p_stable), &values.features())?,
            None => f64::from(p_stable),
        };
        let metres = |values: [f32; GEOMETRY]| values.map(|x| f64::from(x) * GEOMETRY_UNIT_M);
        Ok(Prediction {
            p_stable,
            modality: output.modality,
            threshold: output.threshold,
            // The depth image, which comes last, shows it best.
            geometry: values
                .geometry
                .last()
                .map(|(_, values)| GraspGeometry::from_array(metres(*values))),
            engine_ms: milliseconds_since(started),
        })
    }

    fn missing_input(&self, input: &ModelInput) -> Error {
        let outputs = self.contract.outputs().map(|output| output.modality);
        let least = outputs.min_by_key(|modality| modality.inputs().len());
        let least = least.unwrap_or(self.contract.modality).inputs();
        let missing: Vec<&str> = least
            .into_iter()
            .filter(|name| !input.is_available(*name))
            .map(InputName::name)
            .collect();
        Error::usage(format!(
            "the model `{}` cannot predict: missing input {}",
            self.contract.name,
            missing.join(", ")
        ))
        .remedy("give the images of all its inputs, or use a model of the given ones")
    }
}

/// Refuses a grasp head whose readings are not outputs of the graph.
fn check_readings(head: &GraspHead, contract: &ModelContract) -> Result<()> {
    let is_read = |input: InputName| match input.role().is_tactile() {
        true => contract.contact.contains(&input),
        false => contract.geometry.contains(&input),
    };
    let estimators = head.estimators.iter();
    let inputs = estimators.flat_map(|estimator| estimator.modality.inputs());
    match inputs.into_iter().find(|input| !is_read(*input)) {
        None => Ok(()),
        Some(input) => Err(Error::input(format!(
            "`{}` of the model reads `{input}`, for which the graph has no output",
            grasp_head::METADATA
        ))
        .remedy("train or export the model again")),
    }
}

fn run_tract(
    order: &[InputName],
    model: &Arc<TypedRunnableModel>,
    input: &ModelInput,
    places: &[Option<usize>],
) -> Result<Vec<Vec<f32>>> {
    // The wanted outputs do not depend on inputs that are not available.
    let tensors = order.iter().filter_map(|name| input.tensor(*name));
    let tensors: TVec<TValue> = tensors.map(InputTensor::to_tvalue).collect();
    let mut nan = None;
    let run = guarded("run the model", || {
        let output = TypedSimpleState::new(model)?.run_plan_with_eval(
            tensors,
            |context, state, node, inputs| {
                let outputs = eval(context, state, node, inputs)?;
                if nan.is_none() && outputs.iter().any(|value| has_nan(value)) {
                    nan = Some(node.name.clone());
                }
                TractResult::Ok(outputs)
            },
        )?;
        let values = |at: Option<usize>| -> TractResult<Vec<f32>> {
            let value = at.and_then(|at| output.get(at));
            let view = value.map(|value| value.try_as_plain_ram()).transpose()?;
            let values = view
                .as_ref()
                .map(|view| view.as_slice::<f32>())
                .transpose()?;
            Ok(values.unwrap_or_default().to_vec())
        };
        places.iter().map(|place| values(*place)).collect()
    })?;
    match nan {
        None => Ok(run),
        Some(node) => Err(
            Error::input(format!("the operator `{node}` of the model answers NaN"))
                .remedy("export a checkpoint that answers finite numbers for every image"),
        ),
    }
}

/// Whether a tensor of 32-bit floats has a NaN, which a later ReLU would turn into 0.
fn has_nan(value: &Tensor) -> bool {
    let view = value.try_as_plain_ram();
    let values = view
        .as_ref()
        .ok()
        .and_then(|view| view.as_slice::<f32>().ok());
    // Without an early exit, so that the loop is vectorised.
    values.is_some_and(|values| values.iter().fold(false, |nan, x| nan | x.is_nan()))
}

fn optimise(proto: &ModelProto) -> TractResult<Arc<TypedRunnableModel>> {
    // Shapes stored in the file may name open dimensions, which are bound by now.
    let reader = tract_onnx::onnx().with_ignore_value_info(true);
    let model = reader.model_for_proto_model(proto)?;
    let model = model.into_typed()?.into_decluttered()?;
    for node in model.nodes() {
        // A constant of the graph is finite, but one that is computed from constants may not be.
        let constant = node.op_as::<Const>().map(Const::val);
        if let Some(constant) = constant
            && has_nan(constant)
        {
            bail!("the constant `{}` is NaN", node.name);
        }
    }
    model.into_optimized()?.into_runnable()
}

fn input_order(proto: &ModelProto, contract: &ModelContract) -> Vec<InputName> {
    let inputs = proto.graph.iter().flat_map(graph_check::graph_inputs);
    inputs
        .filter_map(|input| {
            let mut names = contract.modality.inputs().into_iter();
            names.find(|name| name.name() == input.name)
        })
        .collect()
}

/// Runs the engine; its errors and panics become errors of the model.
fn guarded<T>(step: &str, work: impl FnOnce() -> TractResult<T>) -> Result<T> {
    let outcome = catch_panic(AssertUnwindSafe(work));
    outcome
        .and_then(|result| result.map_err(|cause| format!("{cause:#}")))
        .map_err(|cause| {
            let first_line = cause.lines().next().unwrap_or_default();
            Error::input(format!("the engine cannot {step}: {first_line}")).remedy(format!(
                "export the model again with {PYTORCH_EXPORT} (standard operators, fixed shapes)"
            ))
        })
}

fn milliseconds_since(started: Instant) -> f64 {
    started.elapsed().as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::predict::baseline;
    use crate::predict::contract::{INPUT_SHAPE, OUTPUT, OUTPUT_SHAPE};
    use crate::predict::onnx::{Attribute, OnnxGraphBuilder, Value};
    use gripcast_base::error::ErrorKind;

    /// A touch model with the constant output `value`.
    fn constant_model(value: f32) -> Vec<u8> {
        let mut graph = OnnxGraphBuilder::new("constant");
        let contract = baseline::contract();
        contract.write(&mut graph).unwrap();
        for input in &contract.inputs {
            graph.input(input.name.name(), &INPUT_SHAPE).unwrap();
        }
        let value = graph.constant("value", &[1, 1], &[value]).unwrap();
        let answer = graph.node("Identity", OUTPUT, &[&value], []).unwrap();
        graph.output(&answer, &OUTPUT_SHAPE);
        graph.to_bytes().unwrap()
    }

    #[test]
    fn output_that_is_not_a_probability_is_refused() {
        assert!(Model::from_bytes(&constant_model(0.25)).is_ok());
        for answer in [-0.01, 1.5] {
            let error = Model::from_bytes(&constant_model(answer)).unwrap_err();
            assert!(
                error.what().contains(&format!("invalid output {answer}")),
                "{error}"
            );
        }
    }

    /// A touch model that answers `sigmoid(relu(f(mean)))`.
    fn model_with(f: impl FnOnce(&mut OnnxGraphBuilder, Value) -> Value) -> Vec<u8> {
        let mut graph = OnnxGraphBuilder::new("relu");
        let contract = baseline::contract();
        contract.write(&mut graph).unwrap();
        let left = graph.input("tactile_left", &INPUT_SHAPE).unwrap();
        graph.input("tactile_right", &INPUT_SHAPE).unwrap();
        let flat = [Attribute::int("axis", 1)];
        let flat = graph.node("Flatten", "flat", &[&left], flat).unwrap();
        let over = [Attribute::ints("axes", &[1]), Attribute::int("keepdims", 1)];
        let mean = graph.node("ReduceMean", "mean", &[&flat], over).unwrap();
        let x = f(&mut graph, mean);
        let x = graph.node("Relu", "relu", &[&x], []).unwrap();
        let answer = graph.node("Sigmoid", OUTPUT, &[&x], []).unwrap();
        graph.output(&answer, &OUTPUT_SHAPE);
        graph.to_bytes().unwrap()
    }

    #[test]
    fn nan_that_a_relu_would_hide_is_refused() {
        let fine = model_with(|graph, mean| graph.node("Sqrt", "root", &[&mean], []).unwrap());
        let fine = Model::from_bytes(&fine).unwrap();
        // The root of a negative mean is NaN.
        let mut input = ModelInput::zeros(fine.contract()).unwrap();
        let [dark, light] =
            [10, 60].map(|x| image::RgbImage::from_pixel(320, 240, image::Rgb([x; 3])));
        let darker = gripcast_imaging::TactileDifference::between(&light, &dark).unwrap();
        input.set_tactile(InputName::TactileLeft, &darker).unwrap();
        let error = fine.predict(&input).unwrap_err();
        assert!(error.what().contains("answers NaN"), "{error}");
        // Constants are finite, what is computed from them is not.
        let folded = model_with(|graph, mean| {
            let minus = graph.constant("minus", &[1, 1], &[-1.0]).unwrap();
            let root = graph.node("Sqrt", "root", &[&minus], []).unwrap();
            graph.node("Add", "sum", &[&mean, &root], []).unwrap()
        });
        let error = Model::from_bytes(&folded).unwrap_err();
        assert!(error.to_string().contains("NaN"), "{error}");
    }

    #[test]
    fn operator_sets_7_to_22_give_the_same_answer() {
        let bytes = baseline::onnx_bytes().unwrap();
        let mut answers = Vec::new();
        for version in 7..=22 {
            let mut proto = onnx::decode(&bytes).unwrap();
            proto.opset_import[0].version = version;
            let model = Model::with_tract(&prost::Message::encode_to_vec(&proto)).unwrap();
            let zeros = ModelInput::zeros(model.contract()).unwrap();
            answers.push(model.predict(&zeros).unwrap().p_stable);
        }
        answers.dedup();
        assert_eq!(answers.len(), 1, "{answers:?}");
    }

    #[test]
    fn inputs_are_matched_by_name_in_any_order() {
        let mut proto = onnx::decode(&constant_model(0.5)).unwrap();
        let graph = proto.graph.as_mut().unwrap();
        graph.input.reverse();
        let contract = ModelContract::from_proto(&proto).unwrap();
        assert_eq!(
            input_order(&proto, &contract),
            [InputName::TactileRight, InputName::TactileLeft]
        );
    }

    #[test]
    fn unknown_operator_is_refused_with_remedy() {
        let mut graph = OnnxGraphBuilder::new("odd");
        let contract = baseline::contract();
        contract.write(&mut graph).unwrap();
        let left = graph.input("tactile_left", &INPUT_SHAPE).unwrap();
        graph.input("tactile_right", &INPUT_SHAPE).unwrap();
        let answer = graph.node("Frobnicate", OUTPUT, &[&left], []).unwrap();
        graph.output(&answer, &OUTPUT_SHAPE);
        let error = Model::from_bytes(&graph.to_bytes().unwrap()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(
            error
                .to_string()
                .contains("unsupported operator `Frobnicate`"),
            "{error}"
        );
        assert!(error.to_string().contains("standard operators"), "{error}");
    }

    #[test]
    fn model_is_send_and_sync() {
        fn assert_shared<T: Send + Sync>() {}
        assert_shared::<Model>();
    }

    #[test]
    fn digest_is_sha256_of_the_file() {
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256_hex(b"abc"), expected);
    }
}
