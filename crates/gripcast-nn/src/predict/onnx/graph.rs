//! Builds ONNX graphs.

use std::collections::{BTreeMap, BTreeSet};

use prost::Message as _;
use tract_onnx::pb::{
    GraphProto, ModelProto, NodeProto, OperatorSetIdProto, StringStringEntryProto, TensorProto,
    TensorShapeProto, TypeProto, ValueInfoProto, tensor_proto::DataType,
    tensor_shape_proto::Dimension, tensor_shape_proto::dimension, type_proto,
};

use super::{Attribute, IR_VERSION, OPSET};
use gripcast_base::error::{Error, Result};

/// Open batch dimension of an input's or output's shape.
pub const OPEN_BATCH: i64 = -1;
/// Name of the open batch dimension.
const BATCH_NAME: &str = "batch";

/// A tensor of the graph: an input, a constant or the result of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Value(String);

impl Value {
    /// Refers to a tensor by name; it must exist when the graph is written.
    pub(crate) fn named(name: &str) -> Self {
        Self(name.to_owned())
    }

    /// Name in the file.
    pub fn name(&self) -> &str {
        &self.0
    }
}

/// Builds an ONNX file of f32 tensors, node by node in the order of evaluation.
///
/// Equal calls give equal bytes.
///
/// ```
/// use gripcast_nn::predict::onnx::{Attribute, OnnxGraphBuilder};
///
/// let mut graph = OnnxGraphBuilder::new("double");
/// let x = graph.input("x", &[1, 4])?;
/// let two = graph.constant("two", &[1], &[2.0])?;
/// let y = graph.node("Mul", "y", &[&x, &two], [])?;
/// graph.output(&y, &[1, 4]);
/// assert!(!graph.to_bytes()?.is_empty());
/// # Ok::<(), gripcast_base::error::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct OnnxGraphBuilder {
    graph: GraphProto,
    names: BTreeSet<String>,
    metadata: BTreeMap<String, String>,
    description: String,
}

impl OnnxGraphBuilder {
    /// An empty graph.
    pub fn new(name: &str) -> Self {
        Self {
            graph: GraphProto {
                name: name.to_owned(),
                ..GraphProto::default()
            },
            names: BTreeSet::new(),
            metadata: BTreeMap::new(),
            description: String::new(),
        }
    }

    /// Declares an f32 input of the graph.
    ///
    /// # Errors
    /// When the name is taken.
    pub fn input(&mut self, name: &str, shape: &[i64]) -> Result<Value> {
        self.claim(name)?;
        self.graph.input.push(value_info(name, shape));
        Ok(Value::named(name))
    }

    /// Declares `value` as an f32 output of the graph.
    pub fn output(&mut self, value: &Value, shape: &[i64]) {
        self.graph.output.push(value_info(value.name(), shape));
    }

    /// Stores an f32 tensor, row-major.
    ///
    /// # Errors
    /// When the length of `data` does not match `shape`, or the name is taken.
    pub fn constant(&mut self, name: &str, shape: &[i64], data: &[f32]) -> Result<Value> {
        let elements = data.len();
        let expected = shape
            .iter()
            .try_fold(1_usize, |n, &d| n.checked_mul(usize::try_from(d).ok()?));
        if expected != Some(elements) {
            return Err(self.defect(&format!(
                "has {elements} elements for the constant `{name}` of shape {shape:?}"
            )));
        }
        self.claim(name)?;
        self.graph.initializer.push(TensorProto {
            name: name.to_owned(),
            dims: shape.to_vec(),
            data_type: DataType::Float as i32,
            raw_data: data.iter().flat_map(|x| x.to_le_bytes()).collect(),
            ..TensorProto::default()
        });
        Ok(Value::named(name))
    }

    /// Appends an operator with one output, named like the node.
    ///
    /// # Errors
    /// When the name is taken.
    pub fn node(
        &mut self,
        op_type: &str,
        name: &str,
        inputs: &[&Value],
        attributes: impl IntoIterator<Item = Attribute>,
    ) -> Result<Value> {
        self.claim(name)?;
        self.graph.node.push(NodeProto {
            op_type: op_type.to_owned(),
            name: name.to_owned(),
            input: inputs.iter().map(|value| value.0.clone()).collect(),
            output: vec![name.to_owned()],
            attribute: attributes.into_iter().map(Attribute::into_proto).collect(),
            ..NodeProto::default()
        });
        Ok(Value::named(name))
    }

    /// All operators so far.
    pub(crate) fn nodes(&self) -> &[NodeProto] {
        &self.graph.node
    }

    /// Sets one pair of the file's `metadata_props`.
    pub fn metadata(&mut self, key: &str, value: impl Into<String>) {
        self.metadata.insert(key.to_owned(), value.into());
    }

    /// Sets the file's description.
    pub fn description(&mut self, text: &str) {
        text.clone_into(&mut self.description);
    }

    /// Returns the ONNX message.
    ///
    /// # Errors
    /// When there is no output, or an output or input of a node is undefined.
    pub fn into_proto(self) -> Result<ModelProto> {
        if self.graph.output.is_empty() {
            return Err(self.defect("has no output"));
        }
        if let Some(undefined) = self
            .graph
            .output
            .iter()
            .map(|output| &output.name)
            .chain(self.graph.node.iter().flat_map(|node| &node.input))
            .find(|name| !self.names.contains(*name))
        {
            return Err(self.defect(&format!("uses the undefined value `{undefined}`")));
        }
        let metadata_props = self
            .metadata
            .into_iter()
            .map(|(key, value)| StringStringEntryProto { key, value })
            .collect();
        Ok(ModelProto {
            ir_version: IR_VERSION,
            opset_import: vec![OperatorSetIdProto {
                domain: String::new(),
                version: OPSET,
            }],
            producer_name: "gripcast".to_owned(),
            doc_string: self.description,
            graph: Some(self.graph),
            metadata_props,
            ..ModelProto::default()
        })
    }

    /// Encodes the file.
    ///
    /// # Errors
    /// As [`OnnxGraphBuilder::into_proto`].
    pub fn to_bytes(self) -> Result<Vec<u8>> {
        Ok(self.into_proto()?.encode_to_vec())
    }

    fn claim(&mut self, name: &str) -> Result<()> {
        if self.names.insert(name.to_owned()) {
            Ok(())
        } else {
            Err(self.defect(&format!("has two values named `{name}`")))
        }
    }

    fn defect(&self, what: &str) -> Error {
        let name = &self.graph.name;
        Error::internal(format!("the ONNX graph `{name}` {what}"))
    }
}

fn value_info(name: &str, shape: &[i64]) -> ValueInfoProto {
    let dim = shape
        .iter()
        .map(|&size| Dimension {
            value: Some(match size {
                OPEN_BATCH => dimension::Value::DimParam(BATCH_NAME.to_owned()),
                size => dimension::Value::DimValue(size),
            }),
            ..Dimension::default()
        })
        .collect();
    ValueInfoProto {
        name: name.to_owned(),
        r#type: Some(TypeProto {
            value: Some(type_proto::Value::TensorType(type_proto::Tensor {
                elem_type: DataType::Float as i32,
                shape: Some(TensorShapeProto { dim }),
            })),
            ..TypeProto::default()
        }),
        ..ValueInfoProto::default()
    }
}

#[cfg(test)]
mod tests {
    use tract_onnx::prelude::*;

    use super::*;

    /// A small network with the operators of a trained one.
    fn small_network() -> OnnxGraphBuilder {
        let mut graph = OnnxGraphBuilder::new("small");
        let x = graph.input("x", &[1, 1, 4, 4]).unwrap();
        let w = graph.constant("w", &[2, 1, 1, 1], &[1.0, -1.0]).unwrap();
        let b = graph.constant("b", &[2], &[0.5, 0.0]).unwrap();
        let shape = [Attribute::ints("kernel_shape", &[1, 1])];
        let y = graph.node("Conv", "conv", &[&x, &w, &b], shape).unwrap();
        let y = graph.node("Relu", "relu", &[&y], []).unwrap();
        let pool = [Attribute::ints("kernel_shape", &[4, 4])];
        let y = graph.node("AveragePool", "pool", &[&y], pool).unwrap();
        let axis = Attribute::int("axis", 1);
        let y = graph
            .node("Flatten", "flat", &[&y], [axis.clone()])
            .unwrap();
        let y = graph.node("Concat", "both", &[&y, &y], [axis]).unwrap();
        let fc = graph
            .constant("fc", &[1, 4], &[2.0, 2.0, -2.0, 2.0])
            .unwrap();
        let zero = graph.constant("zero", &[1], &[0.0]).unwrap();
        let gemm = [Attribute::int("transB", 1)];
        let y = graph
            .node("Gemm", "logit", &[&y, &fc, &zero], gemm)
            .unwrap();
        let y = graph.node("Sigmoid", "p", &[&y], []).unwrap();
        graph.output(&y, &[1, 1]);
        graph
    }

    #[test]
    fn tract_runs_a_written_graph() {
        let bytes = small_network().to_bytes().unwrap();
        let plan = tract_onnx::onnx()
            .model_for_read(&mut bytes.as_slice())
            .unwrap()
            .into_optimized()
            .unwrap()
            .into_runnable()
            .unwrap();
        let run = |value: f32| {
            let x = Tensor::from_shape(&[1, 1, 4, 4], &[value; 16]).unwrap();
            let y = plan.run(tvec!(x.into())).unwrap();
            y[0].cast_to_scalar::<f32>().unwrap()
        };
        // relu(x + 0.5) cancels, relu(−x) counts four times.
        for x in [1.0_f32, -0.75] {
            let expected = 1.0 / (1.0 + (-4.0 * (-x).max(0.0)).exp());
            assert!((run(x) - expected).abs() < 1e-6, "{x}");
        }
    }

    #[test]
    fn file_does_not_depend_on_metadata_order() {
        let with = |pairs: [(&str, &str); 2]| {
            let mut graph = small_network();
            for (key, value) in pairs {
                graph.metadata(key, value);
            }
            graph.to_bytes().unwrap()
        };
        let bytes = with([("b", "2"), ("a", "1")]);
        assert_eq!(bytes, with([("a", "1"), ("b", "2")]));
        let file = ModelProto::decode(&bytes[..]).unwrap();
        assert_eq!((file.ir_version, file.opset_import[0].version), (8, 17));
        let keys: Vec<_> = file.metadata_props.iter().map(|e| &*e.key).collect();
        assert_eq!(keys, ["a", "b"]);
        let graph = file.graph.unwrap();
        let nodes = graph.node.iter().map(|node| {
            let inputs: Vec<&str> = node.input.iter().map(String::as_str).collect();
            format!(
                "{} = {}({})",
                node.output[0],
                node.op_type,
                inputs.join(", ")
            )
        });
        let expected = [
            "conv = Conv(x, w, b)",
            "relu = Relu(conv)",
            "pool = AveragePool(relu)",
            "flat = Flatten(pool)",
            "both = Concat(flat, flat)",
            "logit = Gemm(both, fc, zero)",
            "p = Sigmoid(logit)",
        ];
        assert_eq!(nodes.collect::<Vec<_>>(), expected);
        let weight = &graph.initializer[0];
        assert_eq!((&*weight.name, &weight.dims[..]), ("w", &[2, 1, 1, 1][..]));
        let ones = [1.0_f32, -1.0].map(f32::to_le_bytes).concat();
        assert_eq!(weight.raw_data, ones);
    }

    #[test]
    fn invalid_calls_are_refused() {
        let mut graph = OnnxGraphBuilder::new("g");
        let wrong = graph.constant("w", &[2, 2], &[0.0; 3]).unwrap_err();
        assert!(
            wrong.what().contains("3 elements") && wrong.what().contains("[2, 2]"),
            "{wrong}"
        );
        assert!(graph.constant("w", &[-1], &[]).is_err());
        let x = graph.input("x", &[1]).unwrap();
        assert!(graph.clone().to_bytes().is_err(), "no output");
        assert!(graph.node("Relu", "x", &[&x], []).is_err(), "name taken");
        graph.output(&Value("elsewhere".into()), &[1]);
        let foreign = graph.to_bytes().unwrap_err();
        assert!(foreign.what().contains("`elsewhere`"), "{foreign}");
    }
}
