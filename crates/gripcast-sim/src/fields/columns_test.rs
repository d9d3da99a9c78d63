use super::*;
use crate::fields::Wrench;
use crate::grasp::{TraceFile, sample_trace};

fn series() -> FieldSeries {
    let mesh = FaceMesh {
        x_m: vec![-0.01, 0.0, 0.01],
        y_m: vec![-0.005, 0.005],
        thickness_m: 0.004,
        area_m2: vec![1e-5, 2e-5, 1e-5, 2e-5, 1e-5, 2e-5],
    };
    let field = |seed: f32| {
        let vectors = |scale: f32| -> Vec<[f32; 3]> {
            let vector = |k: u16| [0.0, 1.0, 2.0].map(|a| scale * (seed + a + 3.0 * f32::from(k)));
            (0..6).map(vector).collect()
        };
        let wrench = |scale: f64| Wrench {
            force_n: [scale, 2.0, f64::from(seed)],
            torque_n_m: [4.0, scale, 6.0],
        };
        FaceField {
            displacement_m: vectors(1e-5),
            traction_pa: vectors(1e3),
            contact: NodeContact::ALL.repeat(2),
            resultant: wrench(1.0),
            sides: wrench(7.0),
        }
    };
    let step = |step: u32, stage| FieldStep {
        step,
        stage,
        t_s: 0.01 * f64::from(step + 1),
        gels: vec![field(1.0), field(f32::from(step as u8))],
    };
    FieldSeries {
        mesh,
        gels: 2,
        eps_v_m_s: 1e-3,
        steps: vec![step(0, Some(StageName::Closure)), step(10, None)],
    }
}

fn file() -> TraceFile {
    let mut trace = sample_trace();
    trace.fields = Some(series());
    TraceFile {
        header: serde_json::json!({"outcome": "success"}),
        trace,
    }
}

#[test]
fn fields_round_trip_in_a_binary_trace_only() {
    let file = file();
    let bytes = file.to_bytes().unwrap();
    let back = TraceFile::read(&bytes).unwrap();
    assert_eq!(back.header, file.header);
    assert_eq!(back.trace, file.trace);
    assert_eq!(back.to_bytes().unwrap(), bytes);
    let error = file.to_json().unwrap_err().to_string();
    assert!(error.contains(".bin"), "{error}");
}

#[test]
fn records_have_the_described_layout() {
    let series = series();
    let description = series.description();
    let mut bytes = Vec::new();
    series.write(&mut bytes);
    let size = 16 + 4 * 2 * 3 * 8 + 2 * (2 * 6 * 3 * 4) + 2 * 6;
    assert_eq!(description["record_bytes"], size);
    assert_eq!(bytes.len(), 2 * size);
    // Right gel, node (2, 1), z of the displacement in the second record.
    let at = size + 16 + 4 * 2 * 3 * 8 + 4 * (3 * (6 + 5) + 2);
    let found = f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!(found, series.steps[1].gels[1].displacement_m[5][2]);
    assert_eq!(bytes[2 * size - 1], NodeContact::Slip as u8);
}

#[test]
fn damaged_fields_are_explained() {
    let bytes = file().to_bytes().unwrap();
    let truncated = TraceFile::read(&bytes[..bytes.len() - 1]).unwrap_err();
    assert!(truncated.to_string().contains("records"), "{truncated}");
    let mut unknown = bytes.clone();
    *unknown.last_mut().unwrap() = 9;
    let error = TraceFile::read(&unknown).unwrap_err().to_string();
    assert!(error.contains("contact state 9"), "{error}");
    let mut description = series().description();
    description["gels"] = serde_json::json!(u64::MAX);
    let error = FieldSeries::read(&description, &[]).unwrap_err();
    assert!(error.to_string().contains("gels"), "{error}");
}
