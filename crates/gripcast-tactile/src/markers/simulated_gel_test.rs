//! The model of the layer, and the tracked contact, beside the gel of simulated grasps.

use std::ops::Range;

use crate::{
    ObjectDepthRenderer, SceneRenderer, SensorGeometry, SensorMount, SensorProfile, SimulatedGel,
    TactileScene,
};
use gripcast_geometry::{PrepareOptions, builtin, prepare};
use gripcast_shear::{ExpectedMarkers, MarkerField, ShearTracker};
use gripcast_sim::fem::GelResolution;
use gripcast_sim::fields::{FaceField, FaceMesh, FieldSampling};
use gripcast_sim::grasp::{
    Finger, GraspSettings, Placement, Preset, Scene, StageName, resting_pose, simulate_with_fields,
};
use gripcast_sim::solver::NodeContact;

/// The left gel at the end of the force adjustment.
struct Gripped {
    /// Displacements of the gel markers by the nodes of the gel and by the model of the layer, px.
    displacements: [Vec<[f64; 2]>; 2],
    /// Fraction of the image in contact, simulated and as tracked in the rendered image.
    contact: [f64; 2],
}

fn grip(object: &str) -> Gripped {
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
    let sampling = Some(FieldSampling::Stages);
    let trace = simulate_with_fields(&scene, &settings.protocol, &settings.solver, sampling)
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
    let [nodes, layer] = scenes.map(Result::unwrap);
    let mut tracker = ShearTracker::new(
        &renderer.render(&nodes.untouched(), Some(1)).unwrap(),
        profile.geometry.pixel_m,
        ExpectedMarkers::Unknown,
    )
    .unwrap();
    let tracked = tracker.update(&renderer.render(&nodes, Some(2)).unwrap());
    let series = trace.fields.as_ref().unwrap();
    let fields = series
        .steps
        .iter()
        .find(|s| s.stage == Some(stage))
        .unwrap();
    let contact = [
        touched_fraction(&series.mesh, &fields.gels[0], profile.geometry),
        tracked.summary.unwrap().contact_fraction,
    ];
    let [nodes, layer] =
        [nodes, layer].map(|scene| renderer.marker_field(&scene).unwrap().unwrap());
    let seen = |field: &MarkerField, at: usize| {
        let marker = field.markers[at].filter(|marker| marker.confidence > 0.0)?;
        Some(marker.displacement_px().map(f64::from))
    };
    let pairs =
        (0..nodes.markers.len()).filter_map(|at| Some((seen(&nodes, at)?, seen(&layer, at)?)));
    let (nodes, layer) = pairs.unzip();
    Gripped {
        displacements: [nodes, layer],
        contact,
    }
}

/// Fraction of the image in which nodes touch the object.
fn touched_fraction(mesh: &FaceMesh, field: &FaceField, image: SensorGeometry) -> f64 {
    let [width, height] = [image.width, image.height].map(|px| px as f64 * image.pixel_m);
    let is_seen = |node: &usize| {
        let position = mesh.position(*node);
        position.x.abs() <= 0.5 * width && position.y.abs() <= 0.5 * height
    };
    let touched = (0..mesh.nodes())
        .filter(is_seen)
        .filter(|node| field.contact[*node] != NodeContact::Open);
    touched.map(|node| mesh.area_m2[node]).sum::<f64>() / (width * height)
}

fn rms(values: &[[f64; 2]]) -> f64 {
    let square: f64 = values.iter().flatten().map(|d| d * d).sum();
    (square / values.len() as f64).sqrt()
}

/// What holds for an object.
struct Expected {
    object: &'static str,
    /// Minimum correlation of both motions.
    correlation: f64,
    /// Motion by the model of the layer over that of the gel.
    motion: Range<f64>,
    /// Tracked contact over the simulated one.
    contact: Range<f64>,
}

const fn expected(
    object: &'static str,
    correlation: f64,
    motion: Range<f64>,
    contact: Range<f64>,
) -> Expected {
    Expected {
        object,
        correlation,
        motion,
        contact,
    }
}

/// The box is flat where it touches, and so is most of the wedge: such contact does not change the
/// image. Star and jack touch with edges finer than the nodes of the coarse gel, the lump at the rim
/// of the pad, partly outside the image: there, only the size of the model's motion is right.
const OBJECTS: [Expected; 8] = [
    expected("ball", 0.95, 0.8..1.7, 0.5..2.0),
    expected("box", 0.95, 0.8..1.7, 0.0..0.1),
    expected("bottle", 0.95, 0.8..1.7, 0.5..2.0),
    expected("mug", 0.95, 0.8..1.7, 0.5..2.0),
    expected("star", 0.2, 0.8..1.7, 0.5..2.0),
    expected("jack", 0.4, 0.7..1.7, 0.5..2.0),
    expected("wedge", 0.95, 0.8..2.5, 0.1..0.5),
    expected("lump", -0.2, 0.7..1.7, 0.5..2.0),
];

/// Prints the tables of docs/explanation/rendering-tactile.md and docs/explanation/shear.md.
#[test]
fn layer_and_tracked_contact_follow_simulated_gels() {
    for expected in OBJECTS {
        let object = expected.object;
        let Gripped {
            displacements: [nodes, layer],
            contact: [touched, tracked],
        } = grip(object);
        assert!(nodes.len() > 40, "{object}: {}", nodes.len());
        let product: f64 = nodes
            .iter()
            .flatten()
            .zip(layer.iter().flatten())
            .map(|(a, b)| a * b)
            .sum();
        let (own, modelled) = (rms(&nodes), rms(&layer));
        let correlation = product / (nodes.len() as f64 * own * modelled);
        println!(
            "{object}: gel {own:.2} px, layer {modelled:.2} px, correlation {correlation:.3}; \
             contact {touched:.3}, tracked {tracked:.3}"
        );
        assert!(
            correlation > expected.correlation,
            "{object}: {correlation}"
        );
        let ratio = modelled / own;
        assert!(
            expected.motion.contains(&ratio),
            "{object}: {own} {modelled}"
        );
        let ratio = tracked / touched;
        assert!(
            expected.contact.contains(&ratio),
            "{object}: {tracked} of {touched}"
        );
    }
}
