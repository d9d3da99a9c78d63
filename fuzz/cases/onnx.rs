//! ONNX files and the model contract in their metadata.
//!
//! Input: a whole file, or after a zero byte lines `key=value` that replace those of a sound model.

use std::sync::OnceLock;

use gripcast_nn::predict::onnx::{decode, pb};
use gripcast_nn::predict::{ModelContract, OodDetector, SHIPPED, model_bytes};

/// The shipped model without its weights.
fn sound() -> &'static pb::ModelProto {
    static SOUND: OnceLock<pb::ModelProto> = OnceLock::new();
    SOUND.get_or_init(|| {
        let bytes = model_bytes(SHIPPED).expect("the shipped model");
        let mut model = decode(&bytes).expect("the shipped model is sound");
        if let Some(graph) = &mut model.graph {
            graph.initializer.clear();
        }
        model
    })
}

/// Panics where something is wrong.
pub(crate) fn check(input: &[u8]) {
    match input {
        [0, lines @ ..] => {
            let Ok(lines) = std::str::from_utf8(lines) else {
                return;
            };
            let mut model = sound().clone();
            for (key, value) in lines.lines().filter_map(|line| line.split_once('=')) {
                model.metadata_props.retain(|entry| entry.key != key);
                model.metadata_props.push(pb::StringStringEntryProto {
                    key: key.to_owned(),
                    value: value.to_owned(),
                });
            }
            read_contract(&model);
        }
        file => {
            if let Ok(model) = decode(file) {
                read_contract(&model);
            }
        }
    }
}

fn read_contract(model: &pb::ModelProto) {
    let Ok(contract) = ModelContract::from_proto(model) else {
        return;
    };
    let _ = contract.check_crop_profile("gsmini-v1");
    for text in contract.other.values() {
        let _ = OodDetector::from_metadata(text);
    }
}
