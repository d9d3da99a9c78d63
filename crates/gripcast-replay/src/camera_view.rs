//! Camera images of a report, recorded and rendered.

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
    ColourSettings, DENOISE_RADIUS_PX, Finish, GraspState, Model, ProceduralTexture, RenderControl,
    RenderSettings, Renderer, View, VisualConditions, VisualRandomisation, denoise, develop,
    grasp_scene,
};

/// Width and height of a camera view, px.
const VIEW: [usize; 2] = [240, 180];
/// Width and height of an object's image, px.
const OBJECT: [usize; 2] = [240, 180];

/// Settings of the path tracer.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewSettings {
    /// Samples per pixel.
    pub(super) spp: u32,
    /// Seed of light and ground.
    pub(super) seed: u64,
}

/// Returns the camera image before the lift, and the simulated one from the nominal camera pose.
/// Light, ground and surface of the object are unknown; the simulated ones are drawn from the seed.
///
/// # Errors
/// `NotFound` or `Input` if the stored frame is missing or damaged; errors of rendering.
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
    let state = GraspState::from_snapshot(snapshot, None)?;
    Ok(ImagePair {
        real: data_uri(&center_crop(&whole))?,
        sim: data_uri(&rendered(object, &state, View::EyeInHand(VIEW), settings)?)?,
    })
}

/// Renders the object on the table below the open gripper, from outside.
///
/// # Errors
/// Errors of rendering.
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

/// Crops and resizes an image to the size of a view.
fn center_crop(image: &RgbImage) -> RgbImage {
    let [width, height] = VIEW.map(|side| side as u32);
    let (w, h) = image.dimensions();
    let scale = f64::max(
        f64::from(width) / f64::from(w),
        f64::from(height) / f64::from(h),
    );
    let cropped_side =
        |side: u32, whole: u32| ((f64::from(side) / scale).round() as u32).clamp(1, whole);
    let (crop_w, crop_h) = (cropped_side(width, w), cropped_side(height, h));
    let cropped = imageops::crop_imm(image, (w - crop_w) / 2, (h - crop_h) / 2, crop_w, crop_h);
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
        t_nominal_camera: Pose::IDENTITY,
        focal_factor: 1.0,
        ..VisualRandomisation::default().sample(settings.seed)
    };
    let model = Model::with_finish(
        &object.mesh,
        Finish::Textured(ProceduralTexture::Plastic),
        settings.seed,
    )?;
    let scene = grasp_scene(&model, state, &conditions, view)?;
    let rendering = Renderer::new(&scene)?.render(
        &scene.camera,
        &RenderSettings {
            samples_per_pixel: settings.spp,
            seed: settings.seed,
            ..RenderSettings::default()
        },
        &RenderControl::default(),
    )?;
    let light = denoise(&rendering, DENOISE_RADIUS_PX);
    Ok(develop(&light, &ColourSettings::default(), settings.seed))
}
