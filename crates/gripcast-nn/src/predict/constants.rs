//! Checks the constants of a model file: weights, values of nodes, and those of inner graphs.

use tract_onnx::pb::tensor_proto::{DataLocation, DataType};
use tract_onnx::pb::{AttributeProto, GraphProto, ModelProto, NodeProto, TensorProto};

use super::graph_check::refusal;
use super::onnx::PYTORCH_EXPORT;
use gripcast_base::error::Result;

/// Refuses constants that are outside of the file, of an unsupported type, NaN or infinite. A ReLU
/// turns NaN into 0, so that the output would look like a probability.
///
/// # Errors
/// `Input`, with the constant.
pub(super) fn check_constants(model: &ModelProto) -> Result<()> {
    let functions = model.functions.iter().flat_map(|function| &function.node);
    functions.into_iter().try_for_each(check_node)?;
    model.graph.iter().try_for_each(check_graph)
}

fn check_graph(graph: &GraphProto) -> Result<()> {
    let sparse = graph.sparse_initializer.iter();
    let sparse = sparse.filter_map(|tensor| tensor.values.as_ref());
    let mut all = graph.initializer.iter().chain(sparse);
    all.try_for_each(|tensor| check_tensor(tensor, &format!("the weights `{}`", tensor.name)))?;
    graph.node.iter().try_for_each(check_node)
}

fn check_node(node: &NodeProto) -> Result<()> {
    let name = node.output.first().filter(|_| node.name.is_empty());
    let name = name.unwrap_or(&node.name);
    node.attribute.iter().try_for_each(|attribute| {
        let place = format!("`{}` of `{name}` ({})", attribute.name, node.op_type);
        check_attribute(attribute, &place)
    })
}

fn check_attribute(attribute: &AttributeProto, place: &str) -> Result<()> {
    let sparse = attribute
        .sparse_tensor
        .iter()
        .chain(&attribute.sparse_tensors);
    let sparse = sparse.filter_map(|tensor| tensor.values.as_ref());
    let mut tensors = attribute.t.iter().chain(&attribute.tensors).chain(sparse);
    tensors.try_for_each(|tensor| check_tensor(tensor, place))?;
    let mut graphs = attribute.g.iter().chain(&attribute.graphs);
    graphs.try_for_each(check_graph)?;
    check_finite([f64::from(attribute.f)].into_iter(), place)?;
    check_finite(attribute.floats.iter().map(|x| f64::from(*x)), place)
}

fn check_tensor(tensor: &TensorProto, place: &str) -> Result<()> {
    if tensor.data_location == Some(DataLocation::External as i32) {
        return Err(refusal(format!(
            "{place} are in an external file, which is not supported"
        ))
        .remedy(format!(
            "export all weights into one file: {PYTORCH_EXPORT}, or \
             `onnx.save(onnx.load(\"model.onnx\"), \"one-file.onnx\")`"
        )));
    }
    let raw = &tensor.raw_data;
    match DataType::try_from(tensor.data_type) {
        Ok(DataType::Float) => {
            let raw = raw.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b));
            let values = raw.chain(tensor.float_data.iter().copied());
            check_finite(values.map(f64::from), place)
        }
        Ok(DataType::Double) => {
            let raw = raw.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b));
            check_finite(raw.chain(tensor.double_data.iter().copied()), place)
        }
        Ok(
            DataType::Bool
            | DataType::String
            | DataType::Int8
            | DataType::Int16
            | DataType::Int32
            | DataType::Int64
            | DataType::Uint8
            | DataType::Uint16
            | DataType::Uint32
            | DataType::Uint64,
        ) => Ok(()),
        other => {
            let found = other.map_or_else(|_| tensor.data_type.to_string(), |t| format!("{t:?}"));
            Err(refusal(format!(
                "unsupported type of {place}: expected 32-bit or 64-bit floats, integers or bool, \
                 found {found}"
            ))
            .remedy("export the network with 32-bit weights: call `model.float()` first"))
        }
    }
}

fn check_finite(values: impl Iterator<Item = f64>, place: &str) -> Result<()> {
    let mut invalid = values.enumerate().filter(|(_, x)| !x.is_finite());
    let Some((at, value)) = invalid.next() else {
        return Ok(());
    };
    let more = match invalid.count() {
        0 => String::new(),
        more => format!(", and {more} more"),
    };
    Err(refusal(format!(
        "expected finite numbers, found {value} in {place}, at index {at}{more}"
    ))
    .remedy(
        "the training diverged or the file is damaged: export a checkpoint with finite weights",
    ))
}
