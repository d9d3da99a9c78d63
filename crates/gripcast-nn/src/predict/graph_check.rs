//! Checks the graph of a model file against its contract.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;

use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::tensor_shape_proto::Dimension as TensorDimension;
use tract_onnx::pb::tensor_shape_proto::dimension::Value as Dimension;
use tract_onnx::pb::{GraphProto, ModelProto, NodeProto, ValueInfoProto, type_proto};

use super::constants::check_constants;
use super::contract::ModelContract;
use super::onnx::PYTORCH_EXPORT;
use super::tensors::{
    CONTACT_SHAPE, GEOMETRY_SHAPE, INPUT_SHAPE, OUTPUT_SHAPE, contact_output, geometry_output,
    output_of,
};
use gripcast_base::error::{Error, Result};

/// Supported operator sets.
const OPSETS: std::ops::RangeInclusive<i64> = 7..=22;
/// Maximum kernel, stride, dilation or padding, pixels.
const MAX_WINDOW: i64 = 4096;

/// Refuses a graph that violates its contract or that the engine cannot run.
///
/// # Errors
/// `Input`, with expected and found values.
pub(super) fn check_graph(contract: &ModelContract, model: &ModelProto) -> Result<()> {
    let modality = contract.modality;
    check_operator_sets(model)?;
    let graph = model
        .graph
        .as_ref()
        .ok_or_else(|| refusal("the file has no graph"))?;
    check_constants(model)?;
    check_operators(graph)?;
    check_windows(graph)?;
    check_order(graph)?;
    let found = graph_inputs(graph);
    let names: BTreeSet<&str> = found.iter().map(|input| input.name.as_str()).collect();
    let inputs = modality.inputs().into_iter();
    let expected: BTreeSet<&str> = inputs.map(|n| n.name()).collect();
    if names != expected || found.len() != expected.len() {
        return Err(refusal(format!(
            "inputs of the graph: expected {} for modality {modality}, found {}",
            list(expected),
            list(found.iter().map(|input| &input.name))
        )));
    }
    let mut sizes = BTreeMap::new();
    for input in found {
        check_tensor("input", input, &INPUT_SHAPE, &mut sizes)?;
    }
    let predictions = contract.outputs();
    let predictions = predictions.map(|o| (output_of(o.modality, modality), OUTPUT_SHAPE));
    let geometry = contract.geometry.iter();
    let geometry = geometry.map(|input| (geometry_output(*input), GEOMETRY_SHAPE));
    let contact = contract.contact.iter();
    let contact = contact.map(|input| (contact_output(*input), CONTACT_SHAPE));
    let expected = predictions.chain(geometry).chain(contact);
    let expected: BTreeMap<String, [i64; 2]> = expected.collect();
    let names: BTreeSet<&str> = graph.output.iter().map(|output| &*output.name).collect();
    if graph.output.len() != expected.len() || !names.iter().eq(expected.keys()) {
        let what = match expected.len() {
            1 => "the single output",
            _ => "the outputs",
        };
        return Err(refusal(format!(
            "expected {what} {} in the graph, found {}",
            list(expected.keys()),
            list(graph.output.iter().map(|output| &output.name))
        )));
    }
    graph.output.iter().try_for_each(|output| {
        let shape = expected.get(&output.name).unwrap_or(&OUTPUT_SHAPE);
        check_tensor("output", output, shape, &mut sizes)
    })
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

fn is_standard(domain: &str) -> bool {
    domain.is_empty() || domain == "ai.onnx"
}

fn check_operator_sets(model: &ModelProto) -> Result<()> {
    let mut version = None;
    for import in &model.opset_import {
        if is_standard(&import.domain) {
            version = Some(import.version);
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
        .remedy(format!("export the model again with {PYTORCH_EXPORT}"))),
    }
}

/// Refuses operators that the engine lacks, or would run as another operation.
fn check_operators(graph: &GraphProto) -> Result<()> {
    let known = &tract_onnx::onnx().op_register.0;
    graph.node.iter().try_for_each(|node| {
        let name = node.output.first().filter(|_| node.name.is_empty());
        let name = name.unwrap_or(&node.name);
        if !is_standard(&node.domain) || !known.contains_key(&node.op_type) {
            let domain = match &*node.domain {
                "" => String::new(),
                domain => format!(" of the operator set `{domain}`"),
            };
            return Err(refusal(format!(
                "unsupported operator `{}`{domain} at `{name}`",
                node.op_type
            ))
            .remedy(format!(
                "use standard operators and export with {PYTORCH_EXPORT}"
            )));
        }
        if let Some(what) = training_operator(node) {
            return Err(refusal(format!("unsupported: {what} at `{name}`")).remedy(
                "export the network for inference: call `model.eval()` first, and leave out \
                 `training=` of `torch.onnx.export`",
            ));
        }
        let inner = node
            .attribute
            .iter()
            .flat_map(|a| a.g.iter().chain(&a.graphs));
        inner.into_iter().try_for_each(check_operators)
    })
}

/// What makes the output of a node depend on the other grasps of a batch, or on chance.
fn training_operator(node: &NodeProto) -> Option<&'static str> {
    let is_on = |name| node.attribute.iter().any(|a| a.name == name && a.i != 0);
    let outputs = node.output.iter().filter(|name| !name.is_empty()).count();
    match &*node.op_type {
        "BatchNormalization" if is_on("training_mode") || outputs > 1 => {
            Some("batch normalisation in training mode")
        }
        "RandomNormal" | "RandomNormalLike" | "RandomUniform" | "RandomUniformLike"
        | "Multinomial" | "Bernoulli" => Some("an operator that draws random numbers"),
        _ => None,
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

/// Refuses operators that need each other's results: there is no order to run them in.
fn check_order(graph: &GraphProto) -> Result<()> {
    let nodes = graph.node.iter().enumerate();
    let makers: BTreeMap<&str, usize> = nodes
        .flat_map(|(at, node)| node.output.iter().map(move |name| (name.as_str(), at)))
        .filter(|(name, _)| !name.is_empty())
        .collect();
    let mut users = vec![Vec::new(); graph.node.len()];
    let mut waits = vec![0_usize; graph.node.len()];
    for (at, node) in graph.node.iter().enumerate() {
        for maker in node
            .input
            .iter()
            .filter_map(|name| makers.get(name.as_str()))
        {
            users[*maker].push(at);
            waits[at] += 1;
        }
    }
    let mut ready: Vec<usize> = (0..waits.len()).filter(|at| waits[*at] == 0).collect();
    let mut done = 0;
    while let Some(at) = ready.pop() {
        done += 1;
        for user in &users[at] {
            waits[*user] -= 1;
            if waits[*user] == 0 {
                ready.push(*user);
            }
        }
    }
    if done == waits.len() {
        return Ok(());
    }
    let stuck = graph
        .node
        .iter()
        .zip(&waits)
        .filter(|(_, waits)| **waits > 0);
    let names = stuck.map(|(node, _)| match &*node.name {
        "" => node.output.first().map_or("", String::as_str),
        name => name,
    });
    Err(refusal(format!(
        "the graph has a cycle: {} need results that are made of their own",
        list(names.take(3))
    ))
    .remedy(format!(
        "the file is damaged: export the model again with {PYTORCH_EXPORT}"
    )))
}

fn shape_of(value: &ValueInfoProto) -> &[TensorDimension] {
    let tensor = match value.r#type.as_ref().and_then(|t| t.value.as_ref()) {
        Some(type_proto::Value::TensorType(tensor)) => tensor,
        _ => return &[],
    };
    tensor.shape.as_ref().map_or(&[], |shape| &shape.dim)
}

/// Binds open dimensions to the sizes of the contract; tract needs them, and is much faster with a
/// known batch size.
pub(super) fn bind_dimensions(graph: &mut GraphProto) {
    let constants: BTreeSet<String> = graph.initializer.iter().map(|t| t.name.clone()).collect();
    let inputs = graph.input.iter_mut();
    let inputs = inputs.filter(|input| !constants.contains(&input.name));
    inputs.for_each(|input| bind(input, &INPUT_SHAPE));
    graph
        .output
        .iter_mut()
        .for_each(|output| bind(output, &OUTPUT_SHAPE));
}

fn bind(value: &mut ValueInfoProto, shape: &[i64]) {
    let tensor = value.r#type.as_mut().and_then(|t| t.value.as_mut());
    if let Some(type_proto::Value::TensorType(tensor)) = tensor
        && let Some(found) = tensor.shape.as_mut()
    {
        for (dimension, size) in found.dim.iter_mut().zip(shape) {
            if size_of(dimension).is_none() {
                dimension.value = Some(Dimension::DimValue(*size));
            }
        }
    }
}

/// Size of a dimension; none if it is open: a name, a negative number or nothing.
fn size_of(dimension: &TensorDimension) -> Option<i64> {
    match dimension.value {
        Some(Dimension::DimValue(size)) if size >= 0 => Some(size),
        _ => None,
    }
}

/// Checks type and shape of a tensor. Open dimensions get the expected size; `sizes` has those of
/// names so far.
fn check_tensor<'a>(
    role: &str,
    value: &'a ValueInfoProto,
    expected: &[i64],
    sizes: &mut BTreeMap<&'a str, i64>,
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
    let found = shape_of(value);
    let mut fits = found.len() == expected.len();
    for (dimension, expected) in found.iter().zip(expected) {
        fits &= match &dimension.value {
            Some(Dimension::DimParam(name)) if !name.is_empty() => {
                *sizes.entry(name.as_str()).or_insert(*expected) == *expected
            }
            _ => size_of(dimension).is_none_or(|size| size == *expected),
        };
    }
    if fits {
        return Ok(());
    }
    let found = found.iter().map(|dimension| match &dimension.value {
        Some(Dimension::DimValue(size)) => size.to_string(),
        Some(Dimension::DimParam(name)) => format!("`{name}`"),
        None => "?".to_owned(),
    });
    let found: Vec<String> = found.collect();
    Err(refusal(format!(
        "{role} `{name}` of the graph: expected shape {expected:?}, found [{}]",
        found.join(", ")
    ))
    .remedy(
        "export the model for images of this shape; a dimension may be open, but one name stands \
         for one size",
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
