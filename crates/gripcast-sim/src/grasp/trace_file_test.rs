use super::*;
use crate::grasp::sample_trace;
use gripcast_base::error::ErrorKind;

fn file() -> TraceFile {
    TraceFile {
        header: serde_json::json!({"outcome": "success", "lifted_m": 0.05}),
        trace: sample_trace(),
    }
}

#[test]
fn binary_trace_round_trips_bit_for_bit() {
    let file = file();
    let bytes = file.to_bytes().unwrap();
    let back = TraceFile::from_bytes(&bytes).unwrap();
    assert_eq!(back.header, file.header);
    assert_eq!(back.trace, file.trace);
    assert_eq!(back.to_bytes().unwrap(), bytes);
    assert!(back.trace.steps.iter().any(|step| step.solver.is_none()));
    assert!(back.trace.steps.iter().any(|step| step.solver.is_some()));
}

#[test]
fn binary_layout_matches_the_documentation() {
    let file = file();
    let bytes = file.to_bytes().unwrap();
    let header = serde_json::to_vec(&file.header).unwrap();
    assert_eq!(bytes[..8], MAGIC);
    assert_eq!(bytes[8..12], 1u32.to_le_bytes());
    assert_eq!(bytes[28..32], 184u32.to_le_bytes());
    let first = 32 + header.len();
    let time = f64::from_le_bytes(bytes[first + 24..first + 32].try_into().unwrap());
    assert_eq!(time, file.trace.steps[0].t_s);
    let normal = f64::from_le_bytes(bytes[first + 48..first + 56].try_into().unwrap());
    assert_eq!(normal, file.trace.steps[0].force[0].normal_n);
    let nodes: usize = file
        .trace
        .snapshots
        .iter()
        .map(|s| s.gels[0].len() + s.gels[1].len())
        .sum();
    let expected =
        first + 184 * file.trace.steps.len() + 144 * file.trace.snapshots.len() + 24 * nodes;
    assert_eq!(bytes.len(), expected);
}

#[test]
fn truncated_binary_trace_is_rejected() {
    let bytes = file().to_bytes().unwrap();
    for length in (0..bytes.len()).step_by(7).chain([bytes.len() - 1]) {
        let error = TraceFile::from_bytes(&bytes[..length]).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.to_string().contains("truncated after"), "{error}");
    }
}

#[test]
fn foreign_newer_and_overlong_files_are_rejected() {
    let text = TraceFile::from_bytes(b"{\"steps\": []}").unwrap_err();
    assert!(text.to_string().contains("not a grasp trace"), "{text}");
    let mut bytes = file().to_bytes().unwrap();
    bytes.push(0);
    let text = TraceFile::from_bytes(&bytes).unwrap_err();
    assert!(text.to_string().contains("1 bytes after the end"), "{text}");
    bytes.pop();
    bytes[8] = 3;
    let text = TraceFile::from_bytes(&bytes).unwrap_err();
    assert!(text.to_string().contains("found 3"), "{text}");
    bytes[8] = 1;
    // A count far beyond the file must not reserve memory for it.
    bytes[16..24].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(TraceFile::from_bytes(&bytes).is_err());
}

#[test]
fn json_trace_has_result_steps_and_snapshots() {
    let file = file();
    let value: Value = serde_json::from_slice(&file.to_json().unwrap()).unwrap();
    assert_eq!(value["format"], "gripcast-trace");
    assert_eq!(value["result"], file.header);
    let steps = value["steps"].as_array().unwrap();
    assert_eq!(steps.len(), file.trace.steps.len());
    assert_eq!(steps[0]["stage"], "closure");
    assert_eq!(
        steps[3]["force"][1]["normal_n"],
        file.trace.steps[3].force[1].normal_n
    );
    assert_eq!(value["snapshots"][1]["stage"], "adjustment");
}

#[test]
fn json_trace_round_trips() {
    let file = file();
    let bytes = file.to_json().unwrap();
    let back = TraceFile::read(&bytes).unwrap();
    assert_eq!(back.header, file.header);
    assert_eq!(back.trace.steps.len(), file.trace.steps.len());
    for (back, wrote) in back.trace.steps.iter().zip(&file.trace.steps) {
        assert_eq!(back.force, wrote.force);
        assert_eq!(back.solver, wrote.solver);
        let (b, w) = (back.t_world_object, wrote.t_world_object);
        assert_eq!(b.translation_m, w.translation_m);
        assert!(b.rotation.dot(w.rotation).abs() > 1.0 - 1e-12);
    }
    for (back, wrote) in back.trace.snapshots.iter().zip(&file.trace.snapshots) {
        assert_eq!(back.gels, wrote.gels);
    }
    let binary = TraceFile::read(&file.to_bytes().unwrap()).unwrap();
    assert_eq!(binary.trace, file.trace);
}

#[test]
fn foreign_and_damaged_json_is_rejected() {
    let other = TraceFile::read(br#"{"outcome": "success"}"#).unwrap_err();
    assert!(other.to_string().contains("not a grasp trace"), "{other}");
    let newer = br#"{"format": "gripcast-trace", "version": 9}"#;
    let newer = TraceFile::read(newer).unwrap_err();
    assert!(newer.to_string().contains("found 9"), "{newer}");
    let cut = br#"{"format": "gripcast-trace", "version": 1, "result": {}, "steps": [{}]}"#;
    let cut = TraceFile::read(cut).unwrap_err();
    assert!(cut.to_string().contains("damaged"), "{cut}");
}
