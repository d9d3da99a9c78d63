use super::*;
use crate::fem::{GelPad, GelResolution};
use crate::grasp::{
    GraspOutcome, GraspResult, GraspSettings, Placement, Preset, Scene, resting_pose, simulate,
};
use gripcast_geometry::builtin;

/// A grasp of a mug, in short stages, and the mesh of its gels.
fn grasp() -> (Trace, GelGrid) {
    let (result, grid) = grasp_of("mug", 0.2, 0.006, false);
    (result.trace, grid)
}

fn grasp_of(object: &str, mass_kg: f64, lift_m: f64, early_end: bool) -> (GraspResult, GelGrid) {
    let mesh = builtin(object).unwrap();
    let t_world_object = resting_pose(&mesh, None).unwrap().1.t_world_object;
    let placed = Placement::default().place(&mesh, &t_world_object).unwrap();
    let mut settings = GraspSettings::new(Preset::Paper);
    settings.resolution = GelResolution::Coarse;
    settings.protocol.stop_force_n = 20.0;
    settings.protocol.adjust_s = 0.1;
    settings.protocol.lift_m = lift_m;
    settings.protocol.early_end = early_end;
    let scene = Scene {
        mesh,
        mass_kg,
        friction: 0.6,
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
        gel: settings.gel().unwrap(),
    };
    let result = simulate(&scene, &settings.protocol, &settings.solver).unwrap();
    (result, scene.gel.grid)
}

#[test]
fn record_of_a_lift_is_small_and_gives_its_snapshots_back() {
    let (trace, grid) = grasp();
    let record = GraspRecord::new(&trace, Some(&grid)).unwrap().unwrap();
    let rises: Vec<f64> = record.states.iter().map(|s| 1e3 * s.lifted_m).collect();
    let expected = [0.0, 0.8, 1.6, 2.4, 3.2, 4.0, 4.8, 5.6];
    assert_eq!(rises.len(), expected.len(), "{rises:?}");
    for (rise, expected) in rises.iter().zip(expected) {
        assert!((rise - expected).abs() < 1e-6, "{rises:?}");
    }
    let bytes = record.to_bytes().unwrap();
    let back = GraspRecord::from_bytes(&bytes).unwrap();
    let snapshots = trace
        .snapshots
        .iter()
        .filter(|s| s.stage == StageName::Adjustment);
    for (state, snapshot) in snapshots.chain(&trace.lift_snapshots).enumerate() {
        let found = back.snapshot(state, Some(&grid)).unwrap();
        for (found, expected) in [
            (found.t_world_object, snapshot.t_world_object),
            (found.t_world_gripper, snapshot.t_world_gripper),
        ] {
            assert!(found.translation_m.distance(expected.translation_m) < 3e-8);
            assert!(found.rotation_from(&expected).length() < 1e-6);
        }
        for (found, nodes) in found.gels.iter().zip(&snapshot.gels) {
            for node in front(&grid) {
                let [a, b] = [found[node], nodes[node]].map(DVec3::from_array);
                assert!(a.distance(b) < 1.8e-6, "{a} {b}");
            }
        }
    }
    let force = back.states[6].force[0].normal_n;
    assert!((force - 20.0).abs() < 4.0, "{force}");
}

#[test]
fn trace_without_a_lift_or_with_another_mesh_has_no_record() {
    let (mut trace, _) = grasp();
    let other = GelPad::default().grid(GelResolution::Default).unwrap();
    let error = GraspRecord::new(&trace, Some(&other)).unwrap_err();
    assert!(
        error.to_string().contains("nodes of the gel mesh"),
        "{error}"
    );
    trace.snapshots.clear();
    assert_eq!(GraspRecord::new(&trace, Some(&other)).unwrap(), None);
}

#[test]
fn damaged_bytes_are_refused() {
    let (trace, grid) = grasp();
    let record = GraspRecord::new(&trace, Some(&grid)).unwrap().unwrap();
    let bytes = record.to_bytes().unwrap();
    for damaged in [&bytes[..bytes.len() / 2], &[], &[1, 2, 3]] {
        let error = GraspRecord::from_bytes(damaged).unwrap_err().to_string();
        assert!(error.contains("damaged"), "{error}");
    }
    let mut inflated = Vec::new();
    DeflateDecoder::new(bytes.as_slice())
        .read_to_end(&mut inflated)
        .unwrap();
    let deflated = |bytes: &[u8]| {
        let mut encoder = DeflateEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    };
    let mut other = inflated.clone();
    other.push(0);
    let error = GraspRecord::from_bytes(&deflated(&other)).unwrap_err();
    assert!(
        error.to_string().contains("after its last state"),
        "{error}"
    );
    let mut other = inflated;
    // The quaternion of the gripper.
    other[30..62].fill(0);
    let error = GraspRecord::from_bytes(&deflated(&other)).unwrap_err();
    assert!(error.to_string().contains("pose"), "{error}");
}

#[test]
fn integers_of_any_size_round_trip() {
    for value in [0, 1, -1, 63, -64, 64, 1_000_000, -123_456_789] {
        let mut bytes = Vec::new();
        push_integer(&mut bytes, value);
        assert_eq!(take_integer(&mut bytes.as_slice()).unwrap(), value);
    }
    assert!(take_integer(&mut [0xff_u8; 12].as_slice()).is_err());
}

#[test]
fn early_end_keeps_outcome_record_and_the_steps_before() {
    let cases = [
        ("mug", 0.2, GraspOutcome::Success),
        ("sphere", 2.8, GraspOutcome::Slip),
    ];
    for (object, mass_kg, outcome) in cases {
        let (full, grid) = grasp_of(object, mass_kg, 0.05, false);
        let (early, _) = grasp_of(object, mass_kg, 0.05, true);
        assert_eq!((full.outcome, early.outcome), (outcome, outcome));
        let count = early.trace.steps.len();
        assert!(count < full.trace.steps.len(), "{outcome:?}: {count} steps");
        assert_eq!(early.trace.steps, full.trace.steps[..count]);
        let record = |result: &GraspResult| GraspRecord::new(&result.trace, Some(&grid)).unwrap();
        let (early, full) = (record(&early).unwrap(), record(&full).unwrap());
        let (count, rise_m) = (
            early.states.len(),
            early.states[early.states.len() - 1].lifted_m,
        );
        assert_eq!(early.states, full.states[..count]);
        assert!((5e-3..=20e-3).contains(&rise_m), "{outcome:?}: {rise_m} m");
        let bytes = early.to_bytes().unwrap().len();
        assert!(
            bytes <= 8192 || outcome == GraspOutcome::Slip,
            "{outcome:?}: {bytes} bytes"
        );
    }
}
