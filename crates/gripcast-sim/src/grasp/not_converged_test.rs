use std::sync::atomic::AtomicBool;

use super::{
    GelSpec, GraspOutcome, GraspPose, GraspStart, Placement, Protocol, Scene, resting_pose,
    simulate, simulate_until,
};
use crate::fem::{GelGrid, GelResolution};
use crate::solver::SolverParameters;
use gripcast_base::error::ErrorKind;
use gripcast_geometry::builtin;

fn small_box() -> Scene {
    let mesh = builtin("box").unwrap();
    let t_world_object = resting_pose(&mesh, None).unwrap().1.t_world_object;
    let placed = Placement::default().place(&mesh, &t_world_object).unwrap();
    let mut gel = GelSpec::standard(GelResolution::Coarse).unwrap();
    gel.grid = GelGrid::uniform([5, 5, 3], [0.025, 0.020, 0.004]).unwrap();
    Scene {
        mesh,
        mass_kg: 0.06,
        friction: 0.4,
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
        gel,
    }
}

#[test]
fn unconverged_steps_give_no_outcome() {
    let parameters = SolverParameters {
        max_iterations: 1,
        ..Default::default()
    };
    let result = simulate(&small_box(), &Protocol::default(), &parameters).unwrap();
    assert_eq!(result.outcome, GraspOutcome::NotConverged);
    assert!(result.unconverged_steps > 1);
    let detail = result.detail.unwrap();
    assert!(detail.contains("did not converge"), "{detail}");
}

#[test]
fn grasp_stops_at_its_iteration_limit() {
    let parameters = SolverParameters {
        max_grasp_iterations: 20,
        ..Default::default()
    };
    let result = simulate(&small_box(), &Protocol::default(), &parameters).unwrap();
    assert_eq!(result.outcome, GraspOutcome::NotConverged);
    assert_eq!(result.detail.unwrap(), "stopped after 20 iterations");
    let iterations = result.trace.steps.iter().filter_map(|step| step.solver);
    let spent: u32 = iterations.map(|step| step.iterations).sum();
    assert!((21..100).contains(&spent), "{spent}");
}

#[test]
fn cancelled_grasp_has_no_result() {
    let (protocol, parameters) = (Protocol::default(), SolverParameters::default());
    let cancelled = AtomicBool::new(true);
    let error = simulate_until(&small_box(), &protocol, &parameters, None, &cancelled).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Interrupted);
}

#[test]
fn recorded_object_pose_contradicts_a_stable_pose() {
    let scene = small_box();
    let pose = GraspPose {
        t_object_gripper: scene.t_world_object.inverse() * scene.t_world_gripper,
        t_world_object: Some(scene.t_world_object),
        opening_m: None,
    };
    let start = GraspStart::recorded(&scene.mesh, None, &pose, 0.09).unwrap();
    assert_eq!((start.stable_pose, start.warnings.len()), (None, 0));
    let error = GraspStart::recorded(&scene.mesh, Some(0), &pose, 0.09).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Usage);
}
