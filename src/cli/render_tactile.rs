//! `gripcast render tactile`: images of the GelSight Minis.
//!
//! ```text
//! gripcast render tactile --trace grasp.bin --side left --out left.png
//! gripcast render tactile --trace *.bin --side both --moment initial,grasp --out images
//! gripcast render tactile --object part.stl --unit mm --pose press.json --out press.png
//! ```
//!
//! `--out` is a `.png` for one image, else a folder, which then holds
//! `TRACE.MOMENT.SIDE.png`. `--depth` writes the depths of the press beside each as
//! `….depth.png`, 16 bits, one unit a micrometre; `--difference` writes the signed difference to
//! the untouched image, grey 128 being none.
//!
//! Without a trace an object is pressed `--press-m` deep into one gel. `--pose` is a JSON file
//! with `t_sensor_object`, the object in the frame of the sensor: x along the columns, y along the
//! rows, z towards the object; the middle of the gel is x = y = 0, and z plays no part.
//!
//! Exit codes: 0 rendered · 1 nothing could be rendered · 2 usage · 3 some of several traces
//! could not be rendered · 130 interrupted.

use std::fs;
use std::path::{Path, PathBuf};

use image::Luma;
use serde::{Deserialize, Serialize};

use super::render_out::{OutPlan, Report};
use super::render_source::{Moment, ObjectSource, SimulatedGrasp};
use super::sim_object::unit;
use super::working::{Progress, interruptible};
use super::{Context, print, print_json};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::save;
use gripcast_geometry::{LengthUnit, Pose};
use gripcast_imaging::{DepthImage, TactileDifference, encode_png_grey16, encode_png_rgb};
use gripcast_sim::grasp::Finger;
use gripcast_tactile::calibrate::{PressSet, ReadOptions};
use gripcast_tactile::lookup::{LookupRenderer, fit_to_presses};
use gripcast_tactile::{
    GelSurfaceRenderer, MountingAngle, ObjectDepthRenderer, PressDepth, Rasteriser, SceneRenderer,
    SensorMount, SensorProfile, TactileScene, object_depth,
};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Traces of simulated grasps
    #[arg(long, value_name = "FILE", num_args = 1.., required_unless_present = "object")]
    trace: Vec<PathBuf>,
    /// Mesh that replaces the one named by the trace, or that is pressed into a gel
    #[arg(long, value_name = "MESH|builtin:NAME")]
    object: Option<String>,
    /// Unit of the coordinates in --object without a trace: mm, cm, m, in
    #[arg(long, default_value_t = LengthUnit::Metre, value_parser = unit)]
    unit: LengthUnit,
    /// JSON with t_sensor_object, for an object without a trace [default: its own frame]
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with = "trace",
        requires = "object"
    )]
    pose: Option<PathBuf>,
    /// How deep an object without a trace is pressed in
    #[arg(long, value_name = "M", default_value_t = 5e-4)]
    press_m: f64,
    /// Which sensor
    #[arg(long, value_enum, default_value_t = Side::Both)]
    side: Side,
    /// When
    #[arg(long, value_enum, value_delimiter = ',', default_value = "grasp")]
    moment: Vec<Moment>,
    /// How the image is made
    #[arg(long, value_enum, default_value_t = Method::Object)]
    method: Method,
    /// Presses of a ball to fit the table of --method lookup to, as `render calibrate` reads them
    #[arg(long, value_name = "DIR")]
    presses: Option<PathBuf>,
    /// Diameter of that ball [default: that of presses.json]
    #[arg(long, value_name = "MM")]
    ball_mm: Option<f64>,
    /// Find contacts in those images although presses.json has them
    #[arg(long)]
    find_contacts: bool,
    /// Profile of the left or only sensor [default: a generic GelSight Mini]
    #[arg(long, value_name = "FILE.toml")]
    profile: Option<PathBuf>,
    /// Profile of the right sensor [default: that of the left]
    #[arg(long, value_name = "FILE.toml")]
    right_profile: Option<PathBuf>,
    /// Turn of the left sensor on its finger: 0, 90, 180, 270
    #[arg(long, value_name = "DEG", default_value = "0", value_parser = mounting)]
    mounting: MountingAngle,
    /// Turn of the right sensor on its finger
    #[arg(long, value_name = "DEG", default_value = "0", value_parser = mounting)]
    right_mounting: MountingAngle,
    /// Seed of the noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Leave the noise out
    #[arg(long)]
    no_noise: bool,
    /// Image, or folder for several
    #[arg(long, value_name = "FILE.png|DIR")]
    out: PathBuf,
    /// Write the depths of the press as well
    #[arg(long)]
    depth: bool,
    /// Write the difference to the untouched image as well
    #[arg(long)]
    difference: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Side {
    Left,
    Right,
    Both,
}

impl Side {
    fn fingers(self) -> &'static [Finger] {
        match self {
            Self::Left => &[Finger::Left],
            Self::Right => &[Finger::Right],
            Self::Both => &Finger::BOTH,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    /// Depth of the object in the gel, smoothed, shaded
    Object,
    /// Depth of the deformed gel's own mesh, as Taccel's built-in renderer takes it
    GelSurface,
    /// Taxim's table of colours with shadows
    Lookup,
}

fn mounting(text: &str) -> Result<MountingAngle, String> {
    let degrees: u16 = text.parse().map_err(|_| "not a number".to_owned())?;
    MountingAngle::from_degrees(degrees).map_err(|e| e.what().to_owned())
}

fn side_name(finger: Finger) -> &'static str {
    match finger {
        Finger::Left => "left",
        Finger::Right => "right",
    }
}

/// An image that was written.
#[derive(Debug, Serialize)]
struct Written {
    file: PathBuf,
    side: &'static str,
    moment: &'static str,
    deepest_m: f64,
    /// Fraction of the pixels under which the object touches.
    contact: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    difference: Option<PathBuf>,
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let plan = args.plan();
    plan.prepare("one --side and one --moment")?;
    let json = args.json;
    let report = interruptible(context, "rendering", move |progress| {
        if args.trace.is_empty() {
            one_press(&args).map(|written| Report::of(vec![written]))
        } else {
            all_traces(&args, &plan, progress)
        }
    })??;
    if json {
        print_json(&report)?;
    } else {
        let line = |w: &Written| {
            let (mm, percent) = (1e3 * w.deepest_m, 100.0 * w.contact);
            format!(
                "{}: {mm:.2} mm deep, {percent:.0} % touched",
                w.file.display()
            )
        };
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
        let one_press = self.trace.is_empty();
        let one_image = self.trace.len() == 1 && self.side != Side::Both && self.moment.len() == 1;
        OutPlan {
            out: self.out.clone(),
            is_single: one_press || one_image,
        }
    }

    fn profile(&self, finger: Finger) -> Result<SensorProfile> {
        let own = match finger {
            Finger::Left => None,
            Finger::Right => self.right_profile.as_ref(),
        };
        match own.or(self.profile.as_ref()) {
            Some(path) => SensorProfile::load(path),
            None => SensorProfile::gelsight_mini(),
        }
    }

    fn place(&self, finger: Finger) -> SensorMount {
        SensorMount {
            finger,
            mounting: match finger {
                Finger::Left => self.mounting,
                Finger::Right => self.right_mounting,
            },
        }
    }

    fn eye(&self, finger: Finger) -> Result<Eye> {
        let profile = self.profile(finger)?;
        let renderer: Box<dyn SceneRenderer> = match self.method {
            Method::Object => Box::new(ObjectDepthRenderer::new(&profile)?),
            Method::GelSurface => Box::new(GelSurfaceRenderer::new(&profile)?),
            Method::Lookup => Box::new(self.lookup()?),
        };
        Ok(Eye {
            renderer,
            rasteriser: Rasteriser::new(),
        })
    }

    /// Taxim's renderer with a table fitted to all presses of `--presses`.
    fn lookup(&self) -> Result<LookupRenderer> {
        let Some(folder) = &self.presses else {
            let what = "`--method lookup` needs `--presses`, the presses to fit its table to";
            return Err(Error::usage(what));
        };
        let set = PressSet::read(&ReadOptions {
            ball_diameter_m: self.ball_mm.map(|mm| 1e-3 * mm),
            find_contacts: self.find_contacts,
            ..ReadOptions::from_folder(folder)
        })?;
        let all: Vec<usize> = (0..set.presses.len()).collect();
        let renderer = fit_to_presses(&set, &all)?;
        Ok(renderer.with_shadows())
    }

    fn noise(&self) -> Option<u64> {
        (!self.no_noise).then_some(self.seed)
    }
}

/// A renderer with what the depth beside its images needs.
struct Eye {
    renderer: Box<dyn SceneRenderer>,
    rasteriser: Rasteriser,
}

fn one_press(args: &Args) -> Result<Written> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct PressFile {
        t_sensor_object: Pose,
    }
    let Some(name) = &args.object else {
        return Err(Error::usage("`--trace` or `--object` is needed"));
    };
    let t_sensor_object = match &args.pose {
        None => Pose::IDENTITY,
        Some(path) => {
            let text = fs::read_to_string(path)
                .map_err(|e| Error::io("cannot read the pose", e).at(path.display()))?;
            let pose: PressFile = serde_json::from_str(&text).map_err(|e| {
                Error::input("the pose file cannot be read")
                    .at(path.display())
                    .because(e)
                    .remedy(
                        r#"expected {"t_sensor_object": {"t_m": [x,y,z], "q_wxyz": [w,x,y,z]}}"#,
                    )
            })?;
            pose.t_sensor_object
        }
    };
    let source = ObjectSource {
        name: name.clone(),
        unit: args.unit,
        scale: 1.0,
    };
    let mesh = source.load()?;
    let finger = args.side.fingers()[0];
    let mut eye = args.eye(finger)?;
    let grid = eye.renderer.grid();
    let scene = TactileScene::pressed(&mesh, &t_sensor_object, args.press_m, &grid)?;
    write(args, &mut eye, &scene, &args.out, finger, "press")
}

fn all_traces(args: &Args, plan: &OutPlan, progress: &Progress) -> Result<Report<Written>> {
    let mut eyes = Vec::new();
    for &finger in args.side.fingers() {
        eyes.push((finger, args.eye(finger)?));
    }
    Report::of_traces(&args.trace, progress, |trace| {
        one_trace(args, plan, trace, &mut eyes)
    })
}

fn one_trace(
    args: &Args,
    plan: &OutPlan,
    trace: &Path,
    eyes: &mut [(Finger, Eye)],
) -> Result<Vec<Written>> {
    let grasp = SimulatedGrasp::read(trace, args.object.as_deref())?;
    let stem = trace.file_stem().unwrap_or_default().to_string_lossy();
    let mut written = Vec::new();
    for &moment in &args.moment {
        for (finger, eye) in &mut *eyes {
            let scene = scene(&grasp, moment, args.place(*finger))?;
            let name = format!("{stem}.{}.{}.png", moment.name(), side_name(*finger));
            let out = plan.place(&name);
            written.push(write(args, eye, &scene, &out, *finger, moment.name())?);
        }
    }
    Ok(written)
}

/// What a sensor meets at a moment.
pub(super) fn scene(
    grasp: &SimulatedGrasp,
    moment: Moment,
    place: SensorMount,
) -> Result<TactileScene<'_>> {
    match grasp.snapshot(moment)? {
        Some(snapshot) => TactileScene::from_snapshot(&grasp.mesh, &grasp.gel, snapshot, place),
        None => {
            let start = &grasp.start;
            let poses = [&start.t_world_object, &start.t_world_gripper()];
            TactileScene::before_closing(&grasp.mesh, &grasp.gel, poses, start.opening_m, place)
        }
    }
}

fn write(
    args: &Args,
    eye: &mut Eye,
    scene: &TactileScene<'_>,
    out: &Path,
    finger: Finger,
    moment: &'static str,
) -> Result<Written> {
    let image = eye.renderer.render(scene, args.noise())?;
    save(out, &encode_png_rgb(&image)?)?;
    let grid = eye.renderer.grid();
    let press = object_depth(scene, &grid, &mut eye.rasteriser);
    let touched = press.depth_m.iter().filter(|&&d| d > 0.0).count();
    let depth = args.depth.then(|| out.with_extension("depth.png"));
    if let Some(path) = &depth {
        save(path, &encode_png_grey16(&micrometres(&press))?)?;
    }
    let difference = args
        .difference
        .then(|| out.with_extension("difference.png"));
    if let Some(path) = &difference {
        let untouched = eye.renderer.render(&scene.untouched(), args.noise())?;
        let change = TactileDifference::between(&untouched, &image)?;
        save(path, &encode_png_rgb(&change.to_image(1.0))?)?;
    }
    Ok(Written {
        file: out.to_owned(),
        side: side_name(finger),
        moment,
        deepest_m: press.deepest_m(),
        contact: touched as f64 / press.depth_m.len().max(1) as f64,
        depth,
        difference,
    })
}

/// Depths in whole micrometres.
fn micrometres(press: &PressDepth) -> DepthImage {
    let (width, height) = (press.geometry.width as u32, press.geometry.height as u32);
    DepthImage::from_fn(width, height, |x, y| {
        let depth_m = press.depth_m[(y * width + x) as usize];
        Luma([(1e6 * depth_m).round() as u16])
    })
}
