//! Renders camera images of simulated grasps.

use image::RgbImage;
use pyo3::prelude::*;

use super::arrays::{array, image_array};
use super::case::Case;
use super::failure::Outcome;
use super::render::named_moment;
use super::result::GraspResult;
use super::simulation::Simulation;
use super::work::{interruptible, pool};
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_sim::grasp::Snapshot;
use gripcast_tactile::Moment;
use gripcast_visual::{
    ColourSettings, DENOISE_RADIUS_PX, Finish, GraspState, Model, RenderControl, RenderSettings,
    Renderer, View, VisualRandomisation, denoise as denoised, develop, grasp_scene, random_finish,
};

/// Largest side of an image, px.
const MAX_SIDE: usize = 4096;
/// Largest number of samples per pixel.
const MAX_SAMPLES: u32 = 1 << 20;

/// Viewpoints by their names.
const VIEWS: [&str; 2] = ["hand", "outside"];

/// What is rendered, and how.
struct Job {
    mesh: gripcast_geometry::TriangleMesh,
    state: GraspState,
    view: View,
    finish: Option<Finish>,
    samples: u32,
    seed: u64,
    denoise: bool,
}

/// Renders what a camera sees of a simulated grasp, by path tracing.
///
/// `source` is a `GraspResult` at a `moment` (initial, closure, grasp or lift), or a `Simulation` as it
/// is now. `view` is "hand", the eye-in-hand D435, or "outside", beside the gripper and without
/// effects of a sensor. Light, table, camera and noise are drawn from `seed`; the material of the
/// object, too, unless `finish` names one. `samples` are paths per pixel, best a power of two. The
/// image is that of `gripcast render visual`.
#[pyfunction]
#[pyo3(signature = (source, *, moment = None, view = "hand", size_px = (320, 240), samples = 64, seed = 0, finish = None, denoise = false, threads = None))]
#[pyo3(
    text_signature = "(source, *, moment=None, view='hand', size_px=(320, 240), samples=64, seed=0, finish=None, denoise=False, threads=None)"
)]
#[allow(clippy::too_many_arguments)]
pub(crate) fn render_visual(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    moment: Option<&str>,
    view: &str,
    size_px: (usize, usize),
    samples: u32,
    seed: u64,
    finish: Option<&str>,
    denoise: bool,
    threads: Option<usize>,
) -> Outcome<VisualImage> {
    let (width, height) = size_px;
    let is_side = |side: usize| (1..=MAX_SIDE).contains(&side);
    if !is_side(width) || !is_side(height) {
        return Err(Error::usage(format!(
            "`size_px` must be from 1×1 to {MAX_SIDE}×{MAX_SIDE}, found {width}×{height}"
        ))
        .into());
    }
    if !(1..=MAX_SAMPLES).contains(&samples) {
        return Err(Error::usage(format!(
            "`samples` must be from 1 to {MAX_SAMPLES}, found {samples}"
        ))
        .into());
    }
    let view = match view {
        "hand" => View::EyeInHand([width, height]),
        "outside" => View::External([width, height]),
        other => return Err(unknown_name("view", other, &VIEWS).into()),
    };
    let finish = finish.map(str::parse).transpose()?;
    let (mesh, state) = if let Ok(result) = source.cast::<GraspResult>() {
        let grasp = result.get().simulated();
        let moment = named_moment(moment.unwrap_or(Moment::Grasp.name()))?;
        let case = grasp.case();
        let state = match moment.snapshot(grasp.trace())? {
            Some(snapshot) => seen(case, snapshot)?,
            None => {
                case.gel()?;
                GraspState {
                    t_world_object: case.start.t_world_object,
                    t_world_gripper: case.start.gripper.t_world_gripper,
                    opening_m: case.start.gripper.opening_m,
                    gels: None,
                }
            }
        };
        (case.object.mesh.surface().clone(), state)
    } else if let Ok(simulation) = source.cast::<Simulation>() {
        if moment.is_some() {
            let what = "`moment` is of a GraspResult, found a Simulation";
            return Err(Error::usage(what).remedy("omit it").into());
        }
        let simulation = simulation.get();
        let (case, snapshot) = (simulation.simulated(), simulation.snapshot());
        (case.object.mesh.surface().clone(), seen(case, &snapshot)?)
    } else {
        let found = source.get_type().name()?;
        let what = format!("`source` must be a GraspResult or a Simulation, found {found}");
        return Err(Error::usage(what).into());
    };
    let job = Job {
        mesh,
        state,
        view,
        finish,
        samples,
        seed,
        denoise,
    };
    let pool = pool(threads)?;
    let (image, depth_m) = interruptible(py, move |cancel| {
        let control = RenderControl {
            on_progress: None,
            cancel: Some(cancel),
        };
        pool.install(|| job.run(&control))
    })?;
    Ok(VisualImage {
        image: image_array(py, image)?,
        depth_m: array(py, depth_m, &[height, width])?,
    })
}

fn seen(case: &Case, snapshot: &Snapshot) -> Result<GraspState> {
    GraspState::from_snapshot(snapshot, Some(&case.gel()?.grid))
}

impl Job {
    fn run(&self, control: &RenderControl<'_>) -> Result<(RgbImage, Vec<f32>)> {
        let finish = self.finish.unwrap_or_else(|| random_finish(self.seed));
        let model = Model::with_finish(&self.mesh, finish, self.seed)?;
        let conditions = VisualRandomisation::default().sample(self.seed);
        let scene = grasp_scene(&model, &self.state, &conditions, self.view)?;
        let settings = RenderSettings {
            samples_per_pixel: self.samples,
            seed: self.seed,
            ..RenderSettings::default()
        };
        let rendering = Renderer::new(&scene)?.render(&scene.camera, &settings, control)?;
        let depth_m = rendering.depth_m.iter();
        let depth_m = depth_m.map(|depth| if *depth > 0.0 { *depth } else { f32::NAN });
        let depth_m = depth_m.collect();
        let light = match self.denoise {
            true => denoised(&rendering, DENOISE_RADIUS_PX),
            false => rendering.image,
        };
        let sensor = match self.view {
            View::EyeInHand(_) => ColourSettings::default(),
            View::External(_) => ColourSettings::without_sensor(),
        };
        Ok((develop(&light, &sensor, conditions.sensor_seed), depth_m))
    }
}

/// A rendered camera image.
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct VisualImage {
    /// height × width × 3, uint8, RGB.
    image: Py<PyAny>,
    /// height × width, float32, m: true depth along the optical axis; NaN beyond the scene.
    depth_m: Py<PyAny>,
}

#[pymethods]
impl VisualImage {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let shape = self.image.getattr(py, "shape")?;
        Ok(format!("<VisualImage {shape}>"))
    }
}
