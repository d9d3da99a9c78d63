//! Colour images of the demo data: from the camera on the gripper, and from a camera next to the
//! table that sees the object's printed sheet and the gripper's tags.

use super::object::DemoObject;
use super::plan::DemoWatch;
use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_geometry::Pose;
use gripcast_imaging::{Intrinsics, encode_jpeg};
use gripcast_pose::BoardFile;
use gripcast_pose::print::{ObjectSheet, SheetObject, default_object_sheet};
use gripcast_sim::fem::GelGrid;
use gripcast_sim::grasp::{GripperState, Snapshot};
use gripcast_visual::{
    AnnotationMarkers, Camera, ColourSettings, DENOISE_RADIUS_PX, GraspState, Model, RenderControl,
    RenderSettings, Renderer, Scene, View, VisualConditions, VisualRandomisation,
    annotation_camera, annotation_scene, denoise, develop, grasp_scene, random_finish,
};

/// Size (px) and samples per pixel of the camera between the fingers.
pub(super) const HAND_CAMERA: [usize; 2] = [320, 240];
const HAND_CAMERA_SPP: u32 = 8;
/// The same for the camera next to the table.
pub(super) const TABLE_CAMERA: [usize; 2] = [1280, 720];
const TABLE_CAMERA_SPP: u32 = 8;
/// Radius of its denoiser, px: the default takes longer than the path tracing.
const TABLE_CAMERA_DENOISE_PX: usize = 3;
/// Number of its image.
const TABLE_CAMERA_NUMBER: u64 = 3;
/// JPEG quality of all images.
const QUALITY: u8 = 92;

/// An object on its printed sheet.
pub(super) struct DemoScene {
    model: Model,
    /// The sheet below the object.
    pub(super) sheet: ObjectSheet,
    /// The gripper's tags.
    pub(super) tags: BoardFile,
    prints: AnnotationMarkers,
    t_world_object: Pose,
    conditions: VisualConditions,
}

/// JPEG images of a grasp.
pub(super) struct Images {
    /// Camera between the fingers: before closing and before the lift.
    pub(super) hand: [Vec<u8>; 2],
    /// Camera next to the table, before closing.
    pub(super) table: Vec<u8>,
    /// Intrinsics of the camera next to the table.
    pub(super) intrinsics: Intrinsics,
}

impl DemoScene {
    /// Creates the scene of an object; its sheet, finish and light depend on the seed.
    ///
    /// # Errors
    /// `Input` for an object that is too large for any paper.
    pub(super) fn new(object: &DemoObject, seed: u64) -> Result<Self> {
        let finish_seed = SeedStream::named(seed, &format!("looks {}", object.name)).bits();
        let lying = SheetObject {
            mesh: &object.mesh,
            source: &object.source,
            t_world_object: object.t_world_object,
        };
        let sheet = default_object_sheet(&object.name, &lying)?;
        let tags = BoardFile::gripper_umi()?;
        Ok(Self {
            model: Model::with_finish(&object.mesh, random_finish(finish_seed), finish_seed)?,
            prints: AnnotationMarkers::new(&sheet.flat_print()?, &tags.flat_prints())?,
            sheet,
            tags,
            t_world_object: object.t_world_object,
            conditions: VisualRandomisation::default().sample(seed),
        })
    }

    /// Returns the intrinsics of the camera next to the table, which do not depend on its pose.
    pub(super) fn intrinsics(&self) -> Intrinsics {
        let state = GraspState {
            t_world_object: self.t_world_object,
            t_world_gripper: self.t_world_object,
            opening_m: 0.08,
            gels: None,
        };
        annotation_camera(&state, TABLE_CAMERA, 0).intrinsics()
    }

    /// Renders the images of a grasp; the seed draws the pose of the camera next to the table, and
    /// noise.
    ///
    /// # Errors
    /// `Interrupted` once the watch is cancelled; `Input` if a camera would be below the ground.
    pub(super) fn render(
        &self,
        placed: &GripperState,
        pre_lift: &Snapshot,
        grid: &GelGrid,
        seed: u64,
        watch: &DemoWatch<'_>,
    ) -> Result<Images> {
        let before = GraspState {
            t_world_object: self.t_world_object,
            t_world_gripper: placed.t_world_gripper,
            opening_m: placed.opening_m,
            gels: None,
        };
        let after = GraspState::from_snapshot(pre_lift, Some(grid))?;
        let render = |scene: &Scene, camera: &Camera, samples, number: u64| {
            let settings = RenderSettings {
                samples_per_pixel: samples,
                seed: seed ^ number,
                ..RenderSettings::default()
            };
            let watch = RenderControl {
                on_progress: None,
                cancel: watch.cancel,
            };
            let rendering = Renderer::new(scene)?.render(camera, &settings, &watch)?;
            let light = denoise(&rendering, denoise_radius_px(number));
            let image = develop(&light, &colour_settings(number), seed ^ number);
            encode_jpeg(&image, QUALITY)
        };
        let hand = |state: &GraspState, number: u64| {
            let scene = grasp_scene(
                &self.model,
                state,
                &self.conditions,
                View::EyeInHand(HAND_CAMERA),
            )?;
            render(&scene, &scene.camera, HAND_CAMERA_SPP, number)
        };
        let camera = annotation_camera(&before, TABLE_CAMERA, seed);
        let scene = annotation_scene(&self.model, &before, &self.conditions, camera, &self.prints)?;
        Ok(Images {
            hand: [hand(&before, 1)?, hand(&after, 2)?],
            table: render(&scene, &camera, TABLE_CAMERA_SPP, TABLE_CAMERA_NUMBER)?,
            intrinsics: camera.intrinsics(),
        })
    }
}

/// Denoiser radius of an image, px.
fn denoise_radius_px(number: u64) -> usize {
    if number == TABLE_CAMERA_NUMBER {
        TABLE_CAMERA_DENOISE_PX
    } else {
        DENOISE_RADIUS_PX
    }
}

/// Returns the sensor settings of an image; the camera next to the table is sharper.
fn colour_settings(number: u64) -> ColourSettings {
    let default = ColourSettings::default();
    match number {
        TABLE_CAMERA_NUMBER => ColourSettings {
            full_well_e: 5000.0,
            read_noise_e: 4.0,
            ..default
        },
        _ => default,
    }
}
