//! Images of a simulated grasp as a collection would have taken them.

use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_geometry::{CREASE_RAD, TriangleMesh, curved};
use gripcast_imaging::encode_jpeg;
use gripcast_sim::GraspSetup;
use gripcast_sim::grasp::{Finger, Snapshot, StageName};
use gripcast_sim::solver::GelMaterial;
use gripcast_tactile::{
    ObjectDepthRenderer, SceneRenderer as _, SensorGeometry, SensorMount, SensorProfile,
    SensorVariation, SimulatedGel, TactileScene, depth_under_force, foundation_pa_m,
};
use gripcast_visual::{
    ColourSettings, GraspState, Model, RenderControl, RenderSettings, Renderer, View,
    VisualRandomisation, denoise, develop, grasp_scene,
};

use super::plan::RenderingPlan;

/// Columns and rows of the colour images: what the predictor sees.
const VIEW: [usize; 2] = [320, 240];
/// Radius of the denoiser, px: half the work of the usual one, hardly seen under a camera's noise.
const DENOISE_RADIUS: usize = 5;
/// JPEG quality of all images.
const QUALITY: u8 = 92;

/// Sides of the triangles that a tactile sensor sees, m: the facets of the meshes that meet the
/// gels are a few millimetres wide, which shows.
const SEEN_SIDE_M: f64 = 8e-4;

/// The surface of an object that a tactile sensor sees.
pub(super) fn seen_surface(mesh: &TriangleMesh) -> TriangleMesh {
    curved(mesh, CREASE_RAD, SEEN_SIDE_M)
}

/// A simulated grasp up to the lift.
pub(super) struct Grasped<'a> {
    /// Where everything was before.
    pub(super) setup: &'a GraspSetup,
    /// [`seen_surface`] of the object.
    pub(super) seen: &'a TriangleMesh,
    /// Before the lift.
    pub(super) snapshot: &'a Snapshot,
    /// The gels, where they were simulated.
    pub(super) gel: Option<&'a SimulatedGel>,
    /// Normal force on the left and the right finger, N.
    pub(super) force_n: [f64; 2],
}

impl Grasped<'_> {
    /// What a sensor meets before the lift. Gels that were not simulated are pressed in as far as
    /// an elastic foundation carries the force.
    fn scene(&self, finger: Finger, grid: &SensorGeometry) -> Result<TactileScene<'_>> {
        let mesh = self.seen;
        let place = SensorMount::on(finger);
        if let Some(gel) = self.gel {
            // The gap is that to the facets: the simulation knows no other surface.
            let met = TactileScene::from_snapshot(&self.setup.mesh, gel, self.snapshot, place)?;
            return Ok(TactileScene {
                object: mesh,
                ..met
            });
        }
        let thickness = grid.gel_thickness_m;
        let opening_m = self.snapshot.opening_m;
        let t_gripper_sensor = place.t_gripper_sensor(opening_m, thickness);
        let t_sensor_world = (self.snapshot.t_world_gripper * t_gripper_sensor).inverse();
        let t_sensor_object = t_sensor_world * self.snapshot.t_world_object;
        let GelMaterial {
            young_pa, poisson, ..
        } = GelMaterial::default();
        let stiffness = foundation_pa_m(young_pa, poisson, thickness);
        let force_n = self.force_n[finger as usize];
        let depth_m = depth_under_force(mesh, &t_sensor_object, force_n, stiffness, grid);
        // The image shows less than the gel: what touches its rim alone is not seen.
        match depth_m {
            Some(depth_m) => TactileScene::pressed(mesh, &t_sensor_object, depth_m, grid),
            None => Ok(TactileScene::without_contact(mesh, grid)),
        }
    }

    fn state(&self) -> Result<GraspState> {
        let snapshot = self.snapshot;
        match self.gel {
            Some(gel) => GraspState::from_snapshot(snapshot, Some(&gel.grid)),
            None => Ok(GraspState {
                t_world_object: snapshot.t_world_object,
                t_world_gripper: snapshot.t_world_gripper,
                opening_m: snapshot.opening_m,
                gels: None,
            }),
        }
    }
}

/// Makes the images of a rendering: other sensors, light, ground, camera each.
#[derive(Clone, Debug)]
pub(super) struct Photographer {
    sensor: SensorProfile,
    visual: VisualRandomisation,
    plan: RenderingPlan,
}

impl Photographer {
    pub(super) fn new(plan: RenderingPlan) -> Result<Self> {
        Ok(Self {
            sensor: SensorProfile::gelsight_mini()?,
            visual: VisualRandomisation::with_spread(plan.visual_spread),
            plan,
        })
    }

    /// Named crop of the tactile images: they are whole.
    pub(super) fn crop_profile(&self) -> &'static str {
        self.sensor.crop_profile.name()
    }

    /// The tactile images of a rendering, initial and before the lift.
    ///
    /// # Errors
    /// `Input` where the snapshot is not of the gel.
    pub(super) fn tactile(&self, grasped: &Grasped<'_>, seed: u64) -> Result<[[Vec<u8>; 2]; 2]> {
        let mut draw = SeedStream::named(seed, "tactile");
        let mut of = |finger: Finger| -> Result<[Vec<u8>; 2]> {
            let variation = SensorVariation::sample(draw.bits(), self.plan.sensor_spread);
            let mut renderer = ObjectDepthRenderer::new(&variation.apply(&self.sensor))?;
            let after = grasped.scene(finger, &self.sensor.geometry)?;
            let mut image = |scene: &TactileScene<'_>| -> Result<Vec<u8>> {
                encode_jpeg(&renderer.render(scene, Some(draw.bits()))?, QUALITY)
            };
            Ok([image(&after.untouched())?, image(&after)?])
        };
        let ([a, b], [c, d]) = (of(Finger::Left)?, of(Finger::Right)?);
        Ok([[a, c], [b, d]])
    }

    /// The colour image of a rendering.
    ///
    /// # Errors
    /// `Input` where the camera would be inside something.
    pub(super) fn rgb(&self, grasped: &Grasped<'_>, model: &Model, seed: u64) -> Result<Vec<u8>> {
        let mut draw = SeedStream::named(seed, "visual");
        let conditions = self.visual.sample(draw.bits());
        let state = grasped.state()?;
        let scene = grasp_scene(model, &state, &conditions, View::EyeInHand(VIEW))?;
        let settings = RenderSettings {
            samples_per_pixel: self.plan.samples,
            seed: draw.bits(),
            ..RenderSettings::default()
        };
        let rendering =
            Renderer::new(&scene)?.render(&scene.camera, &settings, &RenderControl::default())?;
        let light = denoise(&rendering, DENOISE_RADIUS);
        let image = develop(&light, &ColourSettings::default(), draw.bits());
        encode_jpeg(&image, QUALITY)
    }
}

/// Seed of one rendering of a simulation.
pub(super) fn rendering_seed(simulation: u64, rendering: u32) -> u64 {
    SeedStream::named(simulation, &format!("rendering {rendering}")).bits()
}

/// The state before the lift.
pub(super) fn before_lift(snapshots: &[Snapshot]) -> Option<&Snapshot> {
    snapshots.iter().find(|s| s.stage == StageName::Adjustment)
}
