//! Images of a report: the camera's view beside the path tracer's.

use image::{RgbImage, imageops};

use super::object_file::ReplayObject;
use super::recording::RecordedGrasp;
use super::report::ImagePair;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::FileKind;
use gripcast_dataset::{Dataset, Stage};
use gripcast_geometry::Pose;
use gripcast_imaging::{Decoder, Role};
use gripcast_report::image::data_uri;
use gripcast_sim::grasp::Snapshot;
use gripcast_visual::{
    ColourSettings, DenoiseSettings, Finish, GraspState, Model, Pattern, RenderSettings, Renderer,
    View, VisualConditions, VisualRandomisation, Watch, denoise, develop, grasp_scene,
};

/// Columns and rows of a view.
const VIEW: [usize; 2] = [240, 180];
/// Columns and rows of an object's image.
const OBJECT: [usize; 2] = [240, 180];

/// How the path tracer draws.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewSettings {
    /// Paths for each pixel.
    pub(super) samples: u32,
    /// Seed of light and ground.
    pub(super) seed: u64,
}

/// The camera's image before the lift, and the simulation's from the nominal place of the
/// camera. Light, ground and the object's surface are not known; the simulated ones are drawn
/// from the seed.
///
/// # Errors
/// `NotFound` or `Input` where the stored frame is missing or damaged; those of rendering.
pub(super) fn view_pair(
    dataset: &Dataset,
    grasp: &RecordedGrasp,
    object: &ReplayObject,
    snapshot: &Snapshot,
    settings: &ViewSettings,
) -> Result<ImagePair> {
    let camera = grasp.record.grasp.cameras.get(&Role::Rgb);
    let size = camera.map_or([0; 2], |camera| [camera.width, camera.height]);
    let path = dataset.image_path(&grasp.record, Stage::Grasp, Role::Rgb);
    let path = path.ok_or_else(|| Error::not_found("the grasp has no colour image"))?;
    let bytes = path
        .read(FileKind::Image)
        .map_err(|e| Error::io("cannot read the colour image", e).at(path.display()))?;
    let whole = Decoder::new()?.decode_file(&bytes, None, size[0], size[1])?;
    let state = GraspState::at(snapshot, None)?;
    Ok(ImagePair {
        real: data_uri(&middle(&whole))?,
        sim: data_uri(&rendered(object, &state, View::EyeInHand(VIEW), settings)?)?,
    })
}

/// The object on the table with the gripper open above it, from outside.
///
/// # Errors
/// Those of rendering.
pub(super) fn object_image(
    object: &ReplayObject,
    grasp: &RecordedGrasp,
    settings: &ViewSettings,
) -> Result<String> {
    let state = GraspState {
        t_world_object: grasp.setup.t_world_object,
        t_world_gripper: grasp.setup.t_world_gripper,
        opening_m: grasp.setup.opening_m,
        gels: None,
    };
    data_uri(&rendered(object, &state, View::External(OBJECT), settings)?)
}

/// The middle of an image in the shape of a view.
fn middle(image: &RgbImage) -> RgbImage {
    let [width, height] = VIEW.map(|side| side as u32);
    let (w, h) = image.dimensions();
    let scale = f64::max(
        f64::from(width) / f64::from(w),
        f64::from(height) / f64::from(h),
    );
    let cut = |side: u32, whole: u32| ((f64::from(side) / scale).round() as u32).clamp(1, whole);
    let (cut_w, cut_h) = (cut(width, w), cut(height, h));
    let cropped = imageops::crop_imm(image, (w - cut_w) / 2, (h - cut_h) / 2, cut_w, cut_h);
    imageops::resize(
        &cropped.to_image(),
        width,
        height,
        imageops::FilterType::Triangle,
    )
}

fn rendered(
    object: &ReplayObject,
    state: &GraspState,
    view: View,
    settings: &ViewSettings,
) -> Result<RgbImage> {
    let conditions = VisualConditions {
        camera_move: Pose::IDENTITY,
        focal_factor: 1.0,
        ..VisualRandomisation::default().sample(settings.seed)
    };
    let model = Model::plain(
        &object.mesh,
        Finish::Painted(Pattern::Plastic),
        settings.seed,
    )?;
    let scene = grasp_scene(&model, state, &conditions, view)?;
    let rendering = Renderer::new(&scene)?.render(
        &scene.camera,
        &RenderSettings {
            samples: settings.samples,
            seed: settings.seed,
            ..RenderSettings::default()
        },
        &Watch::default(),
    )?;
    let light = denoise(&rendering, &DenoiseSettings::default());
    Ok(develop(&light, &ColourSettings::default(), settings.seed))
}
