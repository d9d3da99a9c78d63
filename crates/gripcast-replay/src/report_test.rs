//! The schema of `report.json`, and its serialisation.

use super::*;
use crate::sample_report::sample_report;

/// Checks the keys of `value` against the schema.
fn check(root: &Value, schema: &Value, value: &Value, path: &str) {
    if let Some(reference) = schema["$ref"].as_str() {
        let target = root.pointer(reference.trim_start_matches('#')).unwrap();
        check(root, target, value, path);
    }
    let alternatives = ["anyOf", "oneOf"].map(|key| schema[key].as_array());
    for alternative in alternatives.into_iter().flatten().flatten() {
        let is_null = alternative["type"] == "null";
        if !is_null && !value.is_null() {
            check(root, alternative, value, path);
        }
    }
    for key in schema["required"].as_array().into_iter().flatten() {
        let key = key.as_str().unwrap();
        assert!(value.get(key).is_some(), "{path} lacks {key}");
    }
    let properties = schema["properties"].as_object();
    for (key, inner) in properties.into_iter().flatten() {
        if let Some(inner_value) = value.get(key) {
            check(root, inner, inner_value, &format!("{path}.{key}"));
        }
    }
    if schema["additionalProperties"] == false
        && let (Some(properties), Some(object)) = (properties, value.as_object())
    {
        for key in object.keys() {
            assert!(properties.contains_key(key), "{path} has {key} besides");
        }
    }
    for (i, item) in value.as_array().into_iter().flatten().enumerate() {
        check(root, &schema["items"], item, &format!("{path}[{i}]"));
    }
}

#[test]
fn report_has_the_keys_of_the_schema() {
    let schema = report_schema();
    let mut value = serde_json::to_value(sample_report()).unwrap();
    check(&schema, &schema, &value, "report");
    value["objects"][1]["weight"] = 1.into();
    let refused = std::panic::catch_unwind(|| check(&schema, &schema, &value, "report"));
    assert!(refused.is_err());
}

/// `GRIPCAST_WRITE_SCHEMA=1` updates the file.
#[test]
fn schema_in_docs_is_current() {
    let file = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../docs/reference/replay-report.schema.json"
    );
    let text = format!(
        "{}\n",
        serde_json::to_string_pretty(&report_schema()).unwrap()
    );
    if std::env::var_os("GRIPCAST_WRITE_SCHEMA").is_some() {
        std::fs::write(file, &text).unwrap();
    }
    let written = std::fs::read_to_string(file).unwrap();
    assert!(written == text, "update it with GRIPCAST_WRITE_SCHEMA=1");
}

#[test]
fn every_key_is_described() {
    let schema = report_schema();
    let definitions = schema["$defs"].as_object().unwrap();
    assert!(definitions.len() > 20);
    for (name, definition) in definitions {
        for (key, property) in definition["properties"].as_object().into_iter().flatten() {
            let is_described = property.get("description").is_some();
            assert!(is_described || key == "kind", "{name}.{key}");
        }
    }
}

#[test]
fn report_survives_serialisation() {
    let report = sample_report();
    let text = serde_json::to_string(&report).unwrap();
    assert_eq!(serde_json::from_str::<Report>(&text).unwrap(), report);
    let altered = text.replacen("\"seed\":7", "\"seed\":7,\"sead\":7", 1);
    let error = serde_json::from_str::<Report>(&altered).unwrap_err();
    assert!(error.to_string().contains("sead"));
}
