//! The model of the layer beside the gel of simulated grasps.

use crate::{
    ObjectDepthRenderer, SceneRenderer, SensorMount, SensorProfile, SimulatedGel, TactileScene,
};
use gripcast_geometry::{PrepareOptions, builtin, prepare};
use gripcast_shear::MarkerField;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::{
    Finger, GraspSettings, Placement, Preset, Scene, StageName, resting_pose, simulate,
};

/// Displacements of the markers of the left gel at the end of the force adjustment, by the nodes of
/// the gel and by the model of the layer, px.
fn displacements(object: &str) -> [Vec<[f64; 2]>; 2] {
    let mesh = prepare(&builtin(object).unwrap(), &PrepareOptions::default());
    let mesh = mesh.unwrap().mesh;
    let t_world_object = resting_pose(&mesh, None).unwrap().1.t_world_object;
    let placed = Placement::default().place(&mesh, &t_world_object).unwrap();
    let mut settings = GraspSettings {
        resolution: GelResolution::Coarse,
        ..GraspSettings::new(Preset::Feats)
    };
    settings.protocol.stop_force_n = 12.0;
    settings.protocol.lift_m = 1e-3;
    let scene = Scene {
        mesh: mesh.clone(),
        mass_kg: 0.06,
        friction: 0.6,
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
        gel: settings.gel().unwrap(),
    };
    let gel = SimulatedGel {
        grid: scene.gel.grid.clone(),
        d_hat_m: settings.solver.d_hat_m,
    };
    let trace = simulate(&scene, &settings.protocol, &settings.solver)
        .unwrap()
        .trace;
    let stage = StageName::Adjustment;
    let step = trace.stage(stage).next_back().unwrap();
    let snapshot = trace.snapshots.iter().find(|s| s.stage == stage).unwrap();
    let mount = SensorMount::on(Finger::Left);
    let scenes = [
        TactileScene::from_snapshot(&mesh, &gel, snapshot, mount),
        TactileScene::from_step(&mesh, &gel, &placed.t_world_gripper, step, mount),
    ];
    let profile = SensorProfile::named_or_load("gelsight-mini-markers").unwrap();
    let mut renderer = ObjectDepthRenderer::new(&profile).unwrap();
    let [nodes, layer] =
        scenes.map(|scene| renderer.marker_field(&scene.unwrap()).unwrap().unwrap());
    let seen = |field: &MarkerField, at: usize| {
        let marker = field.markers[at].filter(|marker| marker.confidence > 0.0)?;
        Some(marker.displacement_px().map(f64::from))
    };
    let pairs =
        (0..nodes.markers.len()).filter_map(|at| Some((seen(&nodes, at)?, seen(&layer, at)?)));
    let (nodes, layer) = pairs.unzip();
    [nodes, layer]
}

fn rms(values: &[[f64; 2]]) -> f64 {
    let square: f64 = values.iter().flatten().map(|d| d * d).sum();
    (square / values.len() as f64).sqrt()
}

/// Prints the table of docs/explanation/rendering-tactile.md.
#[test]
fn layer_follows_simulated_gels() {
    for object in ["ball", "box", "bottle"] {
        let [nodes, layer] = displacements(object);
        assert!(nodes.len() > 40, "{object}: {}", nodes.len());
        let product: f64 = nodes
            .iter()
            .flatten()
            .zip(layer.iter().flatten())
            .map(|(a, b)| a * b)
            .sum();
        let (own, modelled) = (rms(&nodes), rms(&layer));
        let correlation = product / (nodes.len() as f64 * own * modelled);
        println!("{object}: gel {own:.2} px, layer {modelled:.2} px, correlation {correlation:.3}");
        assert!(own > 0.5, "{object}: {own}");
        assert!(correlation > 0.95, "{object}: {correlation}");
        assert!(
            (0.8..1.7).contains(&(modelled / own)),
            "{object}: {own} {modelled}"
        );
    }
}
