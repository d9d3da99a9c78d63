//! Pictures of a simulated grasp as a collection would have taken them.

use crate::error::Result;
use crate::imaging::encode_jpeg;
use crate::render::tactile::{
    ObjectDepthRenderer, SceneRenderer as _, SensorPlace, SensorProfile, SensorVariation,
    SimulatedGel, TactileScene,
};
use crate::render::visual::{
    ColourSettings, DenoiseSettings, GraspState, Model, RenderSettings, Renderer, SeedStream, View,
    VisualRandomisation, Watch, denoise, develop, grasp_scene,
};
use crate::sim::GraspSetup;
use crate::sim::grasp::{Finger, Snapshot, StageName};

use super::plan::RenderingPlan;

/// Columns and rows of the colour pictures: what the predictor sees.
const VIEW: [usize; 2] = [320, 240];
/// JPEG quality of all pictures.
const QUALITY: u8 = 92;

/// JPEGs of one rendering.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SamplePictures {
    /// Left and right sensor before the fingers close.
    pub(super) initial: [Vec<u8>; 2],
    /// The same before the lift.
    pub(super) grasp: [Vec<u8>; 2],
    /// Between the fingers, before the lift.
    pub(super) rgb: Vec<u8>,
}

/// A simulated grasp up to the lift.
pub(super) struct Grasped<'a> {
    /// Where everything was before.
    pub(super) setup: &'a GraspSetup,
    /// Before the lift.
    pub(super) snapshot: &'a Snapshot,
    /// The gels that were simulated.
    pub(super) gel: &'a SimulatedGel,
}

/// Makes the pictures of a rendering: other sensors, light, ground, camera each.
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
            visual: VisualRandomisation::default(),
            plan,
        })
    }

    /// Named crop of the tactile pictures: they are whole.
    pub(super) fn crop_profile(&self) -> &'static str {
        self.sensor.crop_profile.name()
    }

    /// The tactile pictures of a rendering, initial and before the lift.
    ///
    /// # Errors
    /// `Input` where the snapshot is not of the gel.
    pub(super) fn tactile(&self, grasped: &Grasped<'_>, seed: u64) -> Result<[[Vec<u8>; 2]; 2]> {
        let mut draw = SeedStream::named(seed, "tactile");
        let mut of = |finger: Finger| -> Result<[Vec<u8>; 2]> {
            let variation = SensorVariation::drawn(draw.bits(), self.plan.sensor_spread);
            let mut renderer = ObjectDepthRenderer::new(&variation.of(&self.sensor))?;
            let place = SensorPlace::on(finger);
            let mesh = &grasped.setup.mesh;
            let after = TactileScene::of_snapshot(mesh, grasped.gel, grasped.snapshot, place)?;
            let mut picture = |scene: &TactileScene<'_>| -> Result<Vec<u8>> {
                encode_jpeg(&renderer.render(scene, Some(draw.bits()))?, QUALITY)
            };
            Ok([picture(&after.untouched())?, picture(&after)?])
        };
        let ([a, b], [c, d]) = (of(Finger::Left)?, of(Finger::Right)?);
        Ok([[a, c], [b, d]])
    }

    /// The colour picture of a rendering.
    ///
    /// # Errors
    /// `Input` where the camera would be inside something.
    pub(super) fn rgb(&self, grasped: &Grasped<'_>, model: &Model, seed: u64) -> Result<Vec<u8>> {
        let mut draw = SeedStream::named(seed, "visual");
        let conditions = self.visual.sample(draw.bits());
        let grid = &grasped.gel.grid;
        let state = GraspState::at(grasped.snapshot, Some(grid))?;
        let scene = grasp_scene(model, &state, &conditions, View::EyeInHand(VIEW))?;
        let settings = RenderSettings {
            samples: self.plan.samples,
            seed: draw.bits(),
            ..RenderSettings::default()
        };
        let rendering = Renderer::new(&scene)?.render(&scene.camera, &settings, &Watch::default())?;
        let light = denoise(&rendering, &DenoiseSettings::default());
        let picture = develop(&light, &ColourSettings::default(), draw.bits());
        encode_jpeg(&picture, QUALITY)
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
