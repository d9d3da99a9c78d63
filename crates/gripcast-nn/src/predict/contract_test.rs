use gripcast_base::error::ErrorKind;
use tract_onnx::pb::tensor_proto::{DataLocation, DataType};
use tract_onnx::pb::tensor_shape_proto::dimension::Value as Dimension;
use tract_onnx::pb::{GraphProto, ValueInfoProto, type_proto};

use super::*;
use crate::predict::baseline;
use crate::predict::graph_check::bind_dimensions;
use crate::predict::onnx::{self, pb};

const NORMALISATION: RgbNormalisation = RgbNormalisation {
    mean: [0.5, 0.4, 0.3],
    std: [0.2, 0.2, 0.25],
};

fn file() -> ModelProto {
    onnx::decode(&baseline::onnx_bytes().unwrap()).unwrap()
}

fn set(model: &mut ModelProto, key: &str, value: &str) {
    let entries = &mut model.metadata_props;
    let entry = entries.iter_mut().find(|entry| entry.key == key).unwrap();
    entry.value = value.to_owned();
}

/// A change of the valid file, and the expected parts of the error.
type Case = (fn(&mut ModelProto), &'static [&'static str]);

fn refuses(cases: &[Case]) {
    for (damage, expected) in cases {
        let mut model = file();
        damage(&mut model);
        let error = ModelContract::from_proto(&model).expect_err(expected[0]);
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        assert!(error.remedy_text().is_some(), "{error}");
        for text in *expected {
            assert!(error.to_string().contains(text), "`{text}` in: {error}");
        }
    }
}

fn trained(modality: Modality) -> ModelContract {
    let inputs = modality.inputs().into_iter().map(|name| match name {
        InputName::Rgb => InputSpec::rgb(NORMALISATION),
        InputName::Depth => InputSpec::depth(),
        tactile => InputSpec::tactile(tactile),
    });
    ModelContract {
        name: "net".to_owned(),
        origin: Origin::Trained {
            seed: u64::MAX,
            manifest_sha256: "0f".repeat(32),
        },
        modality,
        inputs: inputs.collect(),
        threshold: 0.1 + 0.2,
        temperature: 1.7,
        fallbacks: Vec::new(),
        geometry: Vec::new(),
        contact: Vec::new(),
        crop_profile: Some(CropProfile::GSMINI_SEVENTH),
        card: "# net\n".to_owned(),
        other: [("gripcast.val.auroc".to_owned(), "0.93".to_owned())].into(),
    }
}

/// A graph with the contract's inputs and the constant output 0.5.
fn graph_of(contract: &ModelContract) -> ModelProto {
    let mut graph = OnnxGraphBuilder::new("half");
    contract.write(&mut graph).unwrap();
    for input in &contract.inputs {
        graph.input(input.name.name(), &INPUT_SHAPE).unwrap();
    }
    let zero = graph.constant("zero", &[1, 1], &[0.0]).unwrap();
    let half = graph.node("Sigmoid", OUTPUT, &[&zero], []).unwrap();
    graph.output(&half, &OUTPUT_SHAPE);
    graph.into_proto().unwrap()
}

#[test]
fn contract_round_trips() {
    for modality in [Modality::V, Modality::T, Modality::Vt] {
        let contract = trained(modality);
        assert_eq!(
            ModelContract::from_proto(&graph_of(&contract)).unwrap(),
            contract
        );
    }
    assert_eq!(
        ModelContract::from_proto(&file()).unwrap(),
        baseline::contract()
    );
}

#[test]
fn missing_key_is_refused() {
    let keys: Vec<String> = file().metadata_props.into_iter().map(|e| e.key).collect();
    for key in keys.iter().filter(|key| *key != "gripcast.licence") {
        let mut model = file();
        model.metadata_props.retain(|entry| entry.key != *key);
        let error = ModelContract::from_proto(&model).unwrap_err();
        assert!(
            error.what().contains(&format!("missing key `{key}`")),
            "{error}"
        );
    }
}

#[test]
fn invalid_values_are_refused_with_expected_and_found() {
    refuses(&[
        (
            |m| set(m, "gripcast.schema", "2"),
            &["`gripcast.schema`: expected 1, found 2", "newer"],
        ),
        (
            |m| set(m, "gripcast.schema", "one"),
            &["expected a whole number, found `one`"],
        ),
        (
            |m| set(m, "gripcast.variant", "TV"),
            &["`VD`, `V`, `D`, found `TV`"],
        ),
        (
            |m| set(m, "gripcast.variant", "VT"),
            &[
                "modality VT",
                "`rgb`",
                "found `tactile_left`, `tactile_right`",
            ],
        ),
        (
            |m| set(m, "gripcast.inputs", "[]"),
            &["modality T", "found none"],
        ),
        (
            |m| set(m, "gripcast.inputs", "{"),
            &["invalid `gripcast.inputs`"],
        ),
        (
            |m| set(m, "gripcast.output", "logit"),
            &["expected `p_stable`, found `logit`"],
        ),
        (
            |m| set(m, "gripcast.threshold", "1"),
            &["`gripcast.threshold`", "between 0 and 1, found 1"],
        ),
        (
            |m| set(m, "gripcast.threshold", "NaN"),
            &["between 0 and 1, found NaN"],
        ),
        (
            |m| set(m, "gripcast.threshold", "half"),
            &["expected a number, found `half`"],
        ),
        (
            |m| set(m, "gripcast.temperature", "0"),
            &["`gripcast.temperature`", "found 0"],
        ),
        (
            |m| set(m, "gripcast.kind", "guess"),
            &["expected `trained` or `heuristic`, found `guess`"],
        ),
        (
            |m| set(m, "gripcast.kind", "trained"),
            &["`gripcast.seed`: expected a whole number, found `none`"],
        ),
        (
            |m| set(m, "gripcast.crop_profile", "gsmini-seventh"),
            &[
                "`gripcast.crop_profile`",
                "`gsmini-seventh`",
                "did you mean",
            ],
        ),
        (
            |m| set(m, "gripcast.name", " "),
            &["`gripcast.name` is empty"],
        ),
        (
            |m| m.metadata_props.push(m.metadata_props[0].clone()),
            &["duplicate key"],
        ),
    ]);
}

#[test]
fn inputs_with_other_preprocessing_are_refused() {
    for (field, other, expected) in [
        (
            "\"NCHW\"",
            "\"NHWC\"",
            "expected layout \"NCHW\", found \"NHWC\"",
        ),
        (
            "\"RGB\"",
            "\"BGR\"",
            "expected colour \"RGB\", found \"BGR\"",
        ),
        ("\"f32\"", "\"u8\"", "expected dtype \"f32\", found \"u8\""),
        (
            "grasp-initial",
            "initial-grasp",
            "found \"(initial-grasp)/255\"",
        ),
        ("[1,3,240,320]", "[1,3,320,240]", "found [1, 3, 320, 240]"),
        ("[-1.0,1.0]", "[0.0,1.0]", "expected range"),
        (
            "\"diff\"",
            "\"raw\"",
            "expected encoding \"diff\", found \"raw\"",
        ),
        (
            "tactile_left",
            "tactile_middle",
            "invalid `gripcast.inputs`",
        ),
        ("\"colour\"", "\"color\"", "unknown field `color`"),
    ] {
        let mut model = file();
        let text = serde_json::to_string(&baseline::contract().inputs).unwrap();
        let changed = text.replacen(field, other, 1);
        assert_ne!(changed, text, "{field}");
        set(&mut model, "gripcast.inputs", &changed);
        let error = ModelContract::from_proto(&model).unwrap_err();
        assert!(error.to_string().contains(expected), "{expected}: {error}");
    }
}

fn tensor_of(value: &mut ValueInfoProto) -> &mut type_proto::Tensor {
    let value = value.r#type.as_mut().unwrap().value.as_mut().unwrap();
    let type_proto::Value::TensorType(tensor) = value;
    tensor
}

#[test]
fn graph_that_violates_the_contract_is_refused() {
    fn graph(model: &mut ModelProto) -> &mut GraphProto {
        model.graph.as_mut().unwrap()
    }
    refuses(&[
        (
            |m| graph(m).input[0].name = "left".to_owned(),
            &["inputs of the graph", "found `left`, `tactile_right`"],
        ),
        (
            |m| graph(m).output[0].name = "p".to_owned(),
            &["single output `p_stable` in the graph, found `p`"],
        ),
        (
            |m| {
                open(&mut graph(m).input[0], 2, "side");
                open(&mut graph(m).input[0], 3, "side");
            },
            &[
                "input `tactile_left`",
                "expected shape [1, 3, 240, 320], found [1, 3, `side`, `side`]",
                "one name stands for one size",
            ],
        ),
        (
            |m| tensor_of(&mut graph(m).input[0]).elem_type = DataType::Float16 as i32,
            &[
                "input `tactile_left`",
                "expected 32-bit floats, found Float16",
            ],
        ),
        (
            |m| graph(m).input[0].r#type = None,
            &["input `tactile_left`", "no type"],
        ),
        (
            |m| m.opset_import[0].version = 23,
            &[
                "operator set: expected 7 to 22, found 23",
                "opset_version=17",
            ],
        ),
        (
            |m| m.opset_import.clear(),
            &["operator set: expected 7 to 22, found none"],
        ),
        (
            |m| graph(m).node[0].domain = "com.microsoft".to_owned(),
            &[
                "unsupported operator",
                "of the operator set `com.microsoft`",
            ],
        ),
        (
            |m| graph(m).node[0].op_type = "FancyAct".to_owned(),
            &["unsupported operator `FancyAct` at `tactile_left_patches`"],
        ),
        (
            |m| {
                let node = &mut graph(m).node[0];
                node.op_type = "BatchNormalization".to_owned();
                node.output.push("mean".to_owned());
            },
            &["batch normalisation in training mode", "model.eval()"],
        ),
        (
            |m| graph(m).initializer[0].data_type = DataType::Float16 as i32,
            &["the weights `noise`", "found Float16", "model.float()"],
        ),
        (
            |m| graph(m).initializer[0].data_location = Some(DataLocation::External as i32),
            &["`noise` are in an external file"],
        ),
        (
            |m| {
                let last = graph(m).node.last().unwrap().output[0].clone();
                graph(m).node[0].input[0] = last;
            },
            &["the graph has a cycle", "`tactile_left_patches`"],
        ),
        (
            |m| graph(m).node[0].attribute[1].ints[0] = 0,
            &[
                "`tactile_left_patches` (AveragePool)",
                "`strides`",
                "found 0",
            ],
        ),
        (
            |m| graph(m).node[0].attribute[0].ints[1] = i64::MAX,
            &["expected `kernel_shape` between 1 and 4096"],
        ),
    ]);
}

/// Opens a dimension of a tensor.
fn open(value: &mut ValueInfoProto, dimension: usize, name: &str) {
    let shape = tensor_of(value).shape.as_mut().unwrap();
    shape.dim[dimension].value = match name {
        "-1" => Some(Dimension::DimValue(-1)),
        "" => None,
        name => Some(Dimension::DimParam(name.to_owned())),
    };
}

#[test]
fn open_dimensions_are_bound_to_the_sizes_of_the_contract() {
    for name in ["n", "-1", ""] {
        let mut model = file();
        let graph = model.graph.as_mut().unwrap();
        for value in graph.input.iter_mut().chain(&mut graph.output) {
            open(value, 0, name);
        }
        // All sides of one input, the others are fixed.
        for (dimension, name) in ["c", "h", "w"].into_iter().enumerate() {
            open(&mut graph.input[1], dimension + 1, name);
        }
        let contract = ModelContract::from_proto(&model).unwrap();
        bind_dimensions(model.graph.as_mut().unwrap());
        assert_eq!(model, file(), "{name:?}");
        assert_eq!(ModelContract::from_proto(&model).unwrap(), contract);
    }
}

#[test]
fn constant_that_is_not_finite_is_refused_wherever_it_is() {
    fn floats(name: &str, values: &[f32]) -> pb::TensorProto {
        pb::TensorProto {
            name: name.to_owned(),
            dims: vec![values.len() as i64],
            data_type: DataType::Float as i32,
            float_data: values.to_vec(),
            ..pb::TensorProto::default()
        }
    }
    fn constant(value: pb::AttributeProto) -> pb::NodeProto {
        pb::NodeProto {
            op_type: "Constant".to_owned(),
            output: vec!["extra".to_owned()],
            attribute: vec![value],
            ..pb::NodeProto::default()
        }
    }
    fn attribute(name: &str) -> pb::AttributeProto {
        pb::AttributeProto {
            name: name.to_owned(),
            ..pb::AttributeProto::default()
        }
    }
    fn graph(model: &mut ModelProto) -> &mut GraphProto {
        model.graph.as_mut().unwrap()
    }
    let double = pb::TensorProto {
        name: "wide".to_owned(),
        dims: vec![2],
        data_type: DataType::Double as i32,
        raw_data: [1.0, f64::NAN].map(f64::to_le_bytes).concat(),
        ..pb::TensorProto::default()
    };
    let inner = GraphProto {
        initializer: vec![floats("inner", &[f32::INFINITY])],
        ..GraphProto::default()
    };
    let add = |change: &dyn Fn(&mut GraphProto)| {
        let mut model = file();
        change(graph(&mut model));
        ModelContract::from_proto(&model).unwrap_err().to_string()
    };
    let raw = add(&|g| {
        g.initializer[0].raw_data = f32::NAN.to_le_bytes().to_vec();
    });
    let cases = [
        (raw, "found NaN in the weights `noise`, at index 0"),
        (
            add(&|g| {
                g.initializer
                    .push(floats("more", &[0.0, f32::NAN, f32::NAN]))
            }),
            "found NaN in the weights `more`, at index 1, and 1 more",
        ),
        (
            add(&|g| g.initializer.push(double.clone())),
            "in the weights `wide`, at index 1",
        ),
        (
            add(&|g| {
                g.node.push(constant(pb::AttributeProto {
                    t: Some(floats("", &[f32::NEG_INFINITY])),
                    ..attribute("value")
                }));
            }),
            "found -inf in `value` of `extra` (Constant)",
        ),
        (
            add(&|g| {
                g.node.push(constant(pb::AttributeProto {
                    floats: vec![1.0, f32::NAN],
                    ..attribute("value_floats")
                }));
            }),
            "found NaN in `value_floats` of `extra` (Constant)",
        ),
        (
            add(&|g| {
                g.node.push(constant(pb::AttributeProto {
                    g: Some(inner.clone()),
                    ..attribute("then_branch")
                }));
            }),
            "found inf in the weights `inner`",
        ),
    ];
    for (error, expected) in cases {
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

#[test]
fn stamped_file_of_another_program_has_the_contract() {
    let contract = trained(Modality::Vt);
    let mut foreign = graph_of(&trained(Modality::Vt));
    foreign.metadata_props = vec![
        entry("gripcast.val.auroc", "0.5"),
        entry("gripcast.name", "an older stamp"),
        entry("author", "someone"),
    ];
    let stamped = contract.stamp(&foreign.encode_to_vec()).unwrap();
    let model = onnx::decode(&stamped).unwrap();
    assert_eq!(ModelContract::from_proto(&model).unwrap(), contract);
    assert!(model.metadata_props.contains(&entry("author", "someone")));
    assert_eq!(model.graph, foreign.graph);
    let error = trained(Modality::T).stamp(&stamped).unwrap_err();
    assert!(error.what().contains("inputs of the graph"), "{error}");
}

fn entry(key: &str, value: &str) -> StringStringEntryProto {
    StringStringEntryProto {
        key: key.to_owned(),
        value: value.to_owned(),
    }
}

/// The JSON in the reference is the one that files have.
#[test]
fn readme_states_the_inputs_as_they_are_written() {
    let readme = include_str!(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../models/README.md"
    ));
    let normalisation = RgbNormalisation {
        mean: [0.485, 0.456, 0.406],
        std: [0.229, 0.224, 0.225],
    };
    let inputs = [
        InputSpec::tactile(InputName::TactileLeft),
        InputSpec::tactile(InputName::TactileRight),
        InputSpec::rgb(normalisation),
    ];
    for input in inputs {
        let json = serde_json::to_string(&input).unwrap();
        assert!(readme.contains(&json), "{json}");
    }
}

#[test]
fn constants_listed_as_inputs_are_not_inputs() {
    let mut model = file();
    let graph = model.graph.as_mut().unwrap();
    graph.input.push(pb::ValueInfoProto {
        name: "noise".to_owned(),
        ..pb::ValueInfoProto::default()
    });
    assert!(ModelContract::from_proto(&model).is_ok());
}

#[test]
fn invalid_normalisation_is_refused() {
    for std in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let spec = InputSpec::rgb(RgbNormalisation {
            std: [0.2, std, 0.2],
            ..NORMALISATION
        });
        let error = spec.check().unwrap_err();
        assert!(error.contains("input `rgb`: expected `mean`"), "{error}");
    }
}

#[test]
fn rig_with_other_crop_profile_is_refused() {
    let contract = trained(Modality::T);
    assert!(contract.check_crop_profile("gsmini-seventh-v1").is_ok());
    let text = contract
        .check_crop_profile("gsmini-fifteen-v1")
        .unwrap_err()
        .to_string();
    for expected in [
        "`net`",
        "`gsmini-seventh-v1`",
        "`gsmini-fifteen-v1`",
        "rig file",
    ] {
        assert!(text.contains(expected), "{text}");
    }
    let heuristic = baseline::contract();
    assert!(heuristic.check_crop_profile("gsmini-fifteen-v1").is_ok());
}

#[test]
fn trained_model_with_touch_needs_a_crop_profile() {
    let mut contract = trained(Modality::T);
    contract.crop_profile = None;
    assert!(contract.check().is_err());
    contract.modality = Modality::V;
    contract.inputs = vec![InputSpec::rgb(NORMALISATION)];
    assert!(contract.check().is_ok());
    contract.origin = Origin::Trained {
        seed: 1,
        manifest_sha256: "0F".repeat(32),
    };
    let error = contract.check().unwrap_err();
    assert!(error.what().contains("64 lower-case hex digits"), "{error}");
}
