//! Running a model file.

use std::panic::AssertUnwindSafe;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use tract_onnx::pb::ModelProto;
use tract_onnx::prelude::{
    Framework as _, InferenceModelExt as _, IntoRunnable as _, TVec, TractResult,
    TypedRunnableModel, TypedSimpleState,
};

use super::contract::{self, InputName, ModelContract};
use super::graph_check;
use super::input::ModelInput;
use super::novelty::{self, Novelty};
use super::onnx;
use super::own_engine::OwnEngine;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::sha256_hex;
use gripcast_base::catch_panic::catch_panic;

/// A model that has been checked and is ready to run, on the thread that asks.
#[derive(Debug)]
pub struct Model {
    contract: ModelContract,
    sha256: String,
    load_ms: f64,
    novelty: Option<Novelty>,
    engine: Engine,
}

#[derive(Debug)]
enum Engine {
    /// Ours, for the networks that gripcast trains.
    Own(Box<OwnEngine>),
    /// The general one.
    Tract {
        /// Inputs in the order of the graph.
        order: Vec<InputName>,
        model: Arc<TypedRunnableModel>,
    },
}

/// What a model says about one grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// Probability that the grasp is stable.
    pub p_stable: f64,
    /// Time of the model alone, ms.
    pub engine_ms: f64,
}

impl Model {
    /// Reads, checks and optimises a model file, then runs it once on zeros.
    ///
    /// # Errors
    /// When the file cannot be read, is no ONNX model, breaks the [`ModelContract`], has operators
    /// or shapes that the engine refuses, or answers zeros with anything but a probability.
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
        let contract = ModelContract::of(&proto)?;
        let novelty = contract.other.get(novelty::METADATA);
        let novelty = novelty.map(|text| Novelty::of_metadata(text)).transpose()?;
        proto.graph.iter_mut().for_each(graph_check::close_batch);
        let engine = match OwnEngine::of(&proto, contract.variant) {
            Some(own) => Engine::Own(Box::new(own)),
            None => Engine::Tract {
                order: input_order(&proto, &contract),
                model: guarded("build the model's graph", || optimise(&proto))?,
            },
        };
        let mut model = Self {
            contract,
            sha256: sha256_hex(bytes),
            load_ms: 0.0,
            novelty,
            engine,
        };
        let zeros = ModelInput::zeros(&model.contract)?;
        model.predict(&zeros).map_err(|error| {
            error.remedy("the file is damaged or was exported wrongly; export it again")
        })?;
        model.load_ms = milliseconds_since(started);
        Ok(model)
    }

    /// As [`Model::from_bytes`], on the general engine even where ours would do.
    ///
    /// # Errors
    /// As [`Model::load`].
    pub fn on_tract(bytes: &[u8]) -> Result<Self> {
        let mut proto = onnx::decode(bytes)?;
        proto.graph.iter_mut().for_each(graph_check::close_batch);
        let mut model = Self::from_bytes(bytes)?;
        model.engine = Engine::Tract {
            order: input_order(&proto, &model.contract),
            model: guarded("build the model's graph", || optimise(&proto))?,
        };
        Ok(model)
    }

    /// What our own engine answers zeros for a graph; none if it leaves the graph to the general one.
    #[cfg(test)]
    pub(crate) fn own_answer_to_zeros(proto: &ModelProto, contract: &ModelContract) -> Option<f32> {
        let zeros = ModelInput::zeros(contract).ok()?;
        OwnEngine::of(proto, contract.variant)?.run(&zeros)
    }

    /// Whether our own engine runs it.
    pub fn is_on_own_engine(&self) -> bool {
        matches!(self.engine, Engine::Own(_))
    }

    /// What the model promises.
    #[must_use]
    pub fn contract(&self) -> &ModelContract {
        &self.contract
    }

    /// sha256 of the file, lower-case hex; `sha256sum` prints the same.
    #[must_use]
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Time from the file to the first answer, ms.
    #[must_use]
    pub fn load_ms(&self) -> f64 {
        self.load_ms
    }

    /// What its training images looked like, if it says so.
    #[must_use]
    pub fn novelty(&self) -> Option<&Novelty> {
        self.novelty.as_ref()
    }

    /// Predicts one grasp.
    ///
    /// # Errors
    /// When the input was made for a model of another variant, the engine fails, or the answer is
    /// no probability.
    pub fn predict(&self, input: &ModelInput) -> Result<Prediction> {
        let started = Instant::now();
        let p_stable = match &self.engine {
            Engine::Own(own) => own.run(input).ok_or_else(missing_input)?,
            Engine::Tract { order, model } => run_tract(order, model, input)?,
        };
        if !(0.0..=1.0).contains(&p_stable) {
            return Err(Error::input(format!(
                "the model `{}` answers {p_stable}; `{}` must be between 0 and 1",
                self.contract.name,
                contract::OUTPUT
            )));
        }
        Ok(Prediction {
            p_stable: f64::from(p_stable),
            engine_ms: milliseconds_since(started),
        })
    }
}

fn missing_input() -> Error {
    let what = "the model needs an input that was not given";
    Error::internal(what)
}

fn run_tract(
    order: &[InputName],
    model: &Arc<TypedRunnableModel>,
    input: &ModelInput,
) -> Result<f32> {
    let mut tensors = TVec::new();
    for &name in order {
        let tensor = input.tensor(name).ok_or_else(missing_input)?;
        tensors.push(tensor.fraction());
    }
    guarded("run the model", || {
        let output = TypedSimpleState::new(model)?.run(tensors)?;
        let values = output
            .first()
            .map(|value| value.try_as_plain_ram())
            .transpose()?;
        Ok(match values.as_ref().map(|view| view.as_slice::<f32>()) {
            Some(Ok([p_stable])) => *p_stable,
            Some(Err(cause)) => return Err(cause),
            _ => f32::NAN,
        })
    })
}

fn optimise(proto: &ModelProto) -> TractResult<Arc<TypedRunnableModel>> {
    tract_onnx::onnx()
        .model_for_proto_model(proto)?
        .into_optimized()?
        .into_runnable()
}

fn input_order(proto: &ModelProto, contract: &ModelContract) -> Vec<InputName> {
    let inputs = proto.graph.iter().flat_map(graph_check::graph_inputs);
    inputs
        .filter_map(|input| {
            let names = contract.variant.inputs().iter();
            names.copied().find(|name| name.name() == input.name)
        })
        .collect()
}

/// Runs the engine; what it refuses and what it panics on become errors of the model.
fn guarded<T>(step: &str, work: impl FnOnce() -> TractResult<T>) -> Result<T> {
    let outcome = catch_panic(AssertUnwindSafe(work));
    outcome
        .and_then(|result| result.map_err(|cause| format!("{cause:#}")))
        .map_err(|cause| {
            let first_line = cause.lines().next().unwrap_or_default();
            Error::input(format!("the engine cannot {step}: {first_line}")).remedy(
                "export the model again with standard operators and fixed shapes (opset 17), and \
                 compare its sha256 with its card",
            )
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
    use crate::predict::onnx::OnnxGraphBuilder;
    use gripcast_base::error::ErrorKind;

    /// A touch model that answers `value` whatever it is shown.
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
    fn an_answer_that_is_no_probability_is_refused_at_loading() {
        assert!(Model::from_bytes(&constant_model(0.25)).is_ok());
        for answer in [f32::NAN, f32::INFINITY, -0.01, 1.5] {
            let error = Model::from_bytes(&constant_model(answer)).unwrap_err();
            assert!(
                error.what().contains(&format!("answers {answer}")),
                "{error}"
            );
        }
    }

    #[test]
    fn inputs_reach_the_tensor_of_their_name_in_any_order() {
        let mut proto = onnx::decode(&constant_model(0.5)).unwrap();
        let graph = proto.graph.as_mut().unwrap();
        graph.input.reverse();
        let contract = ModelContract::of(&proto).unwrap();
        assert_eq!(
            input_order(&proto, &contract),
            [InputName::TactileRight, InputName::TactileLeft]
        );
    }

    #[test]
    fn an_unknown_operator_is_an_explained_refusal() {
        let mut graph = OnnxGraphBuilder::new("odd");
        let contract = baseline::contract();
        contract.write(&mut graph).unwrap();
        let left = graph.input("tactile_left", &INPUT_SHAPE).unwrap();
        graph.input("tactile_right", &INPUT_SHAPE).unwrap();
        let answer = graph.node("Frobnicate", OUTPUT, &[&left], []).unwrap();
        graph.output(&answer, &OUTPUT_SHAPE);
        let error = Model::from_bytes(&graph.to_bytes().unwrap()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.to_string().contains("the engine cannot"), "{error}");
        assert!(error.to_string().contains("standard operators"), "{error}");
    }

    #[test]
    fn a_model_can_be_shared_between_threads() {
        fn assert_shared<T: Send + Sync>() {}
        assert_shared::<Model>();
    }

    #[test]
    fn the_digest_is_that_of_the_file() {
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256_hex(b"abc"), expected);
    }
}
