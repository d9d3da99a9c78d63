//! `gripcast render visual`: path-traced images of the eye-in-hand camera.
//!
//! ```text
//! gripcast render visual --trace grasp.bin --out grasp.png
//! gripcast render visual --trace *.bin --count 3 --hdri studio.hdr --depth --out images
//! gripcast render visual --object part.glb --pose grasp.json --view outside --out part.png
//! ```
//!
//! Light, ground, colours, camera and noise are drawn from `--seed`; `--hdri` and `--ground` name
//! the images to draw from, else they are procedural. The sampler is a low-discrepancy sequence:
//! powers of two are best for `--spp`.
//!
//! `--out` is a `.png` for one image, else a folder of `TRACE.MOMENT.NUMBER.png`. `--depth` writes
//! the depth image of a D435 beside each as `….depth.png`: 16 bits, mm, 0 without a measurement.
//!
//! Exit codes: 0 rendered · 1 nothing rendered · 2 usage · 3 some of several traces failed ·
//! 130 interrupted.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use image::RgbImage;
use serde::Serialize;

use super::Context;
use super::flags::{ThreadsFlag, above_zero, image_size, moment, number};
use super::mesh_repair::RepairFlags;
use super::render_out::{OutPlan, Report};
use super::render_source::{ObjectSource, SimulatedGrasp};
use super::sim_object::{default_resting_pose, read_grasp_pose};
use super::working::{Progress, interruptible};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::save;
use gripcast_base::number::NumberRange;
use gripcast_geometry::{LengthUnit, MeshOptions};
use gripcast_imaging::{encode_png_grey16, encode_png_rgb};
use gripcast_sim::grasp::Placement;
use gripcast_tactile::Moment;
use gripcast_visual::{
    Bitmap, ColourSettings, DENOISE_RADIUS_PX, DepthSettings, Finish, GraspState, Image, Model,
    ProceduralTexture, RenderControl, RenderSettings, Renderer, Sky, View, VisualConditions,
    VisualRandomisation, denoise, develop, grasp_scene, load_bitmap, load_hdr, measure_depth,
    normalise_env_map, white_table_luminance,
};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Traces of simulated grasps
    #[arg(long, value_name = "FILE", num_args = 1.., required_unless_present = "object")]
    trace: Vec<PathBuf>,
    /// Output image, or folder for several
    #[arg(long, value_name = "FILE.png|DIR")]
    out: PathBuf,
    /// Moments of the grasp, comma-separated
    #[arg(long, value_parser = moment(), value_delimiter = ',', default_value = "grasp")]
    moment: Vec<Moment>,
    /// Camera
    #[arg(long, value_enum, default_value_t = ViewName::Hand)]
    view: ViewName,
    /// Also write the depth image of a D435
    #[arg(long)]
    depth: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    object: ObjectFlags,
    #[command(flatten)]
    scene: SceneFlags,
    #[command(flatten)]
    quality: QualityFlags,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Object")]
struct ObjectFlags {
    /// Mesh that replaces the one named by the trace, or is rendered without a trace
    #[arg(long, value_name = "MESH|builtin:NAME")]
    object: Option<String>,
    /// Unit of the mesh coordinates of --object without a trace: mm, cm, m, in
    #[arg(long, default_value_t = LengthUnit::Metre)]
    unit: LengthUnit,
    #[command(flatten)]
    repair: RepairFlags,
    /// Scale factor of --object without a trace
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = above_zero)]
    scale: f64,
    /// JSON file with t_object_gripper, for --object without a trace
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with = "trace",
        requires = "object"
    )]
    pose: Option<PathBuf>,
    /// Material of an object without its own [default: drawn from the seed]
    #[arg(long, value_name = "NAME")]
    finish: Option<Finish>,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Scene randomisation")]
struct SceneFlags {
    /// Random seed
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Images per moment, each with its own random scene
    #[arg(long, value_name = "N", default_value_t = 1,
        value_parser = clap::value_parser!(u32).range(1..=1000))]
    count: u32,
    /// Environment maps (Radiance HDR) to draw from [default: procedural rooms and skies]
    #[arg(long, value_name = "FILE.hdr", num_args = 1..)]
    hdri: Vec<PathBuf>,
    /// Procedural lights to draw from: studio, window-room, overcast, sunny [default: all]
    #[arg(
        long,
        value_name = "NAME",
        value_delimiter = ',',
        conflicts_with = "hdri"
    )]
    sky: Vec<Sky>,
    /// Ground textures to draw from [default: procedural]
    #[arg(long, value_name = "FILE", num_args = 1..)]
    ground: Vec<PathBuf>,
    /// Procedural grounds to draw from: wood, stone, concrete, tiles, … [default: all table
    /// materials]
    #[arg(
        long,
        value_name = "NAME",
        value_delimiter = ',',
        conflicts_with = "ground"
    )]
    pattern: Vec<ProceduralTexture>,
    /// Width of a ground texture
    #[arg(long, value_name = "M", default_value_t = 0.5, value_parser = above_zero)]
    ground_width_m: f64,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Quality")]
struct QualityFlags {
    /// Image size, px
    #[arg(long, value_name = "WxH", default_value = "320x240", value_parser = image_size)]
    size: [usize; 2],
    /// Samples per pixel
    #[arg(long, value_name = "N", default_value_t = 64,
        value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    spp: u32,
    /// Maximum path depth (bounces)
    #[arg(long, value_name = "N", default_value_t = 6)]
    bounces: u32,
    /// Maximum radiance of one sample (biased) [default: unlimited]
    #[arg(long, value_name = "RADIANCE", value_parser = radiance)]
    clamp: Option<f32>,
    /// Denoise, guided by albedo, normal and depth
    #[arg(long)]
    denoise: bool,
    #[command(flatten)]
    threads: ThreadsFlag,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ViewName {
    /// Eye-in-hand D435
    Hand,
    /// External view beside the gripper, without sensor effects
    Outside,
}

/// A written image.
#[derive(Debug, Serialize)]
struct Written {
    file: PathBuf,
    moment: &'static str,
    seed: u64,
    wall_s: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<PathBuf>,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let plan = args.plan();
    plan.prepare("one --moment and --count 1")?;
    let json = args.json;
    let pool = args.quality.threads.pool()?;
    let report = interruptible(context, "rendering", move |progress| {
        pool.install(|| Job::new(&args, &plan, progress)?.run())
    })??;
    report.conclude(json, |w: &Written| {
        format!("{}: {:.1} s", w.file.display(), w.wall_s)
    })
}

impl Args {
    fn plan(&self) -> OutPlan {
        let is_single = self.trace.len() <= 1 && self.moment.len() == 1 && self.scene.count == 1;
        OutPlan {
            out: self.out.clone(),
            is_single,
        }
    }
}

/// Rendering of all images.
struct Job<'a> {
    args: &'a Args,
    plan: &'a OutPlan,
    progress: &'a Progress,
    randomisation: VisualRandomisation,
}

impl<'a> Job<'a> {
    fn new(args: &'a Args, plan: &'a OutPlan, progress: &'a Progress) -> Result<Self> {
        let env_map = |path: &PathBuf| -> Result<Arc<Image>> {
            let mut image = load_hdr(path)?;
            if white_table_luminance(&image) <= 0.0 {
                return Err(Error::input(
                    "the environment map has no light above the horizon: all images would be dark",
                )
                .at(path.display())
                .remedy("check the file, or leave `--hdri` out"));
            }
            normalise_env_map(&mut image);
            Ok(Arc::new(image))
        };
        let width = args.scene.ground_width_m;
        let ground = |path: &PathBuf| -> Result<(Arc<Bitmap>, f64)> {
            Ok((Arc::new(load_bitmap(path)?), width))
        };
        Ok(Self {
            args,
            plan,
            progress,
            randomisation: VisualRandomisation {
                env_maps: args.scene.hdri.iter().map(env_map).collect::<Result<_>>()?,
                ground_images: args
                    .scene
                    .ground
                    .iter()
                    .map(ground)
                    .collect::<Result<_>>()?,
                skies: args.scene.sky.clone(),
                ground_textures: args.scene.pattern.clone(),
                ..VisualRandomisation::default()
            },
        })
    }

    fn run(&self) -> Result<Report<Written>> {
        let traces = &self.args.trace;
        if traces.is_empty() {
            return Ok(Report::new(self.without_trace()?));
        }
        Report::of_traces(traces, self.progress, |trace| self.of_trace(trace))
    }

    fn of_trace(&self, trace: &Path) -> Result<Vec<Written>> {
        let grasp = SimulatedGrasp::read(trace, self.args.object.object.as_deref())?;
        let stem = trace.file_stem().unwrap_or_default().to_string_lossy();
        let mut written = Vec::new();
        for &moment in &self.args.moment {
            let state = match grasp.snapshot(moment)? {
                Some(snapshot) => GraspState::from_snapshot(snapshot, Some(&grasp.gel.grid))?,
                None => {
                    let start = &grasp.start;
                    GraspState {
                        t_world_object: start.t_world_object,
                        t_world_gripper: start.t_world_gripper(),
                        opening_m: start.opening_m,
                        gels: None,
                    }
                }
            };
            written.extend(self.images(&grasp.object, &state, &stem, moment.name())?);
        }
        Ok(written)
    }

    fn without_trace(&self) -> Result<Vec<Written>> {
        let flags = &self.args.object;
        let Some(name) = &flags.object else {
            return Err(Error::usage("`--trace` or `--object` is needed"));
        };
        let source = ObjectSource {
            name: name.clone(),
            options: MeshOptions {
                prepare: flags.repair.surface_options(),
                ..MeshOptions::new(flags.unit, flags.scale)
            },
        };
        let mesh = source.load()?;
        let pose = flags.pose.as_deref().map(read_grasp_pose).transpose()?;
        let t_world_object = match pose.as_ref().and_then(|pose| pose.t_world_object) {
            Some(t_world_object) => t_world_object,
            None => default_resting_pose(&mesh)?,
        };
        let placed = match pose {
            Some(pose) => pose.place(&mesh, &t_world_object),
            None => Placement::default().place(&mesh, &t_world_object)?,
        };
        let state = GraspState {
            t_world_object,
            t_world_gripper: placed.t_world_gripper,
            opening_m: placed.opening_m,
            gels: None,
        };
        let stem = Path::new(name).file_stem().unwrap_or_default();
        let stem = stem.to_string_lossy().replace(':', "-");
        self.images(&source, &state, &stem, Moment::Initial.name())
    }

    /// Renders all images of a moment.
    fn images(
        &self,
        object: &ObjectSource,
        state: &GraspState,
        stem: &str,
        moment: &'static str,
    ) -> Result<Vec<Written>> {
        let flags = &self.args.scene;
        let mut written = Vec::new();
        for number in 0..flags.count {
            let seed = flags.seed.wrapping_add(u64::from(number));
            let model = object.model(self.args.object.finish, seed, self.progress)?;
            let out = self.plan.file(&format!("{stem}.{moment}.{number}.png"));
            written.push(self.image(&model, state, seed, moment, out)?);
        }
        Ok(written)
    }

    fn image(
        &self,
        model: &Model,
        state: &GraspState,
        seed: u64,
        moment: &'static str,
        out: PathBuf,
    ) -> Result<Written> {
        let began = Instant::now();
        let quality = &self.args.quality;
        let view = match self.args.view {
            ViewName::Hand => View::EyeInHand(quality.size),
            ViewName::Outside => View::External(quality.size),
        };
        let conditions = self.randomisation.sample(seed);
        let scene = grasp_scene(model, state, &conditions, view)?;
        let settings = RenderSettings {
            samples_per_pixel: quality.spp,
            max_bounces: quality.bounces,
            clamp: quality.clamp,
            seed,
            ..RenderSettings::default()
        };
        let progress = |done: usize, all: usize| self.progress.count(done, all);
        let watch = RenderControl {
            on_progress: self.plan.is_single.then_some(&progress),
            cancel: None,
        };
        let renderer = Renderer::new(&scene)?;
        let rendering = renderer.render(&scene.camera, &settings, &watch)?;
        let light = if quality.denoise {
            denoise(&rendering, DENOISE_RADIUS_PX)
        } else {
            rendering.image
        };
        save(&out, &encode_png_rgb(&self.developed(&light, &conditions))?)?;
        let depth = self.args.depth.then(|| out.with_extension("depth.png"));
        if let Some(path) = &depth {
            let (settings, seed) = (DepthSettings::default(), conditions.sensor_seed);
            let depth = measure_depth(&rendering.depth_m, &scene.camera, &settings, seed)?;
            save(path, &encode_png_grey16(&depth)?)?;
        }
        Ok(Written {
            file: out,
            moment,
            seed,
            wall_s: began.elapsed().as_secs_f64(),
            depth,
        })
    }

    fn developed(&self, light: &Image, conditions: &VisualConditions) -> RgbImage {
        let settings = match self.args.view {
            ViewName::Hand => ColourSettings::default(),
            ViewName::Outside => ColourSettings::without_sensor(),
        };
        develop(light, &settings, conditions.sensor_seed)
    }
}

/// Parses a radiance above 0.
fn radiance(text: &str) -> Result<f32, String> {
    let range = NumberRange::above(0.0, f64::from(f32::MAX));
    number(range)(text).map(|value| value as f32)
}
