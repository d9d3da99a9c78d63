//! Checks the graph of a model file against its contract.

use std::collections::BTreeSet;
use std::fmt::Display;

use tract_onnx::pb::tensor_proto::{DataLocation, DataType};
use tract_onnx::pb::tensor_shape_proto::Dimension as TensorDimension;
use tract_onnx::pb::tensor_shape_proto::dimension::Value as Dimension;
use tract_onnx::pb::{GraphProto, ModelProto, ValueInfoProto, type_proto};

use super::tensors::{INPUT_SHAPE, Modality, OUTPUT, OUTPUT_SHAPE};
use gripcast_base::error::{Error, Result};

/// Supported operator sets.
const OPSETS: std::ops::RangeInclusive<i64> = 9..=18;
/// Maximum kernel, stride, dilation or padding, pixels.
const MAX_WINDOW: i64 = 4096;

/// Refuses a graph that violates its contract or that the engine cannot run.
///
/// # Errors
/// `Input`, with expected and found values.
pub(super) fn check_graph(modality: Modality, model: &ModelProto) -> Result<()> {
    check_operator_sets(model)?;
    let graph = model
        .graph
        .as_ref()
        .ok_or_else(|| refusal("the file has no graph"))?;
    check_constants(graph)?;
    check_windows(graph)?;
    let found = graph_inputs(graph);
    let names: BTreeSet<&str> = found.iter().map(|input| input.name.as_str()).collect();
    let expected: BTreeSet<&str> = modality.inputs().iter().map(|n| n.name()).collect();
    if names != expected || found.len() != expected.len() {
        return Err(refusal(format!(
            "inputs of the graph: expected {} for modality {modality}, found {}",
            list(expected),
            list(found.iter().map(|input| &input.name))
        )));
    }
    let batch = batch_name(found.first().copied());
    for input in found {
        check_tensor("input", input, &INPUT_SHAPE, batch)?;
    }
    match graph.output.as_slice() {
        [output] if output.name == OUTPUT => check_tensor("output", output, &OUTPUT_SHAPE, batch),
        outputs => Err(refusal(format!(
            "expected the single output `{OUTPUT}` in the graph, found {}",
            list(outputs.iter().map(|output| &output.name))
        ))),
    }
}

/// Inputs of a graph in order, without constants that are listed among them.
pub(super) fn graph_inputs(graph: &GraphProto) -> Vec<&ValueInfoProto> {
    let constants: BTreeSet<&str> = graph.initializer.iter().map(|t| t.name.as_str()).collect();
    graph
        .input
        .iter()
        .filter(|input| !constants.contains(input.name.as_str()))
        .collect()
}

fn check_operator_sets(model: &ModelProto) -> Result<()> {
    let is_default = |domain: &str| domain.is_empty() || domain == "ai.onnx";
    let mut version = None;
    for import in &model.opset_import {
        if is_default(&import.domain) {
            version = Some(import.version);
        } else {
            return Err(refusal(format!(
                "unsupported operator set `{}` {}: only the standard operators are supported",
                import.domain, import.version
            ))
            .remedy("export the model with standard ONNX operators, opset 17"));
        }
    }
    match version {
        Some(version) if OPSETS.contains(&version) => Ok(()),
        found => Err(refusal(format!(
            "operator set: expected {} to {}, found {}",
            OPSETS.start(),
            OPSETS.end(),
            found.map_or("none".to_owned(), |v| v.to_string())
        ))
        .remedy("export the model with opset 17")),
    }
}

fn check_constants(graph: &GraphProto) -> Result<()> {
    let external = Some(DataLocation::External as i32);
    match graph
        .initializer
        .iter()
        .find(|t| t.data_location == external)
    {
        None => Ok(()),
        Some(tensor) => Err(refusal(format!(
            "the weights `{}` are in an external file, which is not supported",
            tensor.name
        ))
        .remedy("export the model without external data")),
    }
}

/// Checks the windows of convolutions and pools: the engine computes shapes from them without a
/// check, so damaged ones could need any amount of memory.
fn check_windows(graph: &GraphProto) -> Result<()> {
    for node in &graph.node {
        for attribute in &node.attribute {
            let min = match attribute.name.as_str() {
                "kernel_shape" | "strides" | "dilations" => 1,
                "pads" => 0,
                _ => continue,
            };
            let allowed = min..=MAX_WINDOW;
            if let Some(found) = attribute.ints.iter().find(|x| !allowed.contains(x)) {
                return Err(refusal(format!(
                    "operator `{}` ({}): expected `{}` between {min} and {MAX_WINDOW}, \
                     found {found}",
                    node.name, node.op_type, attribute.name
                ))
                .remedy("the file is damaged: copy or export it again"));
            }
        }
    }
    Ok(())
}

fn shape_of(value: &ValueInfoProto) -> &[TensorDimension] {
    let tensor = match value.r#type.as_ref().and_then(|t| t.value.as_ref()) {
        Some(type_proto::Value::TensorType(tensor)) => tensor,
        _ => return &[],
    };
    tensor.shape.as_ref().map_or(&[], |shape| &shape.dim)
}

/// Name of the batch dimension of a tensor, if its size is open.
fn batch_name(value: Option<&ValueInfoProto>) -> Option<&str> {
    match &shape_of(value?).first()?.value {
        Some(Dimension::DimParam(symbol)) if !symbol.is_empty() => Some(symbol),
        _ => None,
    }
}

/// Sets an open batch size to 1, with which tract is much faster.
pub(super) fn close_batch(graph: &mut GraphProto) {
    for value in graph.input.iter_mut().chain(&mut graph.output) {
        if batch_name(Some(value)).is_none() {
            continue;
        }
        if let Some(type_proto::Value::TensorType(tensor)) =
            value.r#type.as_mut().and_then(|t| t.value.as_mut())
            && let Some(side) = tensor.shape.as_mut().and_then(|s| s.dim.first_mut())
        {
            side.value = Some(Dimension::DimValue(1));
        }
    }
}

/// Checks type and shape; `batch` is the name of an open batch dimension.
fn check_tensor(
    role: &str,
    value: &ValueInfoProto,
    expected: &[i64],
    batch: Option<&str>,
) -> Result<()> {
    let name = &value.name;
    let Some(type_proto::Value::TensorType(tensor)) =
        value.r#type.as_ref().and_then(|t| t.value.as_ref())
    else {
        return Err(refusal(format!("{role} `{name}` of the graph has no type")));
    };
    if tensor.elem_type != DataType::Float as i32 {
        let found = DataType::try_from(tensor.elem_type)
            .map_or_else(|_| tensor.elem_type.to_string(), |t| format!("{t:?}"));
        return Err(refusal(format!(
            "{role} `{name}` of the graph: expected 32-bit floats, found {found}"
        )));
    }
    let found: Vec<String> = shape_of(value)
        .iter()
        .map(|dimension| match &dimension.value {
            Some(Dimension::DimValue(size)) => size.to_string(),
            Some(Dimension::DimParam(symbol)) => format!("`{symbol}`"),
            None => "?".to_owned(),
        })
        .collect();
    let mut expected: Vec<String> = expected.iter().map(ToString::to_string).collect();
    if let Some(batch) = batch {
        expected[0] = format!("`{batch}`");
    }
    if found == expected {
        return Ok(());
    }
    Err(refusal(format!(
        "{role} `{name}` of the graph: expected shape [{}], found [{}]",
        expected.join(", "),
        found.join(", ")
    ))
    .remedy(
        "export the model with fixed shapes; only the batch may be open, for all tensors or none",
    ))
}

pub(super) fn refusal(what: impl Into<String>) -> Error {
    Error::input(what)
}

pub(super) fn list<T: Display>(items: impl IntoIterator<Item = T>) -> String {
    let names: Vec<String> = items.into_iter().map(|item| format!("`{item}`")).collect();
    if names.is_empty() {
        "none".to_owned()
    } else {
        names.join(", ")
    }
}
