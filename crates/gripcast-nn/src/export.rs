//! Exports a network to ONNX, and recognises exported files.
//!
//! Batch normalisation is folded into the convolutions, the temperature into the last layer; the
//! left and the right sensor share the weights of one encoder. The batch size is open. A file is
//! recognised by comparing its nodes with those exported for the same architecture.

use tract_onnx::pb::{GraphProto, NodeProto, TensorProto, tensor_proto::DataType};

use crate::architecture::{Architecture, ConvSpec, EncoderKind, GEOMETRY, IMAGE, Param, head_name};
use crate::network::Network;
use crate::predict::ModelContract;
use crate::predict::contract::{
    CONTACT_CHANNELS, CONTACT_SHAPE, GEOMETRY_SHAPE, INPUT_SHAPE, InputName, Modality,
    OUTPUT_SHAPE, contact_output, geometry_output, is_fallback, output_of,
};
use crate::predict::onnx::{Attribute, OPEN_BATCH, OnnxGraphBuilder, Value};
use gripcast_base::error::{Error, Result};

/// Name of the constant that selects the geometry of an embedding.
const SELECT: &str = "geometry.select";
/// Start of the constants that read the contact maps.
const CONTACT: &str = "contact.projection";
/// Maximum padding of a recognised convolution, pixels.
const MAX_PAD: usize = 16;

/// Encodes a model as an ONNX file.
///
/// # Errors
/// An invalid contract, or an input without encoder.
pub fn to_onnx(network: &Network, contract: &ModelContract) -> Result<Vec<u8>> {
    let mut graph = OnnxGraphBuilder::new(&contract.name);
    graph.description("Grasp stability from touch and sight, trained on simulated grasps");
    contract.write(&mut graph)?;
    let all = contract.modality;
    if network.modality() != all || !network.heads().eq(contract.outputs().map(|o| o.modality)) {
        return Err(Error::internal("the contract is not that of the network"));
    }
    for name in all.inputs() {
        graph.input(name.name(), &with_open_batch(INPUT_SHAPE))?;
    }
    for kind in EncoderKind::ALL {
        write_encoder(&mut graph, network, kind)?;
    }
    for (head, output) in network.layout().heads.iter().zip(contract.outputs()) {
        write_linear(&mut graph, network, &head.hidden, 1.0)?;
        write_linear(&mut graph, network, &head.logit, output.temperature)?;
    }
    if !contract.geometry.is_empty() {
        let (rows, columns) = (network.architecture().camera_embedding, GEOMETRY);
        let one = |at: usize| f32::from(u8::from(at / columns == at % columns));
        let values: Vec<f32> = (0..rows * columns).map(one).collect();
        graph.constant(SELECT, &[rows as i64, columns as i64], &values)?;
    }
    if !contract.contact.is_empty() {
        write_contact(&mut graph, network)?;
    }
    let reads_contact = !contract.contact.is_empty();
    let outputs = write_nodes(&mut graph, network.architecture(), all, reads_contact)?;
    for (value, shape) in &outputs {
        graph.output(value, &with_open_batch(*shape));
    }
    graph.to_bytes()
}

/// Replaces the batch size of a shape by an open one.
fn with_open_batch<const N: usize>(mut shape: [i64; N]) -> [i64; N] {
    shape[0] = OPEN_BATCH;
    shape
}

/// Writes weight and bias of a layer, divided by the temperature.
fn write_linear(
    graph: &mut OnnxGraphBuilder,
    network: &Network,
    layer: &[Param; 2],
    temperature: f64,
) -> Result<()> {
    for param in layer {
        let values = network.values(param).iter();
        let scaled: Vec<f32> = values
            .map(|x| (f64::from(*x) / temperature) as f32)
            .collect();
        let [rows, columns] = param.shape.map(|side| side as i64);
        let is_weight = param.is_weight();
        let shape = if is_weight {
            &[rows, columns][..]
        } else {
            &[columns]
        };
        graph.constant(&param.name, shape, &scaled)?;
    }
    Ok(())
}

/// Writes the weights of an encoder, if the network has it.
fn write_encoder(graph: &mut OnnxGraphBuilder, network: &Network, kind: EncoderKind) -> Result<()> {
    let (Some(folded), Some([weight, bias])) = (network.folded(kind), network.projection(kind))
    else {
        return Ok(());
    };
    for (i, (shape, [weight, bias])) in network.shapes().iter().zip(folded).enumerate() {
        let [kernel, inputs, outputs] = [shape.kernel, shape.input[2], shape.channels];
        let weight = outputs_first(&weight, kernel, inputs, outputs);
        let size = [outputs, inputs, kernel, kernel].map(|side| side as i64);
        graph.constant(&conv_param(kind, i, "weight"), &size, &weight)?;
        graph.constant(&conv_param(kind, i, "bias"), &size[..1], &bias)?;
    }
    let [height, width, channels] = network.architecture().pooled();
    let [rows, columns] = weight.shape;
    let values = channels_first(network.values(weight), [height * width, channels], columns);
    graph.constant(&weight.name, &[rows as i64, columns as i64], &values)?;
    graph.constant(&bias.name, &[columns as i64], network.values(bias))?;
    Ok(())
}

/// Writes what reads the contact maps at each cell.
fn write_contact(graph: &mut OnnxGraphBuilder, network: &Network) -> Result<()> {
    let layer = network.layout().contact.as_ref();
    let [weight, bias] =
        layer.ok_or_else(|| Error::internal("the network reads no contact maps"))?;
    let [inputs, outputs] = weight.shape;
    let values = outputs_first(network.values(weight), 1, inputs, outputs);
    let size = [outputs, inputs, 1, 1].map(|side| side as i64);
    graph.constant(&weight.name, &size, &values)?;
    graph.constant(&bias.name, &size[..1], network.values(bias))?;
    Ok(())
}

fn conv_param(kind: EncoderKind, at: usize, what: &str) -> String {
    format!("{}.conv{}.{what}", kind.name(), at + 1)
}

/// Appends the nodes of a network, returns the outputs with their shapes; inputs and constants are
/// referenced by name.
fn write_nodes(
    graph: &mut OnnxGraphBuilder,
    architecture: &Architecture,
    modality: Modality,
    reads_contact: bool,
) -> Result<Vec<(Value, [i64; 2])>> {
    let mut embeddings = Vec::new();
    let mut contact = Vec::new();
    for input in modality.inputs() {
        let (last, embedding) = write_encoder_nodes(graph, architecture, input)?;
        embeddings.push((input, embedding));
        if reads_contact && EncoderKind::of(input) == EncoderKind::Touch {
            contact.push(write_contact_nodes(graph, input, &last)?);
        }
    }
    let mut outputs = Vec::new();
    for head in architecture.heads(modality) {
        let own = embeddings.iter().filter(|(input, _)| head.has(*input));
        let own: Vec<&Value> = own.map(|(_, value)| value).collect();
        // Nodes of the head of all inputs have short names.
        let suffix = head_name(head, modality)
            .trim_start_matches("head")
            .to_owned();
        let node = |what: &str| format!("{what}{suffix}");
        let layer = |what: &str| format!("head{suffix}.{what}");
        let joined = match &own[..] {
            [one] => (*one).clone(),
            many => {
                let axis = [Attribute::int("axis", 1)];
                graph.node("Concat", &node("joined"), many, axis)?
            }
        };
        let sums = write_gemm(graph, &node("hidden"), &joined, &layer("hidden"))?;
        let active = graph.node("Relu", &node("hidden_relu"), &[&sums], [])?;
        let logit = write_gemm(graph, &node("logit"), &active, &layer("logit"))?;
        let p_stable = graph.node("Sigmoid", &output_of(head, modality), &[&logit], [])?;
        outputs.push((p_stable, OUTPUT_SHAPE));
    }
    for (input, embedding) in &embeddings {
        if architecture.geometry && EncoderKind::of(*input) != EncoderKind::Touch {
            let name = geometry_output(*input);
            let select = Value::named(SELECT);
            let geometry = graph.node("MatMul", &name, &[embedding, &select], [])?;
            outputs.push((geometry, GEOMETRY_SHAPE));
        }
    }
    outputs.extend(contact.into_iter().map(|map| (map, CONTACT_SHAPE)));
    Ok(outputs)
}

/// Appends the nodes that read the contact map of a tactile input from the encoder's last output.
fn write_contact_nodes(
    graph: &mut OnnxGraphBuilder,
    input: InputName,
    last: &Value,
) -> Result<Value> {
    let [weight, bias] = ["weight", "bias"].map(|what| Value::named(&format!("{CONTACT}.{what}")));
    let kernel = [Attribute::ints("kernel_shape", &[1; 2])];
    let name = format!("{input}_contact");
    let map = graph.node("Conv", &name, &[last, &weight, &bias], kernel)?;
    let axis = [Attribute::int("axis", 1)];
    graph.node("Flatten", &contact_output(input), &[&map], axis)
}

/// Appends the nodes of an encoder; returns the last convolution's output and the embedding.
fn write_encoder_nodes(
    graph: &mut OnnxGraphBuilder,
    architecture: &Architecture,
    input: InputName,
) -> Result<(Value, Value)> {
    let (name, kind) = (input.name(), EncoderKind::of(input));
    let mut x = Value::named(name);
    for (i, spec) in architecture.convolutions.iter().enumerate() {
        let [kernel, stride, pad] = [spec.kernel, spec.stride, spec.pad].map(|n| n as i64);
        let step = format!("{name}_conv{}", i + 1);
        let attributes = [
            Attribute::ints("kernel_shape", &[kernel; 2]),
            Attribute::ints("strides", &[stride; 2]),
            Attribute::ints("pads", &[pad; 4]),
        ];
        let [weight, bias] =
            ["weight", "bias"].map(|what| Value::named(&conv_param(kind, i, what)));
        let z = graph.node("Conv", &step, &[&x, &weight, &bias], attributes)?;
        x = graph.node("Relu", &format!("{step}_relu"), &[&z], [])?;
    }
    let pool = architecture.pool.map(|side| side as i64);
    let attributes = [
        Attribute::ints("kernel_shape", &pool),
        Attribute::ints("strides", &pool),
    ];
    let pooled = graph.node("AveragePool", &format!("{name}_pool"), &[&x], attributes)?;
    let axis = [Attribute::int("axis", 1)];
    let flat = graph.node("Flatten", &format!("{name}_flat"), &[&pooled], axis)?;
    let projection = format!("{}.projection", kind.name());
    let embedding = write_gemm(graph, &format!("{name}_embedding"), &flat, &projection)?;
    Ok((x, embedding))
}

fn write_gemm(graph: &mut OnnxGraphBuilder, name: &str, x: &Value, layer: &str) -> Result<Value> {
    let [weight, bias] = ["weight", "bias"].map(|what| Value::named(&format!("{layer}.{what}")));
    graph.node("Gemm", name, &[x, &weight, &bias], [])
}

/// Transposes weights KH·KW·C × outputs to outputs × C × KH × KW.
fn outputs_first(weight: &[f32], kernel: usize, inputs: usize, outputs: usize) -> Vec<f32> {
    let window = kernel * kernel;
    let mut values = Vec::with_capacity(weight.len());
    for output in 0..outputs {
        for input in 0..inputs {
            let rows = (0..window).map(|at| at * inputs + input);
            values.extend(rows.map(|row| weight[row * outputs + output]));
        }
    }
    values
}

/// Reorders rows from pixels × channels to channels × pixels.
fn channels_first(weight: &[f32], [pixels, channels]: [usize; 2], columns: usize) -> Vec<f32> {
    let mut values = Vec::with_capacity(weight.len());
    for channel in 0..channels {
        for pixel in 0..pixels {
            let row = pixel * channels + channel;
            values.extend_from_slice(&weight[row * columns..][..columns]);
        }
    }
    values
}

const _: () = {
    // The model's inputs and the network's images have equal size.
    assert!(INPUT_SHAPE[1] as usize == IMAGE[2] && INPUT_SHAPE[2] as usize == IMAGE[0]);
};

/// A graph exported from a gripcast network.
#[derive(Debug)]
pub(crate) struct RecognisedNetwork<'a> {
    graph: &'a GraphProto,
    pub(crate) architecture: Architecture,
    /// Whether it reads contact maps.
    pub(crate) reads_contact: bool,
}

/// Weight and bias of a layer as stored in the file.
pub(crate) type Layer = [Vec<f32>; 2];

impl<'a> RecognisedNetwork<'a> {
    /// Recognises the graph of a network with these inputs; none if any node differs.
    pub(crate) fn new(graph: &'a GraphProto, modality: Modality) -> Option<Self> {
        let architecture = architecture_of(graph, modality)?;
        let reads_contact = reads_contact(graph);
        let mut expected = OnnxGraphBuilder::new("");
        write_nodes(&mut expected, &architecture, modality, reads_contact).ok()?;
        let matches = expected.nodes() == graph.node;
        let has_cells = !reads_contact || architecture.has_contact();
        (matches && has_cells).then_some(Self {
            graph,
            architecture,
            reads_contact,
        })
    }

    /// Weight, outputs × C × KH × KW, and bias of a convolution with `inputs` input channels.
    pub(crate) fn convolution(&self, kind: EncoderKind, at: usize, inputs: usize) -> Option<Layer> {
        let spec = self.architecture.convolutions.get(at)?;
        let weight = conv_param(kind, at, "weight");
        let bias = conv_param(kind, at, "bias");
        let sides = [spec.channels, inputs, spec.kernel, spec.kernel];
        Some([
            self.floats(&weight, &sides)?,
            self.floats(&bias, &[spec.channels])?,
        ])
    }

    /// Weight, outputs × inputs, and bias of what reads the contact maps at each cell.
    pub(crate) fn contact(&self) -> Option<Layer> {
        let inputs = self.architecture.convolutions.last()?.channels;
        let weight = self.floats(
            &format!("{CONTACT}.weight"),
            &[CONTACT_CHANNELS, inputs, 1, 1],
        )?;
        let bias = self.floats(&format!("{CONTACT}.bias"), &[CONTACT_CHANNELS])?;
        Some([weight, bias])
    }

    /// Weight, inputs × outputs, and bias of a dense layer.
    pub(crate) fn dense(&self, layer: &str, inputs: usize, outputs: usize) -> Option<Layer> {
        Some([
            self.floats(&format!("{layer}.weight"), &[inputs, outputs])?,
            self.floats(&format!("{layer}.bias"), &[outputs])?,
        ])
    }

    /// Values of an f32 constant of this shape.
    fn floats(&self, name: &str, sides: &[usize]) -> Option<Vec<f32>> {
        let tensor = constant(self.graph, name)?;
        let mut all = sides.iter();
        let count = all.try_fold(1_usize, |count, side| count.checked_mul(*side))?;
        let is_float = tensor.data_type == DataType::Float as i32;
        if !is_float || dims(tensor)? != sides {
            return None;
        }
        let values: Vec<f32> = if tensor.raw_data.is_empty() {
            tensor.float_data.clone()
        } else {
            let floats = tensor.raw_data.as_chunks::<4>().0.iter();
            floats.map(|bytes| f32::from_le_bytes(*bytes)).collect()
        };
        (values.len() == count && count > 0).then_some(values)
    }
}

/// Reads the architecture of a graph; the encoders are alike.
fn architecture_of(graph: &GraphProto, modality: Modality) -> Option<Architecture> {
    let input = *modality.inputs().first()?;
    let kind = EncoderKind::of(input);
    let outputs = |name: &str, at: usize| dims(constant(graph, name)?)?.get(at).copied();
    let mut side = [IMAGE[0], IMAGE[1]];
    let mut convolutions = Vec::new();
    while let Some(node) = node(graph, &format!("{input}_conv{}", convolutions.len() + 1)) {
        let first = |name: &str| ints(node, name)?.first().copied();
        let spec = ConvSpec {
            channels: outputs(&conv_param(kind, convolutions.len(), "weight"), 0)?,
            kernel: first("kernel_shape")?,
            stride: first("strides")?,
            pad: first("pads")?,
        };
        if spec.kernel == 0 || spec.stride == 0 || spec.pad > MAX_PAD {
            return None;
        }
        for side in &mut side {
            *side = (*side + 2 * spec.pad).checked_sub(spec.kernel)? / spec.stride + 1;
        }
        convolutions.push(spec);
    }
    let pool = ints(node(graph, &format!("{input}_pool"))?, "kernel_shape")?;
    let pool = <[usize; 2]>::try_from(pool).ok()?;
    let fits = |(pool, side): (&usize, &usize)| (1..=*side).contains(pool);
    let embedding = |kind: EncoderKind| match kind.is_in(modality) {
        true => outputs(&format!("{}.projection.weight", kind.name()), 1),
        // Unused.
        false => Some(0),
    };
    let cameras = [EncoderKind::Vision, EncoderKind::Depth];
    let camera = cameras.into_iter().find(|kind| kind.is_in(modality));
    let (geometry, fallbacks) = (
        // Only a network that estimates the geometry learns contact maps.
        constant(graph, SELECT).is_some() || reads_contact(graph),
        graph.output.iter().any(|output| is_fallback(&output.name)),
    );
    // Heads of other inputs have hidden units for the extents.
    let hidden = match geometry && fallbacks && modality.cameras().is_some() {
        true if modality.has_touch() => outputs(
            &format!("{}.hidden.weight", head_name(Modality::T, modality)),
            1,
        )?,
        true => 0,
        false => outputs("head.hidden.weight", 1)?,
    };
    let is_usable = !convolutions.is_empty() && pool.iter().zip(&side).all(fits);
    is_usable.then_some(Architecture {
        name: String::new(),
        convolutions,
        pool,
        embedding: embedding(EncoderKind::Touch)?,
        camera_embedding: camera.map_or(Some(0), embedding)?,
        geometry,
        fallbacks,
        hidden,
    })
}

fn reads_contact(graph: &GraphProto) -> bool {
    constant(graph, &format!("{CONTACT}.weight")).is_some()
}

fn node<'a>(graph: &'a GraphProto, name: &str) -> Option<&'a NodeProto> {
    graph.node.iter().find(|node| node.name == name)
}

fn constant<'a>(graph: &'a GraphProto, name: &str) -> Option<&'a TensorProto> {
    graph.initializer.iter().find(|found| found.name == name)
}

fn dims(tensor: &TensorProto) -> Option<Vec<usize>> {
    let sides = tensor.dims.iter().map(|&side| usize::try_from(side).ok());
    sides.collect()
}

fn ints(node: &NodeProto, name: &str) -> Option<Vec<usize>> {
    let attribute = node.attribute.iter().find(|found| found.name == name)?;
    let values = attribute.ints.iter().map(|&x| usize::try_from(x).ok());
    values.collect()
}

#[cfg(test)]
#[path = "export_test.rs"]
mod tests;
