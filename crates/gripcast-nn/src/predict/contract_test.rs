use gripcast_base::error::ErrorKind;
use tract_onnx::pb::tensor_proto::{DataLocation, DataType};
use tract_onnx::pb::tensor_shape_proto::dimension::Value as Dimension;
use tract_onnx::pb::{GraphProto, ValueInfoProto, type_proto};

use super::*;
use crate::predict::baseline;
use crate::predict::graph_check::close_batch;
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

/// A change of the sound file, and what the refusal must say.
type Case = (fn(&mut ModelProto), &'static [&'static str]);

fn refuses(cases: &[Case]) {
    for (damage, expected) in cases {
        let mut model = file();
        damage(&mut model);
        let error = ModelContract::of(&model).expect_err(expected[0]);
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        assert!(error.remedy_text().is_some(), "{error}");
        for part in *expected {
            assert!(error.to_string().contains(part), "`{part}` in: {error}");
        }
    }
}

fn trained(variant: Variant) -> ModelContract {
    let inputs = variant.inputs().iter().map(|&name| match name {
        InputName::Rgb => InputSpec::rgb(NORMALISATION),
        tactile => InputSpec::tactile(tactile),
    });
    ModelContract {
        name: "net".to_owned(),
        origin: Origin::Trained {
            seed: u64::MAX,
            manifest_sha256: "0f".repeat(32),
        },
        variant,
        inputs: inputs.collect(),
        threshold: 0.1 + 0.2,
        temperature: 1.7,
        crop_profile: Some(CropProfile::GSMINI_SEVENTH),
        card: "# net\n".to_owned(),
        other: [("gripcast.val.auroc".to_owned(), "0.93".to_owned())].into(),
    }
}

/// A graph with the contract's inputs that answers one half.
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
fn what_is_written_is_read_back() {
    for variant in [Variant::V, Variant::T, Variant::Vt] {
        let contract = trained(variant);
        assert_eq!(ModelContract::of(&graph_of(&contract)).unwrap(), contract);
    }
    assert_eq!(ModelContract::of(&file()).unwrap(), baseline::contract());
}

#[test]
fn every_key_is_needed() {
    let keys: Vec<String> = file().metadata_props.into_iter().map(|e| e.key).collect();
    for key in keys.iter().filter(|key| *key != "gripcast.licence") {
        let mut model = file();
        model.metadata_props.retain(|entry| entry.key != *key);
        let error = ModelContract::of(&model).unwrap_err();
        assert!(error.what().contains(&format!("no key `{key}`")), "{error}");
    }
}

#[test]
fn wrong_values_are_refused_with_key_expected_and_found() {
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
            &["expected V, T or VT, found `TV`"],
        ),
        (
            |m| set(m, "gripcast.variant", "VT"),
            &[
                "variant VT",
                "`rgb`",
                "found `tactile_left`, `tactile_right`",
            ],
        ),
        (
            |m| set(m, "gripcast.inputs", "[]"),
            &["variant T", "found none"],
        ),
        (
            |m| set(m, "gripcast.inputs", "{"),
            &["`gripcast.inputs` is no list"],
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
            &["twice"],
        ),
    ]);
}

#[test]
fn inputs_that_are_made_in_another_way_are_refused() {
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
            "`gripcast.inputs` is no list",
        ),
        ("\"colour\"", "\"color\"", "unknown field `color`"),
    ] {
        let mut model = file();
        let text = serde_json::to_string(&baseline::contract().inputs).unwrap();
        let changed = text.replacen(field, other, 1);
        assert_ne!(changed, text, "{field}");
        set(&mut model, "gripcast.inputs", &changed);
        let error = ModelContract::of(&model).unwrap_err();
        assert!(error.to_string().contains(expected), "{expected}: {error}");
    }
}

fn tensor_of(value: &mut ValueInfoProto) -> &mut type_proto::Tensor {
    let value = value.r#type.as_mut().unwrap().value.as_mut().unwrap();
    let type_proto::Value::TensorType(tensor) = value;
    tensor
}

#[test]
fn a_graph_that_breaks_the_contract_is_refused() {
    fn graph(model: &mut ModelProto) -> &mut GraphProto {
        model.graph.as_mut().unwrap()
    }
    refuses(&[
        (
            |m| graph(m).input[0].name = "left".to_owned(),
            &[
                "disagree on the inputs",
                "the graph has `left`, `tactile_right`",
            ],
        ),
        (
            |m| graph(m).output[0].name = "p".to_owned(),
            &["one output `p_stable`, found `p`"],
        ),
        (
            |m| {
                let shape = tensor_of(&mut graph(m).input[1]).shape.as_mut().unwrap();
                shape.dim[0].value = Some(Dimension::DimParam("batch".to_owned()));
            },
            &[
                "input `tactile_right`",
                "found [`batch`, 3, 240, 320]",
                "fixed",
            ],
        ),
        (
            |m| {
                let shape = tensor_of(&mut graph(m).input[0]).shape.as_mut().unwrap();
                shape.dim[0].value = Some(Dimension::DimParam("batch".to_owned()));
            },
            &[
                "input `tactile_right`",
                "expected shape [`batch`, 3, 240, 320], found [1, 3, 240, 320]",
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
            |m| m.opset_import[0].version = 22,
            &["operator set: expected 9 to 18, found 22", "opset 17"],
        ),
        (
            |m| m.opset_import.clear(),
            &["operator set: expected 9 to 18, found none"],
        ),
        (
            |m| m.opset_import[0].domain = "com.microsoft".to_owned(),
            &["the operator set `com.microsoft` 17"],
        ),
        (
            |m| graph(m).initializer[0].data_location = Some(DataLocation::External as i32),
            &["`noise` are in another file"],
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

#[test]
fn an_open_batch_is_taken_and_closed_for_the_engine() {
    let mut model = file();
    let graph = model.graph.as_mut().unwrap();
    for value in graph.input.iter_mut().chain(&mut graph.output) {
        let shape = tensor_of(value).shape.as_mut().unwrap();
        shape.dim[0].value = Some(Dimension::DimParam("n".to_owned()));
    }
    let contract = ModelContract::of(&model).unwrap();
    close_batch(model.graph.as_mut().unwrap());
    assert_eq!(model, file());
    assert_eq!(ModelContract::of(&model).unwrap(), contract);
}

#[test]
fn constants_listed_as_inputs_are_not_inputs() {
    let mut model = file();
    let graph = model.graph.as_mut().unwrap();
    graph.input.push(pb::ValueInfoProto {
        name: "noise".to_owned(),
        ..pb::ValueInfoProto::default()
    });
    assert!(ModelContract::of(&model).is_ok());
}

#[test]
fn statistics_that_cannot_normalise_are_refused() {
    for std in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let spec = InputSpec::rgb(RgbNormalisation {
            std: [0.2, std, 0.2],
            ..NORMALISATION
        });
        let error = spec.check().unwrap_err();
        assert!(error.contains("input `rgb` needs `mean`"), "{error}");
    }
}

#[test]
fn a_rig_with_another_crop_is_refused() {
    let contract = trained(Variant::T);
    assert!(contract.check_crop_profile("gsmini-seventh-v1").is_ok());
    let text = contract
        .check_crop_profile("gsmini-fifteen-v1")
        .unwrap_err()
        .to_string();
    for part in [
        "`net`",
        "`gsmini-seventh-v1`",
        "`gsmini-fifteen-v1`",
        "rig file",
    ] {
        assert!(text.contains(part), "{text}");
    }
    let heuristic = baseline::contract();
    assert!(heuristic.check_crop_profile("gsmini-fifteen-v1").is_ok());
}

#[test]
fn a_trained_model_with_touch_cannot_fit_any_crop() {
    let mut contract = trained(Variant::T);
    contract.crop_profile = None;
    assert!(contract.check().is_err());
    contract.variant = Variant::V;
    contract.inputs = vec![InputSpec::rgb(NORMALISATION)];
    assert!(contract.check().is_ok());
    contract.origin = Origin::Trained {
        seed: 1,
        manifest_sha256: "0F".repeat(32),
    };
    let error = contract.check().unwrap_err();
    assert!(error.what().contains("64 lower-case hex digits"), "{error}");
}
