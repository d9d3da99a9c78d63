//! Lift a built-in object and print what the left gel feels: resultant and stick fraction.
//!
//! ```text
//! cargo run --release --example contact_fields
//! ```
//!
//! Prints a line per tenth time step: stage, time, force along the gel's x, y and z (N), torque about
//! z (N mm), fraction of the normal force that sticks, and largest traction (kPa).

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_geometry::{PrepareOptions, builtin, prepare};
use gripcast_sim::fem::GelResolution;
use gripcast_sim::fields::FieldSampling;
use gripcast_sim::grasp::{GraspSettings, Placement, Scene, resting_pose, simulate_with_fields};

fn main() -> Result<()> {
    println!("{}", table("box")?);
    Ok(())
}

pub(crate) fn table(object: &str) -> Result<String> {
    let mesh = prepare(&builtin(object)?, &PrepareOptions::default())?.mesh;
    let t_world_object = resting_pose(&mesh, None)?.1.t_world_object;
    let placed = Placement::default().place(&mesh, &t_world_object)?;
    let mut settings = GraspSettings {
        resolution: GelResolution::Coarse,
        ..GraspSettings::default()
    };
    // A short grasp; the default holds the force for longer and lifts higher.
    settings.protocol.stop_force_n = 15.0;
    settings.protocol.adjust_s = 0.1;
    settings.protocol.lift_m = 0.01;
    let scene = Scene {
        mesh,
        mass_kg: 0.2,
        friction: 0.5,
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
        gel: settings.gel()?,
    };
    let sampling: FieldSampling = "every:10".parse()?;
    let result =
        simulate_with_fields(&scene, &settings.protocol, &settings.solver, Some(sampling))?;
    let series = result
        .trace
        .fields
        .ok_or_else(|| Error::new(ErrorKind::Input, "the gripper starts inside the object"))?;
    let mut lines = Vec::new();
    for step in &series.steps {
        let (Some(stage), Some(left)) = (step.stage, step.gels.first()) else {
            continue;
        };
        let Some(stick) = left.stick_fraction(&series.mesh) else {
            continue;
        };
        let [x, y, z] = left.resultant.force_n;
        let torque = 1e3 * left.resultant.torque_n_m[2];
        let length = |t: &[f32; 3]| t.iter().map(|v| v * v).sum::<f32>().sqrt();
        let largest = left.traction_pa.iter().map(length).fold(0.0, f32::max);
        lines.push(format!(
            "{stage:?} {:.2} s: {x:.2} {y:.2} {z:.2} N, {torque:.2} N mm, stick {stick:.2}, {:.0} kPa",
            step.t_s,
            1e-3 * largest
        ));
    }
    Ok(lines.join("\n"))
}
