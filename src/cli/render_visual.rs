//! `gripcast render visual`: path-traced images of the camera between the fingers.
//!
//! ```text
//! gripcast render visual --trace grasp.bin --out grasp.png
//! gripcast render visual --trace *.bin --count 3 --hdri studio.hdr --depth --out images
//! gripcast render visual --object part.glb --pose grasp.json --view outside --out part.png
//! ```
//!
//! Light, ground, colours, camera and noise are drawn from `--seed`; `--hdri` and `--ground` name
//! the images to draw from, else they are painted. Paths are spread by a low-discrepancy
//! sequence, so powers of two are best for `--samples`. Nothing is clamped unless `--clamp` is
//! given, and `--denoise` is off.
//!
//! `--out` is a `.png` for one image, else a folder, which then holds `TRACE.MOMENT.NUMBER.png`.
//! `--depth` writes what the D435 would measure beside each as `….depth.png`, 16 bits, one unit a
//! millimetre, 0 where it measures nothing.
//!
//! Exit codes: 0 rendered · 1 nothing could be rendered · 2 usage · 3 some of several traces
//! could not be rendered · 130 interrupted.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use image::RgbImage;
use serde::Serialize;

use super::render_out::{OutPlan, Report};
use super::render_source::{Moment, ObjectSource, SimulatedGrasp};
use super::sim_object::unit;
use super::working::{Progress, interruptible};
use super::{Context, print, print_json};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::save;
use gripcast_geometry::{LengthUnit, Pose};
use gripcast_imaging::{encode_png_grey16, encode_png_rgb};
use gripcast_sim::grasp::{GraspPose, GripperState, Placement, resting_pose};
use gripcast_visual::{
    Bitmap, ColourSettings, DENOISE_RADIUS_PX, DepthSettings, Finish, GraspState, Image, Model,
    ProceduralTexture, RenderControl, RenderSettings, Renderer, Sky, View, VisualConditions,
    VisualRandomisation, denoise, develop, grasp_scene, load_bitmap, load_hdr, measure_depth,
    normalise_env_map,
};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Traces of simulated grasps
    #[arg(long, value_name = "FILE", num_args = 1.., required_unless_present = "object")]
    trace: Vec<PathBuf>,
    #[command(flatten)]
    object: ObjectFlags,
    /// When
    #[arg(long, value_enum, value_delimiter = ',', default_value = "grasp")]
    moment: Vec<Moment>,
    /// Which camera
    #[arg(long, value_enum, default_value_t = ViewName::Hand)]
    view: ViewName,
    #[command(flatten)]
    look: LookFlags,
    #[command(flatten)]
    quality: QualityFlags,
    /// Image, or folder for several
    #[arg(long, value_name = "FILE.png|DIR")]
    out: PathBuf,
    /// Write what the D435 would measure as depth as well
    #[arg(long)]
    depth: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "What is seen")]
struct ObjectFlags {
    /// Mesh that replaces the one named by the trace, or that is shown without a trace
    #[arg(long, value_name = "MESH|builtin:NAME")]
    object: Option<String>,
    /// Unit of the coordinates in --object without a trace: mm, cm, m, in
    #[arg(long, default_value_t = LengthUnit::Metre, value_parser = unit)]
    unit: LengthUnit,
    /// Factor on the size of --object without a trace
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    /// JSON with t_object_gripper, as `sim grasp` takes it, for an object without a trace
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with = "trace",
        requires = "object"
    )]
    pose: Option<PathBuf>,
    /// Material of what has none of its own [default: drawn from the seed]
    #[arg(long, value_name = "NAME", value_parser = finish)]
    finish: Option<Finish>,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Light, ground and seed")]
struct LookFlags {
    /// Radiance files to draw the light from [default: painted rooms and skies]
    #[arg(long, value_name = "FILE.hdr", num_args = 1..)]
    hdri: Vec<PathBuf>,
    /// Kinds of painted light to draw from: studio, window-room, overcast, sunny [default: all]
    #[arg(long, value_name = "NAME", value_delimiter = ',', value_parser = sky,
        conflicts_with = "hdri")]
    sky: Vec<Sky>,
    /// Images to draw the ground from [default: painted]
    #[arg(long, value_name = "FILE", num_args = 1..)]
    ground: Vec<PathBuf>,
    /// Kinds of painted ground to draw from: wood, stone, concrete, tiles, … [default: all that
    /// tables are made of]
    #[arg(long, value_name = "NAME", value_delimiter = ',', value_parser = pattern,
        conflicts_with = "ground")]
    pattern: Vec<ProceduralTexture>,
    /// Width of such an image on the ground
    #[arg(long, value_name = "M", default_value_t = 0.5)]
    ground_width_m: f64,
    /// Seed of everything that is drawn
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Images of each moment, each under conditions of its own
    #[arg(long, value_name = "N", default_value_t = 1,
        value_parser = clap::value_parser!(u32).range(1..=1000))]
    count: u32,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Quality")]
struct QualityFlags {
    /// Paths for each pixel
    #[arg(long, value_name = "N", default_value_t = 64,
        value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    samples: u32,
    /// Columns and rows
    #[arg(long, value_name = "WxH", default_value = "320x240", value_parser = size)]
    size: [usize; 2],
    /// Most reflections and refractions of a path
    #[arg(long, value_name = "N", default_value_t = 6)]
    bounces: u32,
    /// Largest value one path may add to a pixel; loses light
    #[arg(long, value_name = "RADIANCE")]
    clamp: Option<f32>,
    /// Smooth what few paths leave rough, guided by colour, normal and depth of the surfaces
    #[arg(long)]
    denoise: bool,
    /// Threads; the images do not depend on them [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ViewName {
    /// The D435 between the fingers
    Hand,
    /// From beside the gripper, for people
    Outside,
}

fn sky(text: &str) -> Result<Sky, String> {
    text.parse().map_err(|e: Error| e.to_string())
}

fn pattern(text: &str) -> Result<ProceduralTexture, String> {
    text.parse().map_err(|e: Error| e.to_string())
}

/// A finish of the command line.
pub(super) fn finish(text: &str) -> Result<Finish, String> {
    text.parse().map_err(|e: Error| e.to_string())
}

/// Columns and rows of the command line.
pub(super) fn size(text: &str) -> Result<[usize; 2], String> {
    let sides = text.split_once('x').and_then(|(width, height)| {
        let side = |s: &str| s.parse().ok().filter(|n| (1..=8192).contains(n));
        Some([side(width)?, side(height)?])
    });
    sides.ok_or_else(|| "must be two numbers from 1 to 8192, as 320x240".to_owned())
}

/// An image that was written.
#[derive(Debug, Serialize)]
struct Written {
    file: PathBuf,
    moment: &'static str,
    seed: u64,
    wall_s: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<PathBuf>,
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let plan = args.plan();
    plan.prepare("one --moment and --count 1")?;
    let json = args.json;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.quality.threads.map_or(0, usize::from))
        .build()
        .map_err(|e| Error::internal("cannot start threads").because(e))?;
    let report = interruptible(context, "rendering", move |progress| {
        pool.install(|| Job::new(&args, &plan, progress)?.run())
    })??;
    if json {
        print_json(&report)?;
    } else {
        let line = |w: &Written| format!("{}: {:.1} s", w.file.display(), w.wall_s);
        print(
            &report
                .images
                .iter()
                .map(line)
                .collect::<Vec<_>>()
                .join("\n"),
        )?;
    }
    report.finish()
}

impl Args {
    fn plan(&self) -> OutPlan {
        let is_single = self.trace.len() <= 1 && self.moment.len() == 1 && self.look.count == 1;
        OutPlan {
            out: self.out.clone(),
            is_single,
        }
    }
}

/// What all images fraction.
struct Job<'a> {
    args: &'a Args,
    plan: &'a OutPlan,
    progress: &'a Progress,
    randomisation: VisualRandomisation,
}

impl<'a> Job<'a> {
    fn new(args: &'a Args, plan: &'a OutPlan, progress: &'a Progress) -> Result<Self> {
        let dome = |path: &PathBuf| -> Result<Arc<Image>> {
            let mut dome = load_hdr(path)?;
            normalise_env_map(&mut dome);
            Ok(Arc::new(dome))
        };
        let width = args.look.ground_width_m;
        if !(width.is_finite() && width > 0.0) {
            let what = format!("`--ground-width-m` must be above 0, found {width}");
            return Err(Error::usage(what));
        }
        let ground = |path: &PathBuf| -> Result<(Arc<Bitmap>, f64)> {
            Ok((Arc::new(load_bitmap(path)?), width))
        };
        Ok(Self {
            args,
            plan,
            progress,
            randomisation: VisualRandomisation {
                env_maps: args.look.hdri.iter().map(dome).collect::<Result<_>>()?,
                ground_images: args.look.ground.iter().map(ground).collect::<Result<_>>()?,
                skies: args.look.sky.clone(),
                ground_textures: args.look.pattern.clone(),
                ..VisualRandomisation::default()
            },
        })
    }

    fn run(&self) -> Result<Report<Written>> {
        let traces = &self.args.trace;
        if traces.is_empty() {
            let written = self.without_trace()?;
            return Ok(Report::of(written));
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
            unit: flags.unit,
            scale: flags.scale,
        };
        let mesh = source.load()?;
        let resting = || -> Result<Pose> { Ok(resting_pose(&mesh, None)?.1.t_world_object) };
        let (t_world_object, placed): (Pose, GripperState) = match &flags.pose {
            None => {
                let lying = resting()?;
                (lying, Placement::default().place(&mesh, &lying)?)
            }
            Some(path) => {
                let text = fs::read_to_string(path)
                    .map_err(|e| Error::io("cannot read the pose", e).at(path.display()))?;
                let pose = GraspPose::from_json(&text).map_err(|e| e.at(path.display()))?;
                let lying = pose.t_world_object.map_or_else(resting, Ok)?;
                (lying, pose.place(&mesh, &lying))
            }
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

    /// All images of a moment.
    fn images(
        &self,
        object: &ObjectSource,
        state: &GraspState,
        stem: &str,
        moment: &'static str,
    ) -> Result<Vec<Written>> {
        let look = &self.args.look;
        let mut written = Vec::new();
        for number in 0..look.count {
            let seed = look.seed.wrapping_add(u64::from(number));
            let model = object.model(self.args.object.finish, seed, self.progress)?;
            let out = self.plan.place(&format!("{stem}.{moment}.{number}.png"));
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
            samples_per_pixel: quality.samples,
            max_bounces: quality.bounces,
            clamp: quality.clamp,
            seed,
            ..RenderSettings::default()
        };
        let progress = |done: usize, all: usize| self.progress.at(done as u64, all as u64);
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
            let noise = conditions.sensor_seed;
            let codes = measure_depth(
                &rendering.depth_m,
                &scene.camera,
                &DepthSettings::default(),
                noise,
            )?;
            save(path, &encode_png_grey16(&codes)?)?;
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
        let mut settings = ColourSettings::default();
        if self.args.view == ViewName::Outside {
            // An image for people, not of the sensor.
            settings.full_well_e = 1e9;
            settings.read_noise_e = 0.0;
            settings.blur_px = 0.0;
        }
        develop(light, &settings, conditions.sensor_seed)
    }
}
