//! Holds the graph of a model file against its contract.

use std::collections::BTreeSet;
use std::fmt::Display;

use tract_onnx::pb::tensor_proto::{DataLocation, DataType};
use tract_onnx::pb::tensor_shape_proto::Dimension as TensorDimension;
use tract_onnx::pb::tensor_shape_proto::dimension::Value as Dimension;
use tract_onnx::pb::{GraphProto, ModelProto, ValueInfoProto, type_proto};

use super::tensors::{INPUT_SHAPE, OUTPUT, OUTPUT_SHAPE, Variant};
use gripcast_base::error::{Error, Result};

/// Operator sets that the engine implements.
const OPSETS: std::ops::RangeInclusive<i64> = 9..=18;
/// Largest kernel, stride, dilation or padding, pixels; beyond any image that is an input.
const MAX_WINDOW: i64 = 4096;

/// Refuses a graph that does not keep what a contract promises, or that the engine cannot run.
///
/// # Errors
/// `Input`, with what was expected and what was found.
pub(super) fn check_graph(variant: Variant, model: &ModelProto) -> Result<()> {
    check_operator_sets(model)?;
    let graph = model
        .graph
        .as_ref()
        .ok_or_else(|| refusal("the file has no graph"))?;
    check_constants(graph)?;
    check_windows(graph)?;
    let found = graph_inputs(graph);
    let names: BTreeSet<&str> = found.iter().map(|input| input.name.as_str()).collect();
    let expected: BTreeSet<&str> = variant.inputs().iter().map(|n| n.name()).collect();
    if names != expected || found.len() != expected.len() {
        return Err(refusal(format!(
            "the contract (variant {}) and the graph disagree on the inputs: expected {}, the \
             graph has {}",
            variant,
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
            "the graph must have the one output `{OUTPUT}`, found {}",
            list(outputs.iter().map(|output| &output.name))
        ))),
    }
}

/// Inputs of a graph in the engine's order; constants may be listed among them and are not meant.
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
                "the model needs the operator set `{}` {}; only the standard operators are \
                 supported",
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
            "the weights `{}` are in another file; a gripcast model is one file",
            tensor.name
        ))
        .remedy("export the model without external data")),
    }
}

/// Windows of convolutions and pools. The engine computes shapes from them without a check, so a
/// damaged one could ask for any amount of memory.
fn check_windows(graph: &GraphProto) -> Result<()> {
    for node in &graph.node {
        for attribute in &node.attribute {
            let least = match attribute.name.as_str() {
                "kernel_shape" | "strides" | "dilations" => 1,
                "pads" => 0,
                _ => continue,
            };
            let allowed = least..=MAX_WINDOW;
            if let Some(found) = attribute.ints.iter().find(|x| !allowed.contains(x)) {
                return Err(refusal(format!(
                    "operator `{}` ({}): expected `{}` between {least} and {MAX_WINDOW}, \
                     found {found}",
                    node.name, node.op_type, attribute.name
                ))
                .remedy("the file is damaged; copy or export it again"));
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

/// Name of the first side of a tensor, where its size is left open.
fn batch_name(value: Option<&ValueInfoProto>) -> Option<&str> {
    match &shape_of(value?).first()?.value {
        Some(Dimension::DimParam(symbol)) if !symbol.is_empty() => Some(symbol),
        _ => None,
    }
}

/// Closes a batch of any size to one image, which the general engine is much quicker with.
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

/// `batch` is the name of the first side where the graph takes any number of images at once.
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
        "export the model with fixed shapes; only the batch may be open, everywhere or nowhere",
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
