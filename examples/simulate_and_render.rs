//! Simulate the grasp of a built-in object, then render what the sensors see of it.
//!
//! ```text
//! cargo run --release --example simulate_and_render -- images
//! ```
//!
//! Prints the outcome (`Success, lifted 30.0 mm`) and writes `left.png`, `right.png` (both gels
//! when the force has settled) and `colour.png` (the camera between the fingers) into `images`.

use std::path::Path;
use std::sync::Arc;

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::save;
use gripcast_geometry::{PrepareOptions, builtin, prepare};
use gripcast_imaging::encode_png_rgb;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::{
    Finger, GraspSettings, GraspSummary, Placement, StageName, resting_pose,
};
use gripcast_sim::{Engine as _, FemEngine, GraspSetup};
use gripcast_tactile::{
    ObjectDepthRenderer, SceneRenderer as _, SensorMount, SensorProfile, SimulatedGel, TactileScene,
};
use gripcast_visual::{
    ColourSettings, GraspState, RenderControl, RenderSettings, Renderer, View, VisualRandomisation,
    demo_model, develop, grasp_scene,
};

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| "images".into());
    std::fs::create_dir_all(&folder).map_err(|e| Error::io("cannot create", e).at(&folder))?;
    println!("{}", run("box", Path::new(&folder))?);
    Ok(())
}

pub(crate) fn run(object: &str, folder: &Path) -> Result<String> {
    // A mesh file comes from `gripcast_geometry::load_mesh`. The object rests on a table.
    let mesh = Arc::new(prepare(&builtin(object)?, &PrepareOptions::default())?.mesh);
    let t_world_object = resting_pose(&mesh, None)?.1.t_world_object;
    let placed = Placement::default().place(&mesh, &t_world_object)?;
    let setup = GraspSetup {
        mesh: Arc::clone(&mesh),
        mass_kg: 0.1,
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
    };
    let mut engine = FemEngine {
        settings: GraspSettings {
            resolution: GelResolution::Coarse,
            ..GraspSettings::default()
        },
    };
    // A short grasp; the default holds the force for longer and lifts higher.
    engine.settings.protocol.adjust_s = 0.1;
    let result = engine.simulate(&setup, 0.5, 15.0)?;
    let summary = GraspSummary::new(
        &result,
        &engine.settings.protocol,
        engine.settings.solver.dt_s,
    );
    let settled = result
        .trace
        .snapshots
        .iter()
        .rfind(|s| s.stage == StageName::Adjustment);
    let no_contact = || Error::new(ErrorKind::Input, "the fingers did not reach the object");
    let settled = settled.ok_or_else(no_contact)?;

    let gel = engine
        .gel()?
        .map(|(grid, d_hat_m)| SimulatedGel { grid, d_hat_m });
    let gel = gel.ok_or_else(no_contact)?;
    let mut tactile = ObjectDepthRenderer::new(&SensorProfile::gelsight_mini()?)?;
    for (finger, name) in [(Finger::Left, "left.png"), (Finger::Right, "right.png")] {
        let scene = TactileScene::from_snapshot(&mesh, &gel, settled, SensorMount::on(finger))?;
        // The seed decides noise and drift; `None` renders without.
        save(
            &folder.join(name),
            &encode_png_rgb(&tactile.render(&scene, Some(1))?)?,
        )?;
    }

    // Light, ground and camera offsets are drawn from a seed too.
    let conditions = VisualRandomisation::default().sample(1);
    let state = GraspState::from_snapshot(settled, Some(&gel.grid))?;
    let model = demo_model(object, 1)?;
    let scene = grasp_scene(&model, &state, &conditions, View::EyeInHand([160, 120]))?;
    let settings = RenderSettings {
        samples_per_pixel: 16,
        ..RenderSettings::default()
    };
    let rendering =
        Renderer::new(&scene)?.render(&scene.camera, &settings, &RenderControl::default())?;
    let colour = develop(
        &rendering.image,
        &ColourSettings::default(),
        conditions.sensor_seed,
    );
    save(&folder.join("colour.png"), &encode_png_rgb(&colour)?)?;
    Ok(format!(
        "{:?}, lifted {:.1} mm",
        summary.outcome,
        1e3 * summary.lifted_m
    ))
}
