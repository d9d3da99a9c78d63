use std::sync::Arc;

use glam::DVec3;

use super::*;
use crate::FemEngine;
use crate::fem::GelResolution;
use crate::grasp::{GraspOutcome, GraspSettings, Placement, Preset, StageName};
use gripcast_base::random::SeedStream;
use gripcast_geometry::{Pose, builtin};
use gripcast_testing::shuffled_mesh::shuffle_mesh;

/// A built-in mesh in its own orientation, gripped centrally from above.
fn setup(name: &str) -> GraspSetup {
    let mesh = builtin(name).unwrap();
    let t_world_object = Pose::from_translation(DVec3::Z * -mesh.bounds().min.z);
    let placed = Placement::default().place(&mesh, &t_world_object).unwrap();
    GraspSetup {
        mesh: Arc::new(mesh),
        mass_kg: 0.05,
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
    }
}

fn engine() -> RigidEngine {
    let mut settings = RigidSettings::default();
    settings.decomposition.resolution = 32;
    RigidEngine::new(settings)
}

fn world(setup: &GraspSetup, engine: &RigidEngine, friction: f64, force_n: f64) -> World {
    let pieces = engine.decomposition(&setup.mesh).unwrap();
    let world = WorldSetup {
        grasp: setup,
        pieces: &pieces,
        opening_m: setup.opening_m,
        friction,
        force_n,
    };
    World::new(&world, &engine.settings).unwrap()
}

/// Rotation (rad) and shift (m) between two poses.
fn moved(a: &Pose, b: &Pose) -> (f64, f64) {
    (
        a.rotation_from(b).length(),
        a.translation_m.distance(b.translation_m),
    )
}

#[test]
fn box_gripped_with_40_n_neither_creeps_nor_jitters() {
    let engine = engine();
    let setup = setup("box");
    let mut world = world(&setup, &engine, 0.4, 40.0);
    for _ in 0..120 {
        world.tick(0.0);
    }
    // Lifted off the ground: only the fingers hold the box.
    for _ in 0..60 {
        world.tick(0.18);
    }
    for _ in 0..120 {
        world.tick(0.0);
    }
    let start = world.t_world_object();
    let (mut max_speed, mut max_angular_speed) = (0.0_f64, 0.0_f64);
    for _ in 0..10 * 240 {
        world.tick(0.0);
        let (speed, angular_speed) = world.object_speed();
        max_speed = max_speed.max(speed);
        max_angular_speed = max_angular_speed.max(angular_speed);
        for force in world.forces() {
            assert!((force.normal_n - 40.0).abs() < 0.4, "{force:?}");
        }
    }
    let (rotated, shifted) = moved(&world.t_world_object(), &start);
    let shift = world.t_world_object().translation_m - start.translation_m;
    println!(
        "drift {shift} m, {rotated:e} rad; speed {max_speed:e} m/s, {max_angular_speed:e} rad/s"
    );
    assert!(shifted < 1e-4, "crept by {shifted} m");
    assert!(rotated < 1e-3, "rotated by {rotated} rad");
    assert!(max_speed < 1e-4, "moved at {max_speed} m/s");
    assert!(
        max_angular_speed < 1e-2,
        "rotated at {max_angular_speed} rad/s"
    );
    // Both fingers carry the weight together.
    let shear: f64 = world.forces().iter().map(|f| f.shear_n[1]).sum();
    let weight = 0.05 * 9.81;
    // The gripper points down: the object pulls the fingers along the gripper's z axis.
    assert!(
        (shear - weight).abs() < 0.02 * weight,
        "{shear} N of {weight} N"
    );
    let gaps = world.gaps_m();
    assert!(gaps.iter().all(|gap| gap.unwrap() > -3e-4), "{gaps:?}");
}

#[test]
fn ungripped_objects_rest() {
    let engine = engine();
    for shape in ["box", "cylinder"] {
        let mut setup = setup(shape);
        setup.opening_m = 0.2;
        let mut world = world(&setup, &engine, 0.4, 1e-6);
        let start = world.t_world_object();
        for _ in 0..480 {
            world.tick(0.0);
        }
        let (rotated, shifted) = moved(&world.t_world_object(), &start);
        assert!(
            shifted < 1e-4 && rotated < 1e-3,
            "{shape}: {shifted} m, {rotated} rad"
        );
        let (speed, angular_speed) = world.object_speed();
        assert!(
            speed < 1e-5 && angular_speed < 1e-4,
            "{shape}: {speed} m/s, {angular_speed} rad/s"
        );
    }
}

#[test]
fn friction_and_force_decide_the_outcome() {
    let engine = engine();
    let setup = setup("box");
    let held = engine.simulate(&setup, 0.4, 10.0).unwrap();
    assert_eq!(held.outcome, GraspOutcome::Success);
    assert!((held.lifted_m - 0.18).abs() < 2e-3, "{}", held.lifted_m);
    let force = held.trace.mean_force(StageName::Adjustment, 20).unwrap();
    assert!((force - 10.0).abs() < 0.1, "{force}");
    // 2 · 0.05 · 2 N of friction against 0.49 N.
    let dropped = engine.simulate(&setup, 0.05, 2.0).unwrap();
    assert_eq!(dropped.outcome, GraspOutcome::Slip);
    assert!(dropped.lifted_m < 0.01, "{}", dropped.lifted_m);
}

#[test]
fn trace_has_all_stages() {
    let result = engine().simulate(&setup("box"), 0.4, 20.0).unwrap();
    let trace = &result.trace;
    let steps = |stage| trace.stage(stage).count();
    assert_eq!(
        [StageName::Closure, StageName::Adjustment, StageName::Lift].map(steps),
        [130, 20, 60]
    );
    let stages: Vec<StageName> = trace.snapshots.iter().map(|s| s.stage).collect();
    assert_eq!(
        stages,
        [StageName::Closure, StageName::Adjustment, StageName::Lift]
    );
    assert!(
        trace
            .snapshots
            .iter()
            .all(|s| s.gels.iter().all(Vec::is_empty))
    );
    let last = &trace.snapshots[2];
    assert!((last.opening_m - 0.04).abs() < 5e-4, "{}", last.opening_m);
    assert!((last.t_s - (150.0 + 240.0) / 240.0).abs() < 1e-9);
    let raised =
        last.t_world_gripper.translation_m.z - trace.snapshots[0].t_world_gripper.translation_m.z;
    assert!((raised - 0.18).abs() < 1e-9);
    let first = &trace.steps[0];
    assert!(first.opening_m < 0.09 && first.opening_m > 0.09 - 0.2 / 240.0);
    assert_eq!(first.min_gap_m, [None, None]);
}

#[test]
fn gripper_beside_the_object_misses() {
    let mut setup = setup("box");
    setup.t_world_gripper.translation_m.y += 0.05;
    let result = engine().simulate(&setup, 0.4, 10.0).unwrap();
    assert_eq!(result.outcome, GraspOutcome::Miss);
    assert_eq!(result.trace.stage(StageName::Lift).count(), 0);
    let last = result.trace.steps.last().unwrap();
    assert!(last.opening_m.abs() < 5e-4, "{}", last.opening_m);
}

#[test]
fn sphere_gripped_off_centre_is_ejected() {
    let mut setup = setup("sphere");
    setup.t_world_gripper.translation_m.y += 0.027;
    let result = engine().simulate(&setup, 0.1, 10.0).unwrap();
    assert_eq!(result.outcome, GraspOutcome::Eject);
}

#[test]
fn initial_penetration_is_an_outcome() {
    let engine = engine();
    let mut narrow = setup("box");
    narrow.t_world_gripper.translation_m.x += 0.045;
    narrow.opening_m = 0.1;
    let result = engine.simulate(&narrow, 0.4, 10.0).unwrap();
    assert_eq!(result.outcome, GraspOutcome::PenetratingStart);
    assert_eq!(
        result.detail.as_deref(),
        Some("the left finger is inside the object")
    );
    let mut low = setup("box");
    low.t_world_gripper.translation_m.z = 0.01;
    let result = engine.simulate(&low, 0.4, 10.0).unwrap();
    assert_eq!(result.outcome, GraspOutcome::PenetratingStart);
    assert!(result.detail.unwrap().contains("2.5 mm below the ground"));
    assert!(result.trace.steps.is_empty());
}

#[test]
fn fingers_without_clearance_start_at_the_given_opening() {
    let mut setup = setup("box");
    // 17 degrees: at 90 mm the lower finger would be in the ground.
    setup.t_world_gripper.rotation *= glam::DQuat::from_rotation_y(0.3);
    setup.t_world_gripper.translation_m.z = 0.022;
    setup.opening_m = 0.055;
    let result = engine().simulate(&setup, 0.4, 10.0).unwrap();
    assert_ne!(result.outcome, GraspOutcome::PenetratingStart);
    assert!(result.trace.steps[0].opening_m < 0.055);
}

#[test]
fn rolled_gripper_lifts_equally_high() {
    let mut setup = setup("box");
    setup.t_world_gripper.rotation *= glam::DQuat::from_rotation_y(0.1);
    let result = engine().simulate(&setup, 0.4, 20.0).unwrap();
    assert_eq!(result.outcome, GraspOutcome::Success);
    assert!((result.lifted_m - 0.18).abs() < 5e-3, "{}", result.lifted_m);
}

#[test]
fn grasp_is_bit_identical_on_any_thread() {
    let engine = engine();
    let mut setup = setup("mug");
    setup.t_world_gripper.rotation *= glam::DQuat::from_rotation_y(0.1);
    let run = || serde_json::to_string(&engine.simulate(&setup, 0.25, 10.0).unwrap()).unwrap();
    let first = run();
    let others = std::thread::scope(|scope| {
        let threads = [scope.spawn(run), scope.spawn(run)];
        threads.map(|t| t.join().unwrap())
    });
    assert!(others.iter().all(|other| *other == first));
    let fresh = super::super::engine::RigidEngine::new(engine.settings);
    let again = fresh.simulate(&setup, 0.25, 10.0).unwrap();
    assert_eq!(serde_json::to_string(&again).unwrap(), first);
}

#[test]
fn invalid_input_is_rejected() {
    let engine = engine();
    let good = setup("box");
    let error_text = |setup: &GraspSetup, friction: f64, force_n: f64| {
        engine
            .simulate(setup, friction, force_n)
            .unwrap_err()
            .to_string()
    };
    assert!(error_text(&good, -0.1, 10.0).contains("friction"));
    assert!(error_text(&good, 0.4, f64::NAN).contains("force"));
    let weightless = GraspSetup {
        mass_kg: 0.0,
        ..good.clone()
    };
    assert!(error_text(&weightless, 0.4, 10.0).contains("mass"));
    let wide = GraspSetup {
        opening_m: 90.0,
        ..good.clone()
    };
    assert!(error_text(&wide, 0.4, 10.0).contains("opening"));
    let mut lost = good.clone();
    lost.t_world_object.translation_m.x = f64::INFINITY;
    assert!(error_text(&lost, 0.4, 10.0).contains("finite"));
    let settings = RigidSettings {
        dt_s: -1.0,
        ..RigidSettings::default()
    };
    let error = RigidEngine::new(settings)
        .simulate(&good, 0.4, 10.0)
        .unwrap_err();
    assert!(error.to_string().contains("dt_s"), "{error}");
}

#[test]
fn parameters_round_trip_as_json() {
    let value = engine().parameters().unwrap();
    assert_eq!(value["closing_steps"], 150);
    assert_eq!(value["decomposition"]["resolution"], 32);
    let back: RigidSettings = serde_json::from_value(value).unwrap();
    assert_eq!(back, engine().settings);
}

/// The same grasp with the object in another file: its frame is moved by `t`, its vertices and
/// triangles are shuffled.
fn refiled(setup: &GraspSetup, t: &Pose, random: &mut SeedStream) -> GraspSetup {
    let mut mesh = setup.mesh.transformed(t);
    let index = |count| random.index(count);
    shuffle_mesh(&mut mesh.vertices, &mut mesh.triangles, index);
    GraspSetup {
        mesh: Arc::new(mesh),
        t_world_object: setup.t_world_object * t.inverse(),
        ..setup.clone()
    }
}

fn random_motion(random: &mut SeedStream) -> Pose {
    let mut vector = |reach: f64| DVec3::from_array([0; 3].map(|_| random.between(-reach, reach)));
    Pose::new(glam::DQuat::from_scaled_axis(vector(3.0)), vector(0.5))
}

fn fem_engine(adjust_s: f64) -> FemEngine {
    let mut settings = GraspSettings::new(Preset::Paper);
    settings.resolution = GelResolution::Coarse;
    settings.protocol.adjust_s = adjust_s;
    FemEngine { settings }
}

/// Checks that random files of the object give the same outcome and the same final pose, up to a
/// tolerance (m), in `count` grasps.
fn assert_invariant(engine: &dyn Engine, setup: &GraspSetup, count: usize, tolerance_m: f64) {
    let mut random = SeedStream::named(35, "files");
    let expected = engine.simulate(setup, 0.4, 10.0).unwrap();
    let end = |result: &GraspResult, setup: &GraspSetup| {
        let last = result.trace.steps.last().unwrap().t_world_object;
        // A point of the object beside its centre.
        (last * setup.t_world_object.inverse()).transform_point(DVec3::new(0.01, 0.02, 0.03))
    };
    let mut worst = 0.0_f64;
    for _ in 0..count {
        let t = random_motion(&mut random);
        let other = refiled(setup, &t, &mut random);
        let found = engine.simulate(&other, 0.4, 10.0).unwrap();
        assert_eq!(found.outcome, expected.outcome, "{t:?}");
        let height = (found.lifted_m - expected.lifted_m).abs();
        worst = worst.max(height);
        worst = worst.max(end(&found, &other).distance(end(&expected, setup)));
    }
    println!("{count} files: states differ by up to {worst:e} m");
    assert!(worst < tolerance_m, "states differ by {worst} m");
}

#[test]
fn outcome_does_not_depend_on_the_file() {
    let engine = engine();
    for (name, count, tolerance_m) in [("box", 150, 1e-4), ("bar", 50, 1e-3), ("mug", 5, 1e-2)] {
        let mut setup = setup(name);
        setup.t_world_gripper.translation_m.y += 0.004;
        assert_invariant(&engine, &setup, count, tolerance_m);
    }
    let mut setup = setup("box");
    setup.t_world_gripper.translation_m.y += 0.004;
    assert_invariant(&fem_engine(0.1), &setup, 3, 1e-5);
}

#[test]
fn rise_is_that_of_the_centre_of_mass() {
    let mut random = SeedStream::named(17, "origin");
    let far = Pose::from_translation(DVec3::new(0.3, -0.2, 1.0));
    let turned = Pose::new(glam::DQuat::from_rotation_x(1.2), DVec3::splat(0.5));
    for t in [Pose::IDENTITY, far, turned] {
        let setup = refiled(&setup("box"), &t, &mut random);
        let rigid = engine().simulate(&setup, 0.4, 10.0).unwrap();
        assert!((rigid.lifted_m - 0.18).abs() < 2e-3, "{}", rigid.lifted_m);
        let fem = fem_engine(0.1).simulate(&setup, 0.4, 10.0).unwrap();
        assert!((fem.lifted_m - 0.05).abs() < 1e-3, "{}", fem.lifted_m);
    }
}
