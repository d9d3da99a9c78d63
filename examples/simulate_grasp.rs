//! Simulate one grasp from a program: a sphere gripped 12 mm off its middle.
//!
//! ```text
//! cargo run --release --example simulate_grasp -- sphere.svg
//! ```

use gripcast_base::error::{Error, Result};
use gripcast_geometry::{PrepareOptions, builtin, prepare};
use gripcast_replay::plot;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::{
    GraspSettings, GraspSummary, Placement, Scene, StageName, resting_pose, simulate,
};

fn main() -> Result<()> {
    // A mesh file would come from `geometry::load_mesh`; both have to be closed.
    let mesh = prepare(&builtin("sphere")?, &PrepareOptions::default())?.mesh;
    let (_, rest) = resting_pose(&mesh, None)?;
    let placement = Placement {
        offset_m: [0.0, 0.012],
        ..Placement::default()
    };
    let placed = placement.place(&mesh, &rest.t_world_object)?;

    let mut settings = GraspSettings {
        resolution: GelResolution::Coarse,
        ..GraspSettings::default()
    };
    settings.protocol.stop_force_n = 20.0;

    let scene = Scene {
        mesh,
        mass_kg: 0.06,
        friction: 0.4,
        t_world_object: rest.t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
        gel: settings.gel()?,
    };
    let result = simulate(&scene, &settings.protocol, &settings.solver)?;
    let summary = GraspSummary::of(&result, &settings.protocol, settings.solver.dt_s);
    println!(
        "{:?}, lifted {:.1} mm",
        summary.outcome,
        1e3 * summary.lifted_m
    );

    // What a renderer of tactile images needs: the gels as they were when the force had settled.
    let adjusted = result
        .trace
        .snapshots
        .iter()
        .find(|snapshot| snapshot.stage == StageName::Adjustment);
    if let Some(snapshot) = adjusted {
        let nodes = snapshot.gels[0].len();
        println!("{nodes} nodes a gel at {:.2} s", snapshot.t_s);
    }
    if let Some(path) = std::env::args().nth(1) {
        let height = settings.protocol.success_height_m;
        let picture = plot(&result.trace, &summary, height, "sphere, 12 mm off");
        std::fs::write(&path, picture).map_err(|e| Error::io("cannot write", e).at(path))?;
    }
    Ok(())
}
