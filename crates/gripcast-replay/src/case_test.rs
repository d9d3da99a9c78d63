//! Finished cases are identified by [`VERSION`] and their input, not by the code of the simulators.
//! If these tests fail because an engine changed its results, increment [`VERSION`]; otherwise
//! stored cases of the old and the new simulator would be mixed.

use std::fs;

use super::*;
use crate::load_objects;
use gripcast_sim::FemEngine;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::{GraspSettings, Placement, resting_pose};
use gripcast_sim::rigid::{RigidEngine, RigidSettings};

/// Simulates a box that is gripped above its centre.
fn result(engine: &dyn Engine, force_n: f64) -> (u32, String) {
    let folder = tempfile::tempdir().unwrap();
    let text = "schema = 1\nmesh = \"builtin:box\"\nmass_kg = 0.06\n";
    fs::write(folder.path().join("box.toml"), text).unwrap();
    let objects = load_objects(folder.path()).unwrap();
    let object = objects.values().next().unwrap().as_ref().unwrap();
    let (_, rest) = resting_pose(&object.mesh, None).unwrap();
    let placement = Placement {
        offset_m: [0.004, 0.002],
        ..Placement::default()
    };
    let placed = placement.place(&object.mesh, &rest.t_world_object).unwrap();
    let case = Case {
        engine,
        setup: GraspSetup {
            mesh: object.mesh.clone(),
            mass_kg: 0.06,
            t_world_object: rest.t_world_object,
            t_world_gripper: placed.t_world_gripper,
            opening_m: placed.opening_m,
        },
        object,
        setting: Setting {
            friction: 0.4,
            force_n,
        },
    };
    let (record, _) = case.simulate().unwrap();
    let facts = record.facts;
    // Without the decimals that differ between processors.
    let text = format!(
        "{}, {} steps, lowest point {:.4} mm, rose {:.4} mm, {:.3} N",
        facts.outcome,
        facts.steps,
        1e3 * facts.min_height_m,
        1e3 * facts.lifted_m,
        facts.force_n.unwrap_or(f64::NAN)
    );
    (VERSION, text)
}

#[test]
fn finite_element_result_matches_version() {
    let mut settings = GraspSettings {
        resolution: GelResolution::Coarse,
        ..GraspSettings::default()
    };
    settings.solver.max_grasp_iterations = 50_000;
    let found = result(&FemEngine { settings }, 20.0);
    let expected = "success, 447 steps, lowest point 50.4022 mm, rose 49.9351 mm, 18.752 N";
    assert_eq!(found, (1, expected.to_owned()));
}

#[test]
fn rigid_body_result_matches_version() {
    let mut settings = RigidSettings::default();
    settings.decomposition.resolution = 32;
    let found = result(&RigidEngine::new(settings), 10.0);
    let expected = "success, 210 steps, lowest point 179.9030 mm, rose 179.9072 mm, 10.000 N";
    assert_eq!(found, (1, expected.to_owned()));
}
