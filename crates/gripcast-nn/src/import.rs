//! Reads the network of an exported model back, so that it can be trained further.
//!
//! The export folds batch normalisation into the convolutions. They are read with γ = 1 and
//! statistics that change nothing, the folded bias as β: the network has the outputs of the file,
//! and its export has the same weights. The temperature stays in the last layer.

use super::batch_norm::EPSILON;
use super::export::{Layer, RecognisedNetwork};
use super::network::Network;
use crate::architecture::{EncoderKind, EncoderParams, GEOMETRY, Param, head_name};
use crate::predict::ModelContract;
use crate::predict::onnx;
use gripcast_base::error::{Error, Result};

/// Reads network and contract of a model file that [`to_onnx`](crate::to_onnx) wrote. The logits of
/// the network are those of the file, divided by its temperature.
///
/// # Errors
/// `Input`: the file is no ONNX model, violates its contract, or has another graph than the export
/// of a gripcast network.
pub fn from_onnx(bytes: &[u8]) -> Result<(Network, ModelContract)> {
    let model = onnx::decode(bytes)?;
    let contract = ModelContract::from_proto(&model)?;
    let graph = model.graph.as_ref();
    let network = graph
        .and_then(|graph| RecognisedNetwork::new(graph, contract.modality))
        .and_then(|graph| network(&graph, &contract));
    let network = network.ok_or_else(|| {
        let what = format!(
            "the graph of the model `{}` is not that of a network that gripcast trains",
            contract.name
        );
        Error::input(what)
    })?;
    Ok((network, contract))
}

/// Layers of an encoder in a file.
struct Encoder {
    convolutions: Vec<Layer>,
    projection: Layer,
}

fn network(graph: &RecognisedNetwork<'_>, contract: &ModelContract) -> Option<Network> {
    let modality = contract.modality;
    let architecture = &graph.architecture;
    let mut specs = architecture.convolutions.iter();
    // The kernels of the training step need whole vectors.
    if !specs.all(|spec| spec.channels.is_multiple_of(16)) {
        return None;
    }
    let shapes = architecture.shapes();
    let pooled = architecture.pooled();
    let encoder = |kind: EncoderKind| -> Option<Encoder> {
        let convolutions = shapes.iter().enumerate().map(|(at, shape)| {
            let [weight, bias] = graph.convolution(kind, at, shape.input[2])?;
            let [kernel, inputs] = [shape.kernel, shape.input[2]];
            Some([outputs_last(&weight, kernel * kernel, inputs), bias])
        });
        let convolutions = convolutions.collect::<Option<_>>()?;
        let layer = format!("{}.projection", kind.name());
        let inputs = pooled.iter().product();
        let [weight, bias] = graph.dense(&layer, inputs, architecture.embedding_of(kind))?;
        let pixels = pooled[0] * pooled[1];
        Some(Encoder {
            convolutions,
            projection: [channels_last(&weight, pixels, bias.len()), bias],
        })
    };
    // Sizes of a file can lie: a layer is read before the sizes that follow from it are used.
    let kinds = EncoderKind::ALL.into_iter();
    let kinds = kinds.filter(|kind| kind.is_in(modality));
    let encoders = kinds.map(encoder).collect::<Option<Vec<_>>>()?;
    let has_cameras = modality.cameras().is_some();
    if has_cameras && architecture.geometry && architecture.camera_embedding < GEOMETRY {
        return None;
    }
    let heads = architecture.heads(modality).into_iter().map(|head| {
        let (name, joined) = (head_name(head, modality), architecture.joined(head));
        Some([
            graph.dense(
                &format!("{name}.hidden"),
                joined,
                architecture.hidden_of(head),
            )?,
            graph.dense(&format!("{name}.logit"), architecture.hidden_of(head), 1)?,
        ])
    });
    let heads = heads.collect::<Option<Vec<_>>>()?;
    let contact = match graph.reads_contact {
        true => Some(graph.contact()?),
        false => None,
    };
    let mut network = Network::new(architecture, modality, || 0.5);
    let layout = network.layout().clone();
    for (params, encoder) in layout.encoders.iter().zip(&encoders) {
        set_encoder(&mut network, params, encoder);
    }
    for (params, [hidden, logit]) in layout.heads.iter().zip(&heads) {
        set_layer(&mut network, &params.hidden, hidden);
        set_layer(&mut network, &params.logit, logit);
    }
    if let Some((params, [weight, bias])) = layout.contact.as_ref().zip(contact) {
        let weight = outputs_last(&weight, 1, params[0].shape[0]);
        set_layer(&mut network, params, &[weight, bias]);
    }
    Some(network)
}

fn set_encoder(network: &mut Network, params: &EncoderParams, encoder: &Encoder) {
    let layers = params.convolutions.iter().zip(&params.stats);
    for (([weight, gamma, beta], [mean, variance]), [folded, bias]) in
        layers.zip(&encoder.convolutions)
    {
        network.parameters[weight.range()].copy_from_slice(folded);
        network.parameters[gamma.range()].fill(1.0);
        network.parameters[beta.range()].copy_from_slice(bias);
        network.running_stats[mean.clone()].fill(0.0);
        // The deviation is 1 exactly.
        network.running_stats[variance.clone()].fill(1.0 - EPSILON);
    }
    set_layer(network, &params.projection, &encoder.projection);
}

fn set_layer(network: &mut Network, params: &[Param; 2], layer: &Layer) {
    for (param, values) in params.iter().zip(layer) {
        network.parameters[param.range()].copy_from_slice(values);
    }
}

/// Transposes weights outputs × C × KH × KW to KH·KW·C × outputs.
fn outputs_last(weight: &[f32], window: usize, inputs: usize) -> Vec<f32> {
    let fan_in = window * inputs;
    let outputs = weight.len() / fan_in;
    let mut values = Vec::with_capacity(weight.len());
    for row in 0..fan_in {
        let index = row % inputs * window + row / inputs;
        values.extend((0..outputs).map(|output| weight[output * fan_in + index]));
    }
    values
}

/// Reorders rows from channels × pixels to pixels × channels.
fn channels_last(weight: &[f32], pixels: usize, columns: usize) -> Vec<f32> {
    let channels = weight.len() / columns / pixels;
    let mut values = Vec::with_capacity(weight.len());
    for pixel in 0..pixels {
        for channel in 0..channels {
            let row = channel * pixels + pixel;
            values.extend_from_slice(&weight[row * columns..][..columns]);
        }
    }
    values
}
