use tract_onnx::pb::{GraphProto, ModelProto};

use super::*;
use crate::Batch;
use crate::predict::contract::{InputSpec, Origin, RgbNormalisation, Variant};
use crate::predict::{Model, ModelInput, onnx};
use gripcast_base::random::SeedStream;

fn contract(variant: Variant, temperature: f64) -> ModelContract {
    let normalisation = RgbNormalisation {
        mean: [0.0; 3],
        std: [1.0; 3],
    };
    ModelContract {
        name: "random".to_owned(),
        origin: Origin::Trained {
            seed: 1,
            manifest_sha256: "0".repeat(64),
        },
        variant,
        inputs: variant
            .inputs()
            .iter()
            .map(|name| match name {
                InputName::Rgb => InputSpec::rgb(normalisation),
                touch => InputSpec::tactile(*touch),
            })
            .collect(),
        threshold: 0.5,
        temperature,
        crop_profile: Some(gripcast_imaging::CropProfile::FULL),
        card: "random".to_owned(),
        other: std::collections::BTreeMap::new(),
    }
}

/// A network whose running moments and scales are no longer those of the beginning.
fn network(architecture: &Architecture, variant: Variant, draw: &mut SeedStream) -> Network {
    let mut network = Network::new(architecture, variant, || draw.uniform());
    for part in network.layout().clone().parts() {
        if !part.is_weight() {
            for value in &mut network.parameters[part.range()] {
                *value += draw.between(-0.2, 0.2) as f32;
            }
        }
    }
    for moment in &mut network.moments {
        *moment += draw.between(0.0, 0.5) as f32;
    }
    network
}

/// Images CHW, and the same as a batch of one.
fn images(model: &Model, draw: &mut SeedStream) -> (ModelInput, Batch) {
    let mut input = ModelInput::zeros(model.contract()).unwrap();
    let mut batch = Batch {
        targets: vec![0.0],
        weights: vec![1.0],
        ..Batch::default()
    };
    let mut image = || {
        image::RgbImage::from_fn(320, 240, |_, _| {
            image::Rgb([0; 3].map(|_: u8| draw.bits() as u8))
        })
    };
    for name in [InputName::TactileLeft, InputName::TactileRight] {
        let difference = gripcast_imaging::TactileDifference::between(&image(), &image()).unwrap();
        input.set_tactile(name, &difference).unwrap();
        if model.contract().variant != Variant::V {
            batch
                .touch
                .extend(difference.levels().iter().map(|x| f32::from(*x) / 255.0));
        }
    }
    let rgb = image();
    input.set_rgb(&rgb).unwrap();
    if model.contract().variant != Variant::T {
        batch
            .vision
            .extend(rgb.as_raw().iter().map(|x| f32::from(*x) / 255.0));
    }
    (input, batch)
}

#[test]
fn the_network_and_both_engines_agree_on_its_file() {
    let mut draw = SeedStream::named(3, "export");
    for (architecture, variant) in [
        (Architecture::gripcast(), Variant::Vt),
        (Architecture::gripcast(), Variant::T),
        (Architecture::paper(), Variant::V),
    ] {
        let network = network(&architecture, variant, &mut draw);
        let contract = contract(variant, 1.7);
        let bytes = to_onnx(&network, &contract).unwrap();
        let own = Model::from_bytes(&bytes).unwrap();
        assert!(own.is_on_own_engine());
        let tract = Model::on_tract(&bytes).unwrap();
        assert!(!tract.is_on_own_engine());
        for _ in 0..3 {
            let (input, batch) = images(&own, &mut draw);
            let logit = f64::from(network.logits(&batch)[0]) / contract.temperature;
            let expected = 1.0 / (1.0 + (-logit).exp());
            let found = [&own, &tract].map(|model| model.predict(&input).unwrap().p_stable);
            for found in found {
                assert!((found - expected).abs() < 1e-5, "{found} {expected}");
            }
        }
    }
}

#[test]
fn a_graph_with_anything_else_in_it_goes_to_the_general_engine() {
    let mut draw = SeedStream::named(4, "export");
    let architecture = Architecture::gripcast();
    let network = network(&architecture, Variant::T, &mut draw);
    let bytes = to_onnx(&network, &contract(Variant::T, 1.0)).unwrap();
    let whole = Model::from_bytes(&bytes).unwrap();
    let (input, _) = images(&whole, &mut draw);
    let expected = whole.predict(&input).unwrap().p_stable;
    let altered = |change: &dyn Fn(&mut GraphProto)| {
        let mut proto = onnx::decode(&bytes).unwrap();
        change(proto.graph.as_mut().unwrap());
        let model = Model::from_bytes(&prost::Message::encode_to_vec(&proto)).unwrap();
        assert!(!model.is_on_own_engine());
        let found = model.predict(&input).unwrap().p_stable;
        assert!((found - expected).abs() < 1e-5, "{found} {expected}");
    };
    // An operator that we do not have, which changes nothing.
    altered(&|graph| {
        let relu = graph
            .node
            .iter_mut()
            .find(|node| node.name == "hidden_relu")
            .unwrap();
        relu.op_type = "LeakyRelu".to_owned();
        relu.attribute = vec![tract_onnx::pb::AttributeProto {
            name: "alpha".to_owned(),
            r#type: tract_onnx::pb::attribute_proto::AttributeType::Float as i32,
            f: 0.0,
            ..Default::default()
        }];
    });
    // Padding that differs between sides, in one that does.
    altered(&|graph| {
        let second = graph
            .node
            .iter_mut()
            .find(|node| node.name == "tactile_left_conv2")
            .unwrap();
        let pads = second
            .attribute
            .iter_mut()
            .find(|a| a.name == "pads")
            .unwrap();
        // The rows and columns that are left out lie beyond the last window.
        pads.ints = vec![1, 1, 0, 0];
    });
}

/// Damages a graph in every way that comes to mind, once at every place.
fn damage(proto: &ModelProto, mut look: impl FnMut(&ModelProto)) {
    let graph = proto.graph.as_ref().unwrap();
    let mut with = |change: &dyn Fn(&mut GraphProto)| {
        let mut other = proto.clone();
        change(other.graph.as_mut().unwrap());
        look(&other);
    };
    for (at, node) in graph.node.iter().enumerate() {
        with(&|graph| {
            graph.node.remove(at);
        });
        with(&|graph| graph.node[at].input.clear());
        with(&|graph| graph.node[at].output.clear());
        with(&|graph| graph.node[at].input.reverse());
        with(&|graph| graph.node.swap(at, 0));
        with(&|graph| graph.node[at].attribute.clear());
        for attribute in 0..node.attribute.len() {
            for odd in [0, 2, 3, 7, 1 << 40, -1] {
                with(&|graph| graph.node[at].attribute[attribute].ints.fill(odd));
            }
            with(&|graph| graph.node[at].attribute[attribute].ints.clear());
            with(&|graph| graph.node[at].attribute[attribute].i = -9);
        }
    }
    for at in 0..graph.initializer.len() {
        with(&|graph| graph.initializer[at].raw_data.truncate(6));
        with(&|graph| graph.initializer[at].dims.reverse());
        with(&|graph| graph.initializer[at].dims.clear());
        with(&|graph| graph.initializer[at].dims.fill(1 << 40));
        with(&|graph| graph.initializer[at].dims.fill(i64::MAX));
        with(&|graph| graph.initializer[at].dims.fill(-1));
        with(&|graph| {
            graph.initializer.remove(at);
        });
    }
    with(&|graph| graph.input.clear());
    with(&|graph| graph.output.clear());
}

#[test]
fn no_damage_makes_our_engine_panic_or_answer_what_is_no_probability() {
    let mut draw = SeedStream::named(5, "export");
    let architecture = Architecture::gripcast();
    let network = network(&architecture, Variant::T, &mut draw);
    let contract = contract(Variant::T, 1.0);
    let proto = onnx::decode(&to_onnx(&network, &contract).unwrap()).unwrap();
    assert!(Model::own_answer_to_zeros(&proto, &contract).is_some());
    let (mut refused, mut all) = (0, 0);
    damage(&proto, |damaged| {
        all += 1;
        match Model::own_answer_to_zeros(damaged, &contract) {
            Some(p) => assert!((0.0..=1.0).contains(&p), "{all}: {p}"),
            None => refused += 1,
        }
    });
    assert!(2 * refused > all && all > 100, "{refused} of {all}");
}
