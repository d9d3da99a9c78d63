//! What the colour cameras of the demo data see: the one on the gripper, and the one beside the table
//! that sees the object's printed sheet and the gripper's tags.

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

/// Columns and rows of the images between the fingers, and their paths for each pixel.
pub(super) const HAND: [usize; 2] = [320, 240];
const HAND_SAMPLES: u32 = 8;
/// The same beside the table.
pub(super) const BESIDE: [usize; 2] = [1280, 720];
const BESIDE_SAMPLES: u32 = 8;
/// Neighbourhood of its denoiser, px: the usual one takes longer than the paths.
const BESIDE_DENOISE_PX: usize = 3;
/// Its number among the images of a grasp.
const BESIDE_NUMBER: u64 = 3;
/// JPEG quality of all.
const QUALITY: u8 = 92;

/// An object on its sheet, as cameras see it.
pub(super) struct Stand {
    model: Model,
    /// The sheet that it stands on.
    pub(super) sheet: ObjectSheet,
    /// The gripper's tags.
    pub(super) tags: BoardFile,
    prints: AnnotationMarkers,
    t_world_object: Pose,
    conditions: VisualConditions,
}

/// JPEGs of a grasp.
pub(super) struct Images {
    /// From between the fingers, before closing and before the lift.
    pub(super) hand: [Vec<u8>; 2],
    /// From beside the table, before closing.
    pub(super) beside: Vec<u8>,
    /// The camera beside the table.
    pub(super) intrinsics: Intrinsics,
}

impl Stand {
    /// Prints the sheet and paints the object; the light and the table are those of the seed.
    ///
    /// # Errors
    /// `Input` for an object that no paper is large enough for.
    pub(super) fn new(object: &DemoObject, seed: u64) -> Result<Self> {
        let looks = SeedStream::named(seed, &format!("looks {}", object.name)).bits();
        let lying = SheetObject {
            mesh: &object.mesh,
            source: &object.source,
            t_world_object: object.t_world_object,
        };
        let sheet = default_object_sheet(&object.name, &lying)?;
        let tags = BoardFile::gripper_umi()?;
        Ok(Self {
            model: Model::with_finish(&object.mesh, random_finish(looks), looks)?,
            prints: AnnotationMarkers::new(&sheet.flat_print()?, &tags.flat_prints())?,
            sheet,
            tags,
            t_world_object: object.t_world_object,
            conditions: VisualRandomisation::default().sample(seed),
        })
    }

    /// The camera beside the table, which is the same wherever it stands.
    pub(super) fn intrinsics(&self) -> Intrinsics {
        let state = GraspState {
            t_world_object: self.t_world_object,
            t_world_gripper: self.t_world_object,
            opening_m: 0.08,
            gels: None,
        };
        annotation_camera(&state, BESIDE, 0).intrinsics()
    }

    /// Takes the images of a grasp; the seed moves the camera beside the table and draws noise.
    ///
    /// # Errors
    /// `Interrupted` once the watch is cancelled; `Input` where a camera would be in the ground.
    pub(super) fn photograph(
        &self,
        placed: &GripperState,
        grasped: &Snapshot,
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
        let after = GraspState::from_snapshot(grasped, Some(grid))?;
        let shoot = |scene: &Scene, camera: &Camera, samples, number: u64| {
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
            let image = develop(&light, &colour(number), seed ^ number);
            encode_jpeg(&image, QUALITY)
        };
        let hand = |state: &GraspState, number: u64| {
            let scene = grasp_scene(&self.model, state, &self.conditions, View::EyeInHand(HAND))?;
            shoot(&scene, &scene.camera, HAND_SAMPLES, number)
        };
        let camera = annotation_camera(&before, BESIDE, seed);
        let scene = annotation_scene(&self.model, &before, &self.conditions, camera, &self.prints)?;
        Ok(Images {
            hand: [hand(&before, 1)?, hand(&after, 2)?],
            beside: shoot(&scene, &camera, BESIDE_SAMPLES, BESIDE_NUMBER)?,
            intrinsics: camera.intrinsics(),
        })
    }
}

/// The denoiser of an image.
fn denoise_radius_px(number: u64) -> usize {
    if number == BESIDE_NUMBER {
        BESIDE_DENOISE_PX
    } else {
        DENOISE_RADIUS_PX
    }
}

/// The sensor of an image; that beside the table is sharper and not shrunk from 3 × 3 pixels.
fn colour(number: u64) -> ColourSettings {
    let usual = ColourSettings::default();
    match number {
        BESIDE_NUMBER => ColourSettings {
            full_well_e: 5000.0,
            read_noise_e: 4.0,
            ..usual
        },
        _ => usual,
    }
}
