//! Images of a simulated grasp as the rig's cameras would take them.

use std::ops::Range;

use image::imageops;

use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_geometry::{CREASE_RAD, TriangleMesh, curved};
use gripcast_imaging::{
    Depth, DepthImage, DepthView, ObjectMotion, ObjectTracker, TactileDifference, encode_jpeg,
    encode_png_grey16,
};
use gripcast_shear::{ExpectedMarkers, GelMotion, LiftImage, LiftMotion, ShearTracker};
use gripcast_sim::GraspSetup;
use gripcast_sim::grasp::{Finger, Snapshot};
use gripcast_sim::solver::GelMaterial;
use gripcast_tactile::{
    ObjectDepthRenderer, SceneRenderer as _, SensorGeometry, SensorMount, SensorProfile,
    SensorVariation, SimulatedGel, TactileScene, depth_under_force, foundation_pa_m,
};
use gripcast_visual::{
    Camera, ColourSettings, DepthSettings, GraspDepth, GraspState, Model, RenderControl,
    RenderSettings, Renderer, View, VisualRandomisation, denoise, develop, grasp_scene,
    measure_depth,
};

use super::plan::RenderingPlan;

/// Width and height of the colour images, px: the predictor's input.
const VIEW: [usize; 2] = [320, 240];
/// Radius of the denoiser, px: half the cost of the default, hardly visible under camera noise.
const DENOISE_RADIUS: usize = 5;
/// JPEG quality of all images.
const QUALITY: u8 = 92;

/// Sensor with gel markers.
const MARKED_SENSOR: &str = "gelsight-mini-markers";

/// Columns of the depth images in the lift, px: the object between the fingers and beside them, and
/// the fingers, which hide it from an imager.
const LIFT_COLUMNS: Range<usize> = 90..230;

/// Edge length of the surface that tactile images show, m: the facets of simulation meshes are a
/// few millimetres wide and would be visible.
const SURFACE_EDGE_M: f64 = 8e-4;

/// Returns the smooth surface that a simulation mesh stands for.
pub(super) fn smooth_surface(mesh: &TriangleMesh) -> TriangleMesh {
    curved(mesh, CREASE_RAD, SURFACE_EDGE_M)
}

/// A simulated grasp before the lift.
pub(super) struct PreLiftGrasp<'a> {
    /// Initial setup.
    pub(super) setup: &'a GraspSetup,
    /// [`smooth_surface`] of the object.
    pub(super) surface: &'a TriangleMesh,
    /// State before the lift.
    pub(super) snapshot: &'a Snapshot,
    /// States in the first millimetres of the lift.
    pub(super) lift: &'a [Snapshot],
    /// The gels, if they were simulated.
    pub(super) gel: Option<&'a SimulatedGel>,
    /// Normal force on the left and the right finger, N.
    pub(super) force_n: [f64; 2],
}

impl PreLiftGrasp<'_> {
    /// Scene of one sensor. Gels that were not simulated are pressed in until an elastic foundation
    /// carries the force.
    fn scene(&self, finger: Finger, grid: &SensorGeometry) -> Result<TactileScene<'_>> {
        let mesh = self.surface;
        let place = SensorMount::on(finger);
        if let Some(gel) = self.gel {
            // The gap refers to the facets, which the simulation used.
            let faceted = TactileScene::from_snapshot(&self.setup.mesh, gel, self.snapshot, place)?;
            return Ok(TactileScene {
                object: mesh,
                ..faceted
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
        // Images show less than the whole gel: contact at its rim may be out of view.
        match depth_m {
            Some(depth_m) => TactileScene::pressed(mesh, &t_sensor_object, depth_m, grid),
            None => Ok(TactileScene::without_contact(mesh, grid)),
        }
    }

    /// The grasp at a state of the lift, and the force on the fingers of before.
    fn at<'b>(&'b self, snapshot: &'b Snapshot) -> PreLiftGrasp<'b> {
        PreLiftGrasp {
            snapshot,
            lift: &[],
            ..*self
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

/// Renders the images of samples, each with other sensors, light, ground and camera.
#[derive(Clone, Debug)]
pub(super) struct SampleRenderer {
    sensor: SensorProfile,
    /// A sensor with gel markers.
    marked: SensorProfile,
    visual: VisualRandomisation,
    plan: RenderingPlan,
}

impl SampleRenderer {
    pub(super) fn new(plan: RenderingPlan) -> Result<Self> {
        let sensor = plan.sensor.profile()?;
        let marked = match sensor.markers {
            Some(_) => sensor.clone(),
            None => SensorProfile::named_or_load(MARKED_SENSOR)?,
        };
        Ok(Self {
            sensor,
            marked,
            visual: VisualRandomisation::with_spread(plan.visual_spread),
            plan,
        })
    }

    /// Name of the crop profile of the tactile images.
    pub(super) fn crop_profile(&self) -> &'static str {
        self.sensor.crop_profile.name()
    }

    /// Renders the tactile images, JPEG: `[initial, before the lift]`, each `[left, right]`.
    ///
    /// # Errors
    /// `Input` if the snapshot does not belong to the gel.
    pub(super) fn tactile(&self, grasp: &PreLiftGrasp<'_>, seed: u64) -> Result<[[Vec<u8>; 2]; 2]> {
        let mut draw = SeedStream::named(seed, "tactile");
        let mut render = |finger: Finger| -> Result<[Vec<u8>; 2]> {
            let variation = SensorVariation::sample(draw.bits(), self.plan.sensor_spread);
            let mut renderer = ObjectDepthRenderer::new(&variation.apply(&self.sensor))?;
            let after = grasp.scene(finger, &self.sensor.geometry)?;
            let mut image = |scene: &TactileScene<'_>| -> Result<Vec<u8>> {
                encode_jpeg(&renderer.render(scene, Some(draw.bits()))?, QUALITY)
            };
            Ok([image(&after.untouched())?, image(&after)?])
        };
        let ([a, b], [c, d]) = (render(Finger::Left)?, render(Finger::Right)?);
        Ok([[a, c], [b, d]])
    }

    /// Renders the tactile images before and in the lift, half of the samples with gel markers, and
    /// measures what the gels show in them; none without simulated gels or states of the lift.
    ///
    /// # Errors
    /// `Input` if a snapshot does not belong to the gel.
    pub(super) fn lift(&self, grasp: &PreLiftGrasp<'_>, seed: u64) -> Result<Option<LiftMotion>> {
        if grasp.gel.is_none() || grasp.lift.is_empty() {
            return Ok(None);
        }
        let mut draw = SeedStream::named(seed, "lift");
        let profile = match draw.bits() & 1 {
            0 => &self.sensor,
            _ => &self.marked,
        };
        let mut follow = |finger: Finger| -> Result<Vec<GelMotion>> {
            let variation = SensorVariation::sample(draw.bits(), self.plan.sensor_spread);
            let mut renderer = ObjectDepthRenderer::new(&variation.apply(profile))?;
            let before = grasp.scene(finger, &profile.geometry)?;
            let initial = renderer.render(&before.untouched(), Some(draw.bits()))?;
            let markers = match &profile.markers {
                Some(pattern) => ExpectedMarkers::Pattern(pattern),
                None => ExpectedMarkers::None,
            };
            let mut tracker = ShearTracker::new(&initial, profile.geometry.pixel_m, markers)?;
            let states = [grasp.snapshot].into_iter().chain(grasp.lift);
            states
                .map(|state| {
                    let at = grasp.at(state);
                    let scene = at.scene(finger, &profile.geometry)?;
                    let image = renderer.render(&scene, Some(draw.bits()))?;
                    let difference = TactileDifference::between(&initial, &image)?;
                    let level = f64::from(difference.mean_abs());
                    Ok(GelMotion::new(level, &tracker.update(&image)))
                })
                .collect()
        };
        let (left, right) = (follow(Finger::Left)?, follow(Finger::Right)?);
        let gels = left.into_iter().zip(right);
        let images = gels.map(|(left, right)| LiftImage::from([left, right]));
        Ok(Some(LiftMotion {
            images: images.collect(),
        }))
    }

    /// Renders the images of the wrist camera: colour, JPEG, and depth aligned to it, 16-bit PNG,
    /// mm. Its depth images of the lift give the motion of the object.
    ///
    /// # Errors
    /// `Input` if the camera would be inside an object.
    pub(super) fn wrist(
        &self,
        grasp: &PreLiftGrasp<'_>,
        model: &Model,
        seed: u64,
        lift: Option<&mut LiftMotion>,
    ) -> Result<[Vec<u8>; 2]> {
        let mut draw = SeedStream::named(seed, "visual");
        let conditions = self.visual.sample(draw.bits());
        let state = grasp.state()?;
        let scene = grasp_scene(model, &state, &conditions, View::EyeInHand(VIEW))?;
        let settings = RenderSettings {
            samples_per_pixel: self.plan.samples_per_pixel,
            seed: draw.bits(),
            ..RenderSettings::default()
        };
        let renderer = Renderer::new(&scene)?;
        let rendering = renderer.render(&scene.camera, &settings, &RenderControl::default())?;
        let light = denoise(&rendering, DENOISE_RADIUS);
        let image = develop(&light, &ColourSettings::default(), draw.bits());
        let exact_m = renderer.depth(&scene.camera)?;
        let settings = DepthSettings::sample(draw.bits(), self.plan.visual_spread);
        let depth = measure_depth(&exact_m, &scene.camera, &settings, draw.bits())?;
        if let Some(lift) = lift {
            let first = (&depth, &scene.camera);
            follow_object(grasp, first, &settings, &mut draw, lift)?;
        }
        Ok([encode_jpeg(&image, QUALITY)?, encode_png_grey16(&depth)?])
    }
}

/// Follows the object in the depth images of a lift, which start with `before`; `camera` is that of
/// the colour image.
fn follow_object(
    grasp: &PreLiftGrasp<'_>,
    (before, camera): (&DepthImage, &Camera),
    settings: &DepthSettings,
    draw: &mut SeedStream,
    lift: &mut LiftMotion,
) -> Result<()> {
    let depth = |image: DepthImage| Depth {
        image,
        unit_m: settings.unit_m,
    };
    let tracker = ObjectTracker::new(&depth(before.clone()), DepthView::Colour);
    let (Some(tracker), Some((first, rest))) = (tracker, lift.images.split_first_mut()) else {
        return Ok(());
    };
    first.object = Some(ObjectMotion::NONE);
    let (columns, rows) = (LIFT_COLUMNS, tracker.rows());
    let part = camera.cropped(columns.clone(), rows.clone());
    let rendered = GraspDepth::new(&grasp.setup.mesh, &grasp.state()?, part)?;
    for (image, snapshot) in rest.iter_mut().zip(grasp.lift) {
        let (gripper, object) = (&snapshot.t_world_gripper, &snapshot.t_world_object);
        let exact_m = rendered.render(gripper, object)?;
        let part = measure_depth(&exact_m, &rendered.camera(gripper), settings, draw.bits())?;
        let mut seen = DepthImage::new(VIEW[0] as u32, VIEW[1] as u32);
        imageops::replace(&mut seen, &part, columns.start as i64, rows.start as i64);
        image.object = tracker.motion(&depth(seen), DepthView::Colour);
    }
    Ok(())
}

/// Returns the seed of one rendering of a simulation.
pub(super) fn rendering_seed(simulation: u64, rendering: u32) -> u64 {
    SeedStream::named(simulation, &format!("rendering {rendering}")).bits()
}
