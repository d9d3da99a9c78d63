use tract_onnx::pb::{GraphProto, ModelProto};

use super::*;
use crate::Batch;
use crate::from_onnx;
use crate::predict::contract::{
    GEOMETRY_UNIT_M, InputSpec, Modality, Origin, OutputSpec, RgbNormalisation,
};
use crate::predict::{
    BoostedTrees, GraspEstimator, GraspHead, Model, ModelInput, PointMap, SHIPPED, TreeNode,
    grasp_head, model_bytes, onnx,
};
use gripcast_base::random::SeedStream;
use gripcast_imaging::{Depth, DepthView};

fn contract(architecture: &Architecture, modality: Modality, temperature: f64) -> ModelContract {
    let heads = architecture.heads(modality).into_iter().skip(1).enumerate();
    let fallbacks = heads.map(|(i, modality)| OutputSpec {
        modality,
        threshold: 0.4,
        temperature: temperature + i as f64,
    });
    let cameras = modality.inputs().into_iter();
    let cameras = cameras.filter(|name| matches!(name, InputName::Rgb | InputName::Depth));
    let normalisation = RgbNormalisation::NONE;
    ModelContract {
        name: "random".to_owned(),
        origin: Origin::Trained {
            seed: 1,
            manifest_sha256: "0".repeat(64),
        },
        modality,
        inputs: modality
            .inputs()
            .into_iter()
            .map(|name| match name {
                InputName::Rgb => InputSpec::rgb(normalisation),
                InputName::Depth => InputSpec::depth(),
                touch => InputSpec::tactile(touch),
            })
            .collect(),
        threshold: 0.5,
        temperature,
        fallbacks: fallbacks.collect(),
        geometry: cameras.filter(|_| architecture.geometry).collect(),
        contact: Vec::new(),
        crop_profile: Some(gripcast_imaging::CropProfile::FULL),
        card: "random".to_owned(),
        other: std::collections::BTreeMap::new(),
    }
}

/// A network whose running statistics, scales and biases differ from the initial ones.
fn network(architecture: &Architecture, modality: Modality, draw: &mut SeedStream) -> Network {
    let mut network = Network::new(architecture, modality, || draw.uniform());
    for param in network.layout().clone().params() {
        if !param.is_weight() {
            for value in &mut network.parameters[param.range()] {
                *value += draw.between(-0.2, 0.2) as f32;
            }
        }
    }
    for value in &mut network.running_stats {
        *value += draw.between(0.0, 0.5) as f32;
    }
    network
}

/// Images as CHW input, and as a batch of one.
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
        if model.contract().modality.has_touch() {
            batch
                .touch
                .extend(difference.levels().iter().map(|x| f32::from(*x) / 255.0));
        }
    }
    let rgb = image();
    input.set_rgb(&rgb).unwrap();
    if model.contract().modality.has_vision() {
        batch
            .vision
            .extend(rgb.as_raw().iter().map(|x| f32::from(*x) / 255.0));
    }
    let image = gripcast_imaging::DepthImage::from_fn(320, 240, |_, _| {
        image::Luma([(draw.bits() % 300) as u16])
    });
    let unit_m = 1e-3;
    let points = PointMap::new(&Depth { image, unit_m }, DepthView::Colour);
    input.set_depth(&points).unwrap();
    if model.contract().modality.has_depth() {
        batch.depth.extend(points.points().as_flattened());
    }
    (input, batch)
}

#[test]
fn network_and_both_engines_agree() {
    let mut draw = SeedStream::named(3, "export");
    for (architecture, modality) in [
        (Architecture::gripcast(), Modality::Vtd),
        (Architecture::gripcast(), Modality::T),
        (Architecture::paper(), Modality::Vt),
    ] {
        let network = network(&architecture, modality, &mut draw);
        let contract = contract(&architecture, modality, 1.7);
        let bytes = to_onnx(&network, &contract).unwrap();
        let native = Model::from_bytes(&bytes).unwrap();
        assert!(native.is_native());
        let tract = Model::with_tract(&bytes).unwrap();
        assert!(!tract.is_native());
        for _ in 0..3 {
            let (whole, batch) = images(&native, &mut draw);
            let outputs = network.outputs(&batch);
            for (output, logits) in contract.outputs().zip(&outputs.logits) {
                let logit = f64::from(logits[0]) / output.temperature;
                let expected = 1.0 / (1.0 + (-logit).exp());
                let mut input = whole.clone();
                input.keep(output.modality);
                let mut cameras = outputs.geometry.iter();
                let geometry = cameras.rfind(|(input, _)| output.modality.has(*input));
                for model in [&native, &tract] {
                    let found = model.predict(&input).unwrap();
                    assert_eq!(found.modality, output.modality);
                    assert_eq!(found.threshold, output.threshold);
                    let error = (found.p_stable - expected).abs();
                    assert!(
                        error < 1e-5,
                        "{}: {} {expected}",
                        output.modality,
                        found.p_stable
                    );
                    let Some((_, expected)) = geometry else {
                        assert_eq!(found.geometry, None);
                        continue;
                    };
                    let found = found.geometry.unwrap().to_array();
                    for (found, expected) in found.iter().zip(expected) {
                        let expected = f64::from(*expected) * GEOMETRY_UNIT_M;
                        assert!((found - expected).abs() < 1e-5, "{found} {expected}");
                    }
                }
            }
        }
    }
}

#[test]
fn grasp_head_reads_contact_maps_and_extents() {
    let mut draw = SeedStream::named(4, "export");
    let architecture = Architecture::gripcast();
    let network = network(&architecture, Modality::Vtd, &mut draw);
    let mut contract = contract(&architecture, Modality::Vtd, 1.3);
    contract.contact = vec![InputName::TactileLeft, InputName::TactileRight];
    let plain = Model::from_bytes(&to_onnx(&network, &contract).unwrap()).unwrap();
    let (whole, batch) = images(&plain, &mut draw);
    let outputs = network.outputs(&batch);
    let (left, right) = outputs.contact.split_at(outputs.contact.len() / 2);
    let gels = grasp_head::gel_features([left, right]);
    // Stumps on both sides of each feature: another feature, or its value for another image, gives
    // other log-odds.
    let estimator = |modality: Modality| {
        let cameras = outputs.geometry.iter();
        let cameras = cameras.filter(|(input, _)| modality.has(*input));
        let extents = cameras.flat_map(|(_, values)| values).copied();
        let features = gels.into_iter().chain(extents.map(f64::from));
        let (bias, trees) = (0.0, Vec::new());
        let mut trees = BoostedTrees { bias, trees };
        for (i, value) in features.enumerate() {
            let margin = 1e-3 * (1.0 + value.abs());
            for (limit, [below, above]) in [
                (value - margin, [-3.0, 0.01 * i as f32]),
                (value + margin, [0.02, 3.0]),
            ] {
                let split = TreeNode::Split(i as u16, limit as f32, 1, 2);
                let leaves = [below, above].map(TreeNode::Leaf);
                trees.trees.push([vec![split], leaves.to_vec()].concat());
            }
        }
        GraspEstimator {
            modality,
            trees,
            network_weight: 0.7,
            trees_weight: 0.05,
            offset: -0.1,
        }
    };
    let estimators = [Modality::Vtd, Modality::T].map(estimator);
    let head = GraspHead {
        estimators: estimators.to_vec(),
    };
    let metadata = head.to_metadata();
    let key = grasp_head::METADATA.to_owned();
    contract.other.insert(key.clone(), metadata.clone());
    let bytes = to_onnx(&network, &contract).unwrap();
    let native = Model::from_bytes(&bytes).unwrap();
    assert!(native.is_native());
    let tract = Model::with_tract(&bytes).unwrap();
    let (imported, _) = from_onnx(&bytes).unwrap();
    let maps = imported.outputs(&batch).contact;
    let near = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-4 * (1.0 + b.abs());
    assert!(maps.len() == outputs.contact.len() && maps.iter().zip(&outputs.contact).all(near));
    for (output, logits) in contract.outputs().zip(&outputs.logits) {
        let network = f64::from(logits[0]) / output.temperature;
        let expected = head.of(output.modality).map_or(network, |estimator| {
            let features = GraspEstimator::features_of(output.modality);
            let sum: f64 = (0..features).map(|i| 0.01 * i as f64 + 0.02).sum();
            estimator.combined(network, sum)
        });
        let expected = 1.0 / (1.0 + (-expected).exp());
        let mut input = whole.clone();
        input.keep(output.modality);
        for model in [&native, &tract] {
            let found = model.predict(&input).unwrap().p_stable;
            assert!(
                (found - expected).abs() < 1e-5,
                "{}: {found} {expected}",
                output.modality
            );
        }
    }
    // A head whose readings the graph does not give is refused.
    contract.contact.clear();
    let bytes = to_onnx(&network, &contract).unwrap();
    let error = Model::from_bytes(&bytes).unwrap_err();
    assert!(
        error.what().contains("reads `tactile_left`"),
        "{}",
        error.what()
    );
}

/// Finite weights whose sums overflow: infinity minus infinity is NaN, and a ReLU would turn it into 0.
#[test]
fn weights_that_overflow_give_an_error_and_no_verdict() {
    let mut draw = SeedStream::named(8, "export");
    let architecture = Architecture::gripcast();
    let network = network(&architecture, Modality::T, &mut draw);
    let bytes = to_onnx(&network, &contract(&architecture, Modality::T, 1.0)).unwrap();
    let mut proto = onnx::decode(&bytes).unwrap();
    let weights = proto.graph.as_mut().unwrap().initializer.iter_mut();
    for tensor in weights.filter(|tensor| tensor.dims.len() == 4) {
        for value in tensor.raw_data.as_chunks_mut::<4>().0 {
            *value = (1e20 * f32::from_le_bytes(*value)).to_le_bytes();
        }
    }
    let error = match Model::from_bytes(&prost::Message::encode_to_vec(&proto)) {
        Err(error) => error,
        Ok(model) => {
            assert!(!model.is_native());
            let (input, _) = images(&model, &mut draw);
            model.predict(&input).unwrap_err()
        }
    };
    assert!(error.to_string().contains("NaN"), "{error}");
}

#[test]
fn altered_graph_runs_on_tract() {
    let mut draw = SeedStream::named(4, "export");
    let architecture = Architecture::gripcast();
    let network = network(&architecture, Modality::T, &mut draw);
    let bytes = to_onnx(&network, &contract(&architecture, Modality::T, 1.0)).unwrap();
    let original = Model::from_bytes(&bytes).unwrap();
    let (input, _) = images(&original, &mut draw);
    let expected = original.predict(&input).unwrap().p_stable;
    let altered = |change: &dyn Fn(&mut GraphProto)| {
        let mut proto = onnx::decode(&bytes).unwrap();
        change(proto.graph.as_mut().unwrap());
        let model = Model::from_bytes(&prost::Message::encode_to_vec(&proto)).unwrap();
        assert!(!model.is_native());
        let found = model.predict(&input).unwrap().p_stable;
        assert!((found - expected).abs() < 1e-5, "{found} {expected}");
    };
    // An unsupported operator with the same result.
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
    // Asymmetric padding with the same result.
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
        // The dropped rows and columns are beyond the last window.
        pads.ints = vec![1, 1, 0, 0];
    });
}

/// Damages a graph in many ways at every node and constant.
fn damage(proto: &ModelProto, mut check: impl FnMut(&ModelProto)) {
    let graph = proto.graph.as_ref().unwrap();
    let mut with = |change: &dyn Fn(&mut GraphProto)| {
        let mut other = proto.clone();
        change(other.graph.as_mut().unwrap());
        check(&other);
    };
    for (index, node) in graph.node.iter().enumerate() {
        with(&|graph| {
            graph.node.remove(index);
        });
        with(&|graph| graph.node[index].input.clear());
        with(&|graph| graph.node[index].output.clear());
        with(&|graph| graph.node[index].input.reverse());
        with(&|graph| graph.node.swap(index, 0));
        with(&|graph| graph.node[index].attribute.clear());
        for attribute in 0..node.attribute.len() {
            for value in [0, 2, 3, 7, 1 << 40, -1] {
                with(&|graph| graph.node[index].attribute[attribute].ints.fill(value));
            }
            with(&|graph| graph.node[index].attribute[attribute].ints.clear());
            with(&|graph| graph.node[index].attribute[attribute].i = -9);
        }
    }
    for index in 0..graph.initializer.len() {
        with(&|graph| graph.initializer[index].raw_data.truncate(6));
        with(&|graph| graph.initializer[index].dims.reverse());
        with(&|graph| graph.initializer[index].dims.clear());
        with(&|graph| graph.initializer[index].dims.fill(1 << 40));
        with(&|graph| graph.initializer[index].dims.fill(i64::MAX));
        with(&|graph| graph.initializer[index].dims.fill(-1));
        with(&|graph| {
            graph.initializer.remove(index);
        });
    }
    with(&|graph| graph.input.clear());
    with(&|graph| graph.output.clear());
}

#[test]
fn native_engine_survives_any_damage() {
    let mut draw = SeedStream::named(5, "export");
    let architecture = Architecture::gripcast();
    let network = network(&architecture, Modality::T, &mut draw);
    let contract = contract(&architecture, Modality::T, 1.0);
    let proto = onnx::decode(&to_onnx(&network, &contract).unwrap()).unwrap();
    assert!(Model::native_prediction_for_zeros(&proto, &contract).is_some());
    let (mut refused, mut all) = (0, 0);
    damage(&proto, |damaged| {
        all += 1;
        match Model::native_prediction_for_zeros(damaged, &contract) {
            Some(p) => assert!((0.0..=1.0).contains(&p), "{all}: {p}"),
            None => refused += 1,
        }
    });
    assert!(2 * refused > all && all > 100, "{refused} of {all}");
}

#[test]
fn network_of_a_file_has_its_outputs_and_exports_its_weights() {
    let mut draw = SeedStream::named(6, "import");
    for (architecture, modality) in [
        (Architecture::gripcast(), Modality::Td),
        (Architecture::paper(), Modality::T),
    ] {
        let network = network(&architecture, modality, &mut draw);
        let written = contract(&architecture, modality, 1.7);
        let bytes = to_onnx(&network, &written).unwrap();
        let (read, found) = from_onnx(&bytes).unwrap();
        assert_eq!(found, written);
        // The temperatures are in the weights already.
        let mut neutral = contract(&architecture, modality, 1.0);
        for output in &mut neutral.fallbacks {
            output.temperature = 1.0;
        }
        let again = to_onnx(&read, &neutral).unwrap();
        let weights = |bytes: &[u8]| onnx::decode(bytes).unwrap().graph.unwrap().initializer;
        assert!(weights(&again) == weights(&bytes));
        let model = Model::from_bytes(&bytes).unwrap();
        for _ in 0..3 {
            let (input, batch) = images(&model, &mut draw);
            let logit = f64::from(read.outputs(&batch).logits[0][0]);
            let expected = 1.0 / (1.0 + (-logit).exp());
            let found = model.predict(&input).unwrap().p_stable;
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
    }
}

#[test]
fn shipped_network_is_read_and_others_are_refused() {
    let shipped = model_bytes(SHIPPED).unwrap();
    let (network, contract) = from_onnx(&shipped).unwrap();
    let gripcast = Architecture::gripcast();
    assert_eq!(network.architecture().convolutions, gripcast.convolutions);
    assert_eq!(contract.name, SHIPPED);
    let heuristic = model_bytes(crate::predict::BASELINE).unwrap();
    let error = from_onnx(&heuristic).unwrap_err();
    assert!(error.what().contains("baseline-contact"), "{error}");
    assert!(from_onnx(b"no model").is_err());
}
