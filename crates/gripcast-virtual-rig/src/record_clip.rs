//! Records clips of simulated grasps.

use std::borrow::Cow;
use std::path::Path;

use glam::DVec3;
use image::{RgbImage, imageops};
use serde_json::Value;

use super::clip::{ClipFiles, Keyframes, SAME_TIME_S, clip_header};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh};
use gripcast_imaging::{DepthImage, Intrinsics, encode_png_grey16};
use gripcast_pose::BoardFile;
use gripcast_pose::print::{ObjectSheet, SheetObject, default_object_sheet};
use gripcast_sim::fem::GelGrid;
use gripcast_sim::fields::{FieldSeries, FieldStep};
use gripcast_sim::grasp::{StageName, Trace, TraceFile, TraceStep};
use gripcast_tactile::{TraceHeader, TraceStart};
use gripcast_visual::{
    AnnotationMarkers, Camera, ColourSettings, DENOISE_RADIUS_PX, DepthSettings, GraspState, Model,
    RenderControl, RenderSettings, Renderer, View, VisualConditions, VisualRandomisation,
    annotation_camera, annotation_scene, denoise, develop, grasp_scene, measure_depth,
};

/// Maximum shown steps of each phase: approach, contact, force adjustment, lift.
const FREE_STEPS: usize = 6;
const CONTACT_STEPS: usize = 24;
const ADJUSTING_STEPS: usize = 4;
const LIFTING_STEPS: usize = 10;
/// Shown steps up to the first of them, where a verdict in the lift is formed.
const LIFT_START_STEPS: usize = 5;
/// Maximum keyframes of the approach and of the lift.
const FREE_KEYS: usize = 3;
const LIFTING_KEYS: usize = 3;
/// JPEG quality of the external images, in which markers are detected.
const EXTERNAL_QUALITY: u8 = 88;

/// Settings of [`record_clip`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipSettings {
    /// Columns and rows of the colour images.
    pub colour: [usize; 2],
    /// Columns and rows of the depth images.
    pub depth: [usize; 2],
    /// Columns and rows of the external camera's images.
    pub external: [usize; 2],
    /// Samples per pixel (spp) of the colour images before denoising.
    pub samples: u32,
    /// JPEG quality, 1 to 100.
    pub quality: u8,
    /// Random seed of light, ground, camera and colours.
    pub seed: u64,
}

impl Default for ClipSettings {
    fn default() -> Self {
        Self {
            colour: [480, 360],
            depth: [320, 240],
            external: [1280, 720],
            samples: 64,
            quality: 82,
            seed: 0,
        }
    }
}

/// Records a clip of a simulated grasp of `model` with the shape `mesh` (m, object frame), and
/// reports rendered and total images to `on_progress`.
///
/// The external camera sees the object on its printed sheet and the gripper with the tags of
/// [`BoardFile::gripper_umi`].
///
/// # Errors
/// `Input` for a trace without steps or start, or a scene that cannot be rendered.
pub fn record_clip(
    file: &TraceFile,
    mesh: &TriangleMesh,
    model: &Model,
    settings: &ClipSettings,
    on_progress: &dyn Fn(usize, usize),
) -> Result<ClipFiles> {
    let trace = &file.trace;
    let shown = shown_steps(&trace.steps)?;
    let TraceHeader { gel, object } = TraceHeader::read(&file.header)?;
    let clip_scene = ClipScene {
        trace,
        grid: gel.grid,
        start: TraceStart::read(&file.header)?,
        conditions: VisualRandomisation::default().sample(settings.seed),
        settings,
    };
    let sheet = sheet_of(mesh, &object.source, clip_scene.start.t_world_object)?;
    let tags = BoardFile::gripper_umi()?;
    let prints = AnnotationMarkers::new(&sheet.flat_print()?, &tags.flat_prints())?;
    let beside = annotation_camera(&clip_scene.state(0)?, settings.external, settings.seed);
    let keys = keyframes(trace, &shown, beside.intrinsics());
    let all = keys.keys.len() + keys.depth_keys.len() + keys.external_keys.len();
    let steps = |keys: &[usize]| -> Vec<usize> { keys.iter().map(|key| shown[*key]).collect() };

    let mut colour = Vec::new();
    let mut depth = Vec::new();
    let view = View::EyeInHand(settings.colour);
    // The camera poses do not change during the clip.
    let before = clip_scene.state(0)?;
    let hand = view.camera(&before, &clip_scene.conditions);
    let stereo_view = View::EyeInHand(settings.depth);
    let stereo = stereo_view.camera(&before, &clip_scene.conditions);
    for step in steps(&keys.keys) {
        on_progress(colour.len(), all);
        let renderer = clip_scene.hand_renderer(model, step, view)?;
        colour.push(clip_scene.image(
            &renderer,
            &clip_scene.lifted_camera(&hand, step),
            ColourSettings::default().blur_px,
        )?);
    }
    for step in steps(&keys.depth_keys) {
        on_progress(colour.len() + depth.len(), all);
        let renderer = clip_scene.hand_renderer(model, step, stereo_view)?;
        depth.push(depth_image(
            &renderer,
            &clip_scene.lifted_camera(&stereo, step),
        )?);
    }
    let mut external = Vec::new();
    for step in steps(&keys.external_keys) {
        on_progress(colour.len() + depth.len() + external.len(), all);
        let state = clip_scene.state(step)?;
        let scene = annotation_scene(model, &state, &clip_scene.conditions, beside, &prints)?;
        external.push(clip_scene.image(&Renderer::new(&scene)?, &beside, 0.0)?);
    }
    Ok(ClipFiles {
        trace: Cow::Owned(thinned(&file.header, trace, &shown, &keys)?),
        colour: Cow::Owned(jpeg_strip(&colour, settings.quality)?),
        depth: Cow::Owned(png_strip(&depth)?),
        external: Cow::Owned(jpeg_strip(&external, EXTERNAL_QUALITY)?),
        sheet: Cow::Owned(sheet.file.to_toml().into_bytes()),
    })
}

/// Returns the sheet for an object in its initial pose, named after its mesh.
fn sheet_of(mesh: &TriangleMesh, source: &str, t_world_object: Pose) -> Result<ObjectSheet> {
    let object = SheetObject {
        mesh,
        source,
        t_world_object,
    };
    let named = source.strip_prefix("builtin:").unwrap_or(source);
    let name = Path::new(named).file_stem().unwrap_or_default();
    default_object_sheet(&name.to_string_lossy(), &object)
}

/// Trace and render settings common to all images of a clip.
struct ClipScene<'a> {
    trace: &'a Trace,
    grid: GelGrid,
    start: TraceStart,
    conditions: VisualConditions,
    settings: &'a ClipSettings,
}

impl ClipScene<'_> {
    /// Returns a gripper-mounted camera at a step.
    fn lifted_camera(&self, camera: &Camera, step: usize) -> Camera {
        let lift = Pose::from_translation(DVec3::Z * self.trace.steps[step].lifted_m);
        Camera {
            t_world_camera: lift * camera.t_world_camera,
            ..*camera
        }
    }

    /// Returns the state at a step; deformed gels are stored at the ends of the stages only.
    fn state(&self, step: usize) -> Result<GraspState> {
        let current = &self.trace.steps[step];
        let is_now = |t_s: f64| (t_s - current.t_s).abs() < 1e-9;
        if let Some(snapshot) = self.trace.snapshots.iter().find(|s| is_now(s.t_s)) {
            return GraspState::from_snapshot(snapshot, Some(&self.grid));
        }
        let lift = Pose::from_translation(DVec3::Z * current.lifted_m);
        Ok(GraspState {
            t_world_object: current.t_world_object,
            t_world_gripper: lift * self.start.t_world_gripper(),
            opening_m: current.opening_m,
            gels: None,
        })
    }

    /// Returns the renderer of the cameras on the gripper at a step.
    fn hand_renderer(&self, model: &Model, step: usize, view: View) -> Result<Renderer> {
        let state = self.state(step)?;
        Renderer::new(&grasp_scene(model, &state, &self.conditions, view)?)
    }

    fn image(&self, renderer: &Renderer, camera: &Camera, blur_px: f32) -> Result<RgbImage> {
        let settings = RenderSettings {
            samples_per_pixel: self.settings.samples,
            seed: self.settings.seed,
            ..RenderSettings::default()
        };
        let rendering = renderer.render(camera, &settings, &RenderControl::default())?;
        let light = denoise(&rendering, DENOISE_RADIUS_PX);
        // Noise is added per frame at playback.
        let colour = ColourSettings {
            full_well_e: 1e9,
            read_noise_e: 0.0,
            blur_px,
            ..ColourSettings::default()
        };
        Ok(develop(&light, &colour, 0))
    }
}

fn depth_image(renderer: &Renderer, camera: &Camera) -> Result<DepthImage> {
    let noiseless = DepthSettings {
        disparity_std_px: 0.0,
        ..DepthSettings::default()
    };
    measure_depth(&renderer.depth(camera)?, camera, &noiseless, 0)
}

/// Returns the indices of the shown steps: few in the approach, most while the gels deform.
fn shown_steps(steps: &[TraceStep]) -> Result<Vec<usize>> {
    if steps.is_empty() {
        return Err(Error::input("the trace has no steps")
            .remedy("use the trace of a grasp whose simulation converged"));
    }
    let [free, closure, before_lift] = phase_ends(steps.iter());
    let mut shown = vec![0];
    for (from, to, max) in [
        (0, free, FREE_STEPS),
        (free, closure, CONTACT_STEPS),
        (closure, before_lift, ADJUSTING_STEPS),
    ] {
        shown.extend(spread(from, to, max));
    }
    let mut lifting = spread(before_lift, steps.len(), LIFTING_STEPS);
    if let Some(first) = lifting.next() {
        shown.extend(spread(before_lift, first + 1, LIFT_START_STEPS));
        shown.extend(lifting);
    }
    shown.dedup();
    Ok(shown)
}

/// Returns the number of steps before first contact, before the end of closure, and before the
/// lift.
fn phase_ends<'a>(steps: impl Iterator<Item = &'a TraceStep> + Clone) -> [usize; 3] {
    let count = |is: fn(&TraceStep) -> bool| steps.clone().take_while(|step| is(step)).count();
    [
        count(|s| s.min_gap_m == [None, None] && s.stage == StageName::Closure),
        count(|s| s.stage == StageName::Closure),
        count(|s| s.stage != StageName::Lift),
    ]
}

/// Returns at most `max` evenly spaced indices of `from..to`, always with the last.
fn spread(from: usize, to: usize, max: usize) -> impl Iterator<Item = usize> {
    let length = to - from;
    let count = length.min(max);
    (1..=count).map(move |n| from + (n * length).div_ceil(count) - 1)
}

/// Selects keyframes among the shown steps.
fn keyframes(trace: &Trace, shown: &[usize], external_camera: Intrinsics) -> Keyframes {
    let [free, _, before_lift] = phase_ends(shown.iter().map(|step| &trace.steps[*step]));
    let mut keys = vec![0];
    keys.extend(spread(0, free, FREE_KEYS));
    // The fingers hardly move in contact: first contact and end of closure are enough.
    keys.extend([
        free.min(before_lift.saturating_sub(1)),
        before_lift.saturating_sub(1),
    ]);
    let lifting = (before_lift + LIFT_START_STEPS - 1).min(shown.len());
    keys.extend(spread(lifting, shown.len(), LIFTING_KEYS));
    keys.dedup();
    // The motion of the object in the lift is measured in depth images.
    let mut depth_keys: Vec<usize> = keys
        .iter()
        .copied()
        .chain(before_lift..shown.len())
        .collect();
    depth_keys.sort_unstable();
    depth_keys.dedup();
    let mut external_keys = vec![0, before_lift.saturating_sub(1), shown.len() - 1];
    external_keys.dedup();
    Keyframes {
        keys,
        depth_keys,
        external_keys,
        external_camera,
    }
}

fn thinned(header: &Value, trace: &Trace, shown: &[usize], keys: &Keyframes) -> Result<Vec<u8>> {
    let thin = TraceFile {
        header: clip_header(header, keys)?,
        trace: Trace {
            steps: shown
                .iter()
                .map(|step| trace.steps[*step].clone())
                .collect(),
            snapshots: Vec::new(),
            lift_snapshots: Vec::new(),
            fields: shown_fields(trace, shown),
        },
    };
    thin.to_bytes()
}

/// Returns the fields of the gels' faces at the shown steps, if they were recorded.
fn shown_fields(trace: &Trace, shown: &[usize]) -> Option<FieldSeries> {
    let all = trace.fields.as_ref()?;
    let is_shown = |field: &FieldStep| {
        let same = |step: &&usize| (trace.steps[**step].t_s - field.t_s).abs() < SAME_TIME_S;
        shown.iter().any(|step| same(&step))
    };
    let steps = all.steps.iter().filter(|field| is_shown(field));
    Some(FieldSeries {
        steps: steps.cloned().collect(),
        ..all.clone()
    })
}

fn jpeg_strip(images: &[RgbImage], quality: u8) -> Result<Vec<u8>> {
    let (width, height) = images.first().map_or((0, 0), RgbImage::dimensions);
    let mut strip = RgbImage::new(width, height * images.len() as u32);
    for (number, image) in images.iter().enumerate() {
        imageops::replace(&mut strip, image, 0, i64::from(height) * number as i64);
    }
    let image = turbojpeg::Image {
        pixels: strip.as_raw().as_slice(),
        width: width as usize,
        pitch: 3 * width as usize,
        height: strip.height() as usize,
        format: turbojpeg::PixelFormat::RGB,
    };
    turbojpeg::compress(image, i32::from(quality), turbojpeg::Subsamp::Sub2x2)
        .map(|jpeg| jpeg.to_vec())
        .map_err(|e| Error::internal("cannot encode the images").because(e))
}

fn png_strip(images: &[DepthImage]) -> Result<Vec<u8>> {
    let (width, height) = images.first().map_or((0, 0), DepthImage::dimensions);
    let raw: Vec<u16> = images.iter().flat_map(|p| p.as_raw()).copied().collect();
    let strip = DepthImage::from_vec(width, height * images.len() as u32, raw)
        .ok_or_else(|| Error::internal("the depth strip has the wrong size"))?;
    encode_png_grey16(&strip)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use serde_json::json;

    use super::*;
    use crate::clip::Clip;
    use gripcast_geometry::{PrepareOptions, builtin, prepare};
    use gripcast_sim::fem::{GelPad, GelResolution};
    use gripcast_sim::grasp::GelForce;
    use gripcast_visual::demo_model;

    fn step(stage: StageName, opening_m: f64, gap: Option<f64>, lifted_m: f64) -> TraceStep {
        TraceStep {
            stage,
            t_s: 0.0,
            force: [GelForce::default(); 2],
            t_world_object: Pose::from_translation(DVec3::new(0.0, 0.0, 0.03 + lifted_m)),
            opening_m,
            lifted_m,
            min_gap_m: [gap; 2],
            solver: None,
        }
    }

    fn intrinsics() -> Intrinsics {
        Camera::centred(64, 36, 1.0, Pose::IDENTITY).intrinsics()
    }

    /// 30 steps of approach, 40 in contact, 100 of adjustment, 50 of lift.
    fn trace() -> Trace {
        let free = (0..30).map(|n| step(StageName::Closure, 0.07 - 1e-3 * f64::from(n), None, 0.0));
        let touching = (0..40).map(|n| {
            step(
                StageName::Closure,
                0.04 - 2e-5 * f64::from(n),
                Some(3e-4),
                0.0,
            )
        });
        let adjusting = (0..100).map(|_| step(StageName::Adjustment, 0.039, Some(3e-4), 0.0));
        let lifted =
            (1..=50).map(|n| step(StageName::Lift, 0.039, Some(3e-4), 1e-3 * f64::from(n)));
        let steps = free.chain(touching).chain(adjusting).chain(lifted);
        Trace {
            steps: steps.collect(),
            snapshots: Vec::new(),
            lift_snapshots: Vec::new(),
            fields: None,
        }
    }

    fn file() -> TraceFile {
        let mesh = prepare(&builtin("box").unwrap(), &PrepareOptions::default())
            .unwrap()
            .mesh;
        let grid = GelPad::default().grid(GelResolution::Coarse).unwrap();
        let upright = json!({"t_m": [0.0, 0.0, 0.03], "q_wxyz": [1.0, 0.0, 0.0, 0.0]});
        let above = json!({"t_m": [0.0, 0.0, 0.0], "q_wxyz": [0.0, 1.0, 0.0, 0.0]});
        TraceFile {
            header: json!({
                "outcome": "success",
                "lifted_m": 0.05,
                "wall_s": 1.0,
                "object": {"source": "builtin:box", "sha256": mesh.content_hash(),
                    "mass_kg": 0.1, "friction": 0.4},
                "pose": {"t_world_object": upright, "t_object_gripper": above, "opening_m": 0.07},
                "parameters": {"solver": {"d_hat_m": 5e-4}},
                "gel_axes_m": grid.axes(),
            }),
            trace: trace(),
        }
    }

    #[test]
    fn shown_steps_favour_contact_over_approach() {
        let trace = trace();
        let shown = shown_steps(&trace.steps).unwrap();
        assert!(shown.windows(2).all(|pair| pair[0] < pair[1]), "{shown:?}");
        assert_eq!((shown[0], *shown.last().unwrap()), (0, 219));
        let within =
            |from: usize, to: usize| shown.iter().filter(|s| (from..to).contains(*s)).count();
        assert_eq!(
            [
                within(1, 30),
                within(30, 70),
                within(70, 170),
                within(170, 220)
            ],
            [
                FREE_STEPS,
                CONTACT_STEPS,
                ADJUSTING_STEPS,
                LIFT_START_STEPS + LIFTING_STEPS - 1
            ]
        );
        // The ends of closure and adjustment are shown.
        assert!(shown.contains(&69) && shown.contains(&169));
        let keys = keyframes(&trace, &shown, intrinsics());
        let stages: Vec<_> = keys
            .keys
            .iter()
            .map(|k| trace.steps[shown[*k]].stage)
            .collect();
        assert_eq!(
            stages.iter().filter(|s| **s == StageName::Lift).count(),
            LIFTING_KEYS
        );
        assert_eq!(keys.external_keys.len(), 3);
        assert_eq!(
            trace.steps[shown[keys.external_keys[1]]].stage,
            StageName::Adjustment
        );
    }

    #[test]
    fn short_trace_keeps_all_steps() {
        for length in [1, 2, 31, 75] {
            let mut trace = trace();
            trace.steps.truncate(length);
            let shown = shown_steps(&trace.steps).unwrap();
            assert_eq!(*shown.last().unwrap(), length - 1);
            let keys = keyframes(&trace, &shown, intrinsics());
            for keys in [keys.keys, keys.external_keys] {
                assert!(keys.windows(2).all(|pair| pair[0] < pair[1]), "{keys:?}");
                assert!(keys[0] == 0 && *keys.last().unwrap() < shown.len());
            }
        }
        assert!(
            shown_steps(&[])
                .unwrap_err()
                .to_string()
                .contains("no steps")
        );
    }

    #[test]
    fn clip_plays_back_the_simulated_grasp() {
        let file = file();
        let model = demo_model("box", 1).unwrap();
        let settings = ClipSettings {
            colour: [24, 18],
            depth: [16, 12],
            external: [64, 36],
            samples: 1,
            seed: 4,
            ..ClipSettings::default()
        };
        let mesh = builtin("box").unwrap();
        let files = record_clip(&file, &mesh, &model, &settings, &|_, _| {}).unwrap();
        let clip = Clip::parse("box", files, Path::new("")).unwrap();
        clip.check().unwrap();
        let shown = shown_steps(&file.trace.steps).unwrap();
        assert_eq!(clip.steps.len(), shown.len());
        assert_eq!(clip.steps[clip.step_at(1.0)], file.trace.steps[169]);
        assert_eq!(clip.steps[clip.step_at(2.0)], file.trace.steps[219]);
        let truth = clip.truth_at(clip.step_at(2.0));
        assert!(truth.stable && truth.object == "builtin:box");
        // The gripper rises with the object, so their relative pose is constant.
        let drift =
            truth.t_object_gripper.translation_m - truth.t_object_gripper_initial.translation_m;
        assert!(drift.length() < 1e-12);
        let depth = clip.depth_mm().unwrap();
        let farthest = |key: usize| depth[key].iter().copied().max().unwrap();
        assert!(
            farthest(depth.len() - 1) > farthest(0) + 30,
            "the table must recede during the lift"
        );
    }
}
