//! A grasp whose steps do not converge has no outcome.

use super::{GraspOutcome, GraspSettings, Protocol, cases, simulate};
use crate::fem::GelGrid;
use crate::solver::SolverParameters;

#[test]
fn a_grasp_whose_steps_do_not_converge_has_no_outcome() {
    let case = cases().into_iter().find(|case| case.name == "box").unwrap();
    let mesh = case.object.load(&|_, _| Ok(None)).unwrap().unwrap();
    let mut scene = case.scene(mesh, &GraspSettings::default()).unwrap();
    scene.gel.grid = GelGrid::uniform([5, 5, 3], [0.025, 0.020, 0.004]).unwrap();
    let parameters = SolverParameters {
        max_iterations: 1,
        ..Default::default()
    };
    let result = simulate(&scene, &Protocol::default(), &parameters).unwrap();
    assert_eq!(result.outcome, GraspOutcome::NotConverged);
    assert!(result.unconverged_steps > 1);
    let detail = result.detail.unwrap();
    assert!(detail.contains("did not converge"), "{detail}");
}

#[test]
fn a_grasp_is_given_up_after_its_iterations() {
    let case = cases().into_iter().find(|case| case.name == "box").unwrap();
    let mesh = case.object.load(&|_, _| Ok(None)).unwrap().unwrap();
    let mut scene = case.scene(mesh, &GraspSettings::default()).unwrap();
    scene.gel.grid = GelGrid::uniform([5, 5, 3], [0.025, 0.020, 0.004]).unwrap();
    let parameters = SolverParameters {
        max_grasp_iterations: 20,
        ..Default::default()
    };
    let result = simulate(&scene, &Protocol::default(), &parameters).unwrap();
    assert_eq!(result.outcome, GraspOutcome::NotConverged);
    assert_eq!(result.detail.unwrap(), "given up after 20 iterations");
    let iterations = result.trace.steps.iter().filter_map(|step| step.solver);
    let spent: u32 = iterations.map(|step| step.iterations).sum();
    assert!((21..100).contains(&spent), "{spent}");
}
