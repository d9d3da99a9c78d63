//! A trained network as an ONNX file.
//!
//! Batch normalisation becomes part of the convolutions, the temperature part of the last layer;
//! the left and the right sensor share the weights of one encoder. The batch is of any size.

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_nn::predict::ModelContract;
use gripcast_nn::predict::contract::{INPUT_SHAPE, InputName, OUTPUT, OUTPUT_SHAPE};
use gripcast_nn::predict::onnx::{Attribute, OPEN_BATCH, OnnxGraphBuilder, Value};
use gripcast_nn::{FoldedConvolution, Network, PICTURE, Part, Sense};

/// The bytes of a model's file.
///
/// # Errors
/// A contract that would be refused.
pub fn to_onnx(network: &Network, contract: &ModelContract) -> Result<Vec<u8>> {
    let mut graph = OnnxGraphBuilder::new(&contract.name);
    graph.description("Grasp stability from touch and sight, trained on simulated grasps");
    contract.write(&mut graph)?;
    let inputs: Vec<(InputName, Value)> = contract
        .inputs
        .iter()
        .map(|input| {
            let shape = of_any_batch(INPUT_SHAPE);
            Ok((input.name, graph.input(input.name.name(), &shape)?))
        })
        .collect::<Result<_>>()?;
    let touch = Encoder::write(&mut graph, network, Sense::Touch)?;
    let vision = Encoder::write(&mut graph, network, Sense::Vision)?;
    let mut embeddings = Vec::new();
    for (name, input) in &inputs {
        let encoder = match name {
            InputName::TactileLeft | InputName::TactileRight => &touch,
            InputName::Rgb => &vision,
        };
        let encoder = encoder.as_ref().ok_or_else(|| {
            let what = format!("the network has no encoder for `{name}`");
            Error::new(ErrorKind::Internal, what)
        })?;
        embeddings.push(encoder.apply(&mut graph, network, name.name(), input)?);
    }
    let joined = match &embeddings[..] {
        [one] => one.clone(),
        many => {
            let axis = [Attribute::int("axis", 1)];
            graph.node("Concat", "joined", &many.iter().collect::<Vec<_>>(), axis)?
        }
    };
    let [[hidden, hidden_bias], [last, last_bias]] = network.head();
    let hidden = Linear::write(&mut graph, network, hidden, hidden_bias, 1.0)?;
    let last = Linear::write(&mut graph, network, last, last_bias, contract.temperature)?;
    let sums = hidden.apply(&mut graph, "hidden", &joined)?;
    let active = graph.node("Relu", "hidden_relu", &[&sums], [])?;
    let logit = last.apply(&mut graph, "logit", &active)?;
    let p_stable = graph.node("Sigmoid", OUTPUT, &[&logit], [])?;
    graph.output(&p_stable, &of_any_batch(OUTPUT_SHAPE));
    graph.to_bytes()
}

/// A shape for any number of pictures at once.
fn of_any_batch<const N: usize>(mut shape: [i64; N]) -> [i64; N] {
    shape[0] = OPEN_BATCH;
    shape
}

/// Weights of a layer, as they are in the file.
struct Linear {
    weight: Value,
    bias: Value,
}

impl Linear {
    fn write(
        graph: &mut OnnxGraphBuilder,
        network: &Network,
        weight: &Part,
        bias: &Part,
        temperature: f64,
    ) -> Result<Self> {
        let cooled = |part: &Part| -> Vec<f32> {
            let values = network.part(part).iter();
            values
                .map(|x| (f64::from(*x) / temperature) as f32)
                .collect()
        };
        let shape = weight.shape.map(|side| side as i64);
        Ok(Self {
            weight: graph.constant(&weight.name, &shape, &cooled(weight))?,
            bias: graph.constant(&bias.name, &shape[1..], &cooled(bias))?,
        })
    }

    fn apply(&self, graph: &mut OnnxGraphBuilder, name: &str, x: &Value) -> Result<Value> {
        graph.node("Gemm", name, &[x, &self.weight, &self.bias], [])
    }
}

/// Weights of an encoder.
struct Encoder {
    convolutions: Vec<[Value; 2]>,
    projection: Linear,
}

impl Encoder {
    /// None where the network lacks the sense.
    fn write(
        graph: &mut OnnxGraphBuilder,
        network: &Network,
        sense: Sense,
    ) -> Result<Option<Self>> {
        let (Some(folded), Some([weight, bias])) =
            (network.folded(sense), network.projection(sense))
        else {
            return Ok(None);
        };
        let encoder = match sense {
            Sense::Touch => "touch",
            Sense::Vision => "vision",
        };
        let mut convolutions = Vec::new();
        for (i, (shape, folded)) in network.shapes().iter().zip(folded).enumerate() {
            let FoldedConvolution { weight, bias } = folded;
            let [kernel, inputs, outputs] =
                [shape.kernel, shape.input[2], shape.channels].map(|side| side as i64);
            let name = |what: &str| format!("{encoder}.conv{}.{what}", i + 1);
            let weight = outputs_first(&weight, shape.kernel, shape.input[2], shape.channels);
            let size = [outputs, inputs, kernel, kernel];
            convolutions.push([
                graph.constant(&name("weight"), &size, &weight)?,
                graph.constant(&name("bias"), &[outputs], &bias)?,
            ]);
        }
        let [height, width, channels] = network.pooled();
        let values = channels_first(
            network.part(weight),
            [height * width, channels],
            weight.shape[1],
        );
        let shape = weight.shape.map(|side| side as i64);
        let projection = Linear {
            weight: graph.constant(&weight.name, &shape, &values)?,
            bias: graph.constant(&bias.name, &shape[1..], network.part(bias))?,
        };
        Ok(Some(Self {
            convolutions,
            projection,
        }))
    }

    fn apply(
        &self,
        graph: &mut OnnxGraphBuilder,
        network: &Network,
        name: &str,
        input: &Value,
    ) -> Result<Value> {
        let mut x = input.clone();
        for (i, (shape, [weight, bias])) in
            network.shapes().iter().zip(&self.convolutions).enumerate()
        {
            let [kernel, stride, pad] = [shape.kernel, shape.stride, shape.pad].map(|n| n as i64);
            let step = format!("{name}_conv{}", i + 1);
            let attributes = [
                Attribute::ints("kernel_shape", &[kernel; 2]),
                Attribute::ints("strides", &[stride; 2]),
                Attribute::ints("pads", &[pad; 4]),
            ];
            let z = graph.node("Conv", &step, &[&x, weight, bias], attributes)?;
            x = graph.node("Relu", &format!("{step}_relu"), &[&z], [])?;
        }
        let pool = network.pool_window().map(|side| side as i64);
        let attributes = [
            Attribute::ints("kernel_shape", &pool),
            Attribute::ints("strides", &pool),
        ];
        let pooled = graph.node("AveragePool", &format!("{name}_pool"), &[&x], attributes)?;
        let axis = [Attribute::int("axis", 1)];
        let flat = graph.node("Flatten", &format!("{name}_flat"), &[&pooled], axis)?;
        self.projection
            .apply(graph, &format!("{name}_embedding"), &flat)
    }
}

/// Weights KH·KW·C × outputs as outputs × C × KH × KW.
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

/// Rows for pixels × channels as rows for channels × pixels.
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
    // The file's inputs and the network's pictures are of one size.
    assert!(INPUT_SHAPE[1] as usize == PICTURE[2] && INPUT_SHAPE[2] as usize == PICTURE[0]);
};

#[cfg(test)]
#[path = "export_test.rs"]
mod tests;
