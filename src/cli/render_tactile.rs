//! `gripcast render tactile`: tactile images (GelSight Mini).
//!
//! ```text
//! gripcast render tactile --trace grasp.bin --side left --out left.png
//! gripcast render tactile --trace *.bin --side both --moment initial,grasp --out images
//! gripcast render tactile --object part.stl --unit mm --pose press.json --out press.png
//! ```
//!
//! `--out` is a `.png` for one image, else a folder of `TRACE.MOMENT.SIDE.png`. `--depth` writes
//! the contact depth beside each as `….depth.png` (16 bits, µm), `--difference` the signed tactile
//! difference (128: no change). `--markers image,field` writes the positions of the gel markers as
//! `….markers.npy` (rows × columns × 5: rest x, rest y, displacement x, displacement y, px, and
//! confidence; NaN where the image has no gel marker), `--markers field` nothing else.
//!
//! Without a trace an object is pressed `--press-m` deep into one gel. `--pose` is a JSON file
//! with `t_sensor_object`, the object in the sensor frame: x along the columns, y along the rows, z
//! towards the object, origin at the centre of the gel; z is ignored.
//!
//! Exit codes: 0 rendered · 1 nothing rendered · 2 usage · 3 some of several traces failed ·
//! 130 interrupted.

use std::path::{Path, PathBuf};

use clap::builder::TypedValueParser;
use image::Luma;
use serde::{Deserialize, Serialize};

use super::Context;
use super::flags::{BallFlags, moment, named, number, read_text};
use super::mesh_repair::RepairFlags;
use super::render_out::{OutPlan, Report};
use super::render_source::{ObjectSource, SimulatedGrasp};
use super::working::{Progress, interruptible};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::npy::Array;
use gripcast_base::files::save;
use gripcast_base::number::NumberRange;
use gripcast_geometry::{LengthUnit, MeshOptions, Pose};
use gripcast_imaging::{DepthImage, TactileDifference, encode_png_grey16, encode_png_rgb};
use gripcast_sim::grasp::Finger;
use gripcast_tactile::calibrate::PressSet;
use gripcast_tactile::lookup::{LookupRenderer, fit_to_presses};
use gripcast_tactile::{
    GelSurfaceRenderer, Moment, MountingAngle, ObjectDepthRenderer, PressDepth, Rasteriser,
    SceneRenderer, SensorMount, SensorProfile, TactileScene, object_depth,
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
    /// Sensor
    #[arg(long, value_name = "SIDE", default_value = "both", value_parser = side())]
    side: &'static [Finger],
    /// Moments of the grasp, comma-separated
    #[arg(long, value_parser = moment(), value_delimiter = ',', default_value = "grasp")]
    moment: Vec<Moment>,
    /// Also write the contact depth
    #[arg(long)]
    depth: bool,
    /// Also write the tactile difference
    #[arg(long)]
    difference: bool,
    /// What shows the gel markers, comma-separated [default: image, for a profile with gel markers]
    #[arg(long, value_enum, value_delimiter = ',')]
    markers: Vec<MarkerOutput>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    object: ObjectFlags,
    #[command(flatten)]
    sensor: SensorFlags,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Object")]
struct ObjectFlags {
    /// Mesh that replaces the one named by the trace, or is pressed into a gel without a trace
    #[arg(long, value_name = "MESH|builtin:NAME")]
    object: Option<String>,
    /// Unit of the mesh coordinates of --object without a trace: mm, cm, m, in
    #[arg(long, default_value_t = LengthUnit::Metre)]
    unit: LengthUnit,
    #[command(flatten)]
    repair: RepairFlags,
    /// JSON file with t_sensor_object, for --object without a trace [default: identity]
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with = "trace",
        requires = "object"
    )]
    pose: Option<PathBuf>,
    /// Indentation depth of --object without a trace
    #[arg(long, value_name = "M", default_value_t = 5e-4,
        value_parser = number(NumberRange::NOT_NEGATIVE))]
    press_m: f64,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Sensor")]
struct SensorFlags {
    /// Sensor profile of the left or only sensor: gelsight-mini, gelsight-mini-markers, … or a file
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "gelsight-mini")]
    profile: String,
    /// Sensor profile of the right sensor [default: as the left]
    #[arg(long, value_name = "NAME|FILE.toml")]
    right_profile: Option<String>,
    /// Rotation of the left sensor on its finger: 0, 90, 180, 270
    #[arg(long, value_name = "DEG", default_value = "0", value_parser = mounting)]
    mounting: MountingAngle,
    /// Rotation of the right sensor on its finger: 0, 90, 180, 270
    #[arg(long, value_name = "DEG", default_value = "0", value_parser = mounting)]
    right_mounting: MountingAngle,
    /// Rendering method
    #[arg(long, value_enum, default_value_t = Method::Object)]
    method: Method,
    /// Ball presses that --method lookup is fitted to, as for `render calibrate`
    #[arg(long, value_name = "DIR")]
    presses: Option<PathBuf>,
    #[command(flatten)]
    ball: BallFlags,
    /// Random seed of the noise
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Disable sensor noise
    #[arg(long)]
    no_noise: bool,
}

fn side() -> impl TypedValueParser<Value = &'static [Finger]> {
    named([
        ("left", "Left finger", &[Finger::Left][..]),
        ("right", "Right finger", &[Finger::Right]),
        ("both", "Both fingers", &Finger::BOTH),
    ])
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum MarkerOutput {
    /// Drawn into the image
    Image,
    /// Their positions as an array (.npy)
    Field,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    /// Shading of the smoothed indentation of the object
    Object,
    /// Shading of the deformed gel mesh, as in Taccel's built-in renderer
    GelSurface,
    /// Taxim's lookup table with shadows
    Lookup,
}

fn mounting(text: &str) -> Result<MountingAngle, String> {
    let degrees: u16 = text.parse().map_err(|_| "not a number".to_owned())?;
    MountingAngle::from_degrees(degrees).map_err(|e| e.what().to_owned())
}

/// A written image, or what was written instead of it.
#[derive(Debug, Serialize)]
struct Written {
    file: PathBuf,
    side: &'static str,
    moment: &'static str,
    deepest_m: f64,
    /// Fraction of the pixels in contact.
    contact: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    difference: Option<PathBuf>,
    /// Positions of the gel markers.
    #[serde(skip_serializing_if = "Option::is_none")]
    markers: Option<PathBuf>,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let plan = args.plan();
    if args.markers == [MarkerOutput::Field] && args.difference {
        return Err(
            Error::usage("`--difference` needs the image, `--markers field` draws none")
                .remedy("use --markers image,field"),
        );
    }
    plan.prepare("one --side and one --moment")?;
    let json = args.json;
    let report = interruptible(context, "rendering", move |progress| {
        if args.trace.is_empty() {
            Ok(Report::new(vec![one_press(&args)?]))
        } else {
            all_traces(&args, &plan, progress)
        }
    })??;
    report.conclude(json, |w: &Written| {
        let (file, mm, percent) = (w.file.display(), 1e3 * w.deepest_m, 100.0 * w.contact);
        format!("{file}: {mm:.2} mm deep, {percent:.0} % in contact")
    })
}

impl Args {
    fn plan(&self) -> OutPlan {
        let one_press = self.trace.is_empty();
        let one_image = self.trace.len() == 1 && self.side.len() == 1 && self.moment.len() == 1;
        OutPlan {
            out: self.out.clone(),
            is_single: one_press || one_image,
        }
    }

    fn noise(&self) -> Option<u64> {
        (!self.sensor.no_noise).then_some(self.sensor.seed)
    }
}

impl SensorFlags {
    fn profile(&self, finger: Finger) -> Result<SensorProfile> {
        let own = match finger {
            Finger::Left => None,
            Finger::Right => self.right_profile.as_ref(),
        };
        let profile = SensorProfile::named_or_load(own.unwrap_or(&self.profile))?;
        Ok(profile.on_finger(finger))
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

    fn sensor(&self, finger: Finger) -> Result<Sensor> {
        let profile = self.profile(finger)?;
        let renderer: Box<dyn SceneRenderer> = match self.method {
            Method::Object => Box::new(ObjectDepthRenderer::new(&profile)?),
            Method::GelSurface => Box::new(GelSurfaceRenderer::new(&profile)?),
            Method::Lookup => Box::new(self.lookup()?),
        };
        Ok(Sensor {
            finger,
            profile,
            renderer,
        })
    }

    /// Fits Taxim's lookup table to all presses of `--presses`.
    fn lookup(&self) -> Result<LookupRenderer> {
        let Some(folder) = &self.presses else {
            let what = "`--method lookup` needs `--presses`, the presses to fit its table to";
            return Err(Error::usage(what));
        };
        let set = PressSet::read(&self.ball.read_options(folder))?;
        let all: Vec<usize> = (0..set.presses.len()).collect();
        let renderer = fit_to_presses(&set, &all)?;
        Ok(renderer.with_shadows())
    }
}

/// One sensor of the gripper.
struct Sensor {
    finger: Finger,
    profile: SensorProfile,
    renderer: Box<dyn SceneRenderer>,
}

fn one_press(args: &Args) -> Result<Written> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct PressFile {
        t_sensor_object: Pose,
    }
    let flags = &args.object;
    let Some(name) = &flags.object else {
        return Err(Error::usage("`--trace` or `--object` is needed"));
    };
    let t_sensor_object = match &flags.pose {
        None => Pose::IDENTITY,
        Some(path) => {
            let text = read_text(path, "pose")?;
            let pose: PressFile = serde_json::from_str(&text).map_err(|e| {
                Error::input("invalid pose file")
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
        options: MeshOptions {
            prepare: flags.repair.surface_options(),
            ..MeshOptions::new(flags.unit, 1.0)
        },
    };
    let mesh = source.load()?;
    let finger = args.side[0];
    let mut sensor = args.sensor.sensor(finger)?;
    let grid = sensor.renderer.grid();
    let scene = TactileScene::pressed(&mesh, &t_sensor_object, flags.press_m, &grid)?;
    write(args, &mut sensor, &scene, args.out.clone(), "press")
}

fn all_traces(args: &Args, plan: &OutPlan, progress: &Progress) -> Result<Report<Written>> {
    let sensors: Result<Vec<_>> = args.side.iter().map(|f| args.sensor.sensor(*f)).collect();
    let mut sensors = sensors?;
    Report::of_traces(&args.trace, progress, |trace| {
        one_trace(args, plan, trace, &mut sensors)
    })
}

fn one_trace(
    args: &Args,
    plan: &OutPlan,
    trace: &Path,
    sensors: &mut [Sensor],
) -> Result<Vec<Written>> {
    let grasp = SimulatedGrasp::read(trace, args.object.object.as_deref())?;
    for sensor in &*sensors {
        sensor
            .profile
            .check_pad(&grasp.gel.grid)
            .map_err(|e| e.at(trace.display()))?;
    }
    let stem = trace.file_stem().unwrap_or_default().to_string_lossy();
    let mut written = Vec::new();
    for &moment in &args.moment {
        for sensor in &mut *sensors {
            let scene = grasp.scene(moment, args.sensor.place(sensor.finger))?;
            let moment = moment.name();
            let out = plan.file(&format!("{stem}.{moment}.{}.png", sensor.finger.name()));
            written.push(write(args, sensor, &scene, out, moment)?);
        }
    }
    Ok(written)
}

fn write(
    args: &Args,
    sensor: &mut Sensor,
    scene: &TactileScene<'_>,
    out: PathBuf,
    moment: &'static str,
) -> Result<Written> {
    let markers = match args.markers.is_empty() {
        true => None,
        false => Some(marker_array(sensor, scene)?),
    };
    let field = args.markers.contains(&MarkerOutput::Field);
    let markers = markers
        .filter(|_| field)
        .map(|array| (out.with_extension("markers.npy"), array));
    if let Some((path, array)) = &markers {
        save(path, &array.to_npy())?;
    }
    let renderer = sensor.renderer.as_mut();
    let drawn = args.markers.is_empty() || args.markers.contains(&MarkerOutput::Image);
    let image = match drawn {
        true => Some(renderer.render(scene, args.noise())?),
        false => None,
    };
    if let Some(image) = &image {
        save(&out, &encode_png_rgb(image)?)?;
    }
    let press = object_depth(scene, &renderer.grid(), &mut Rasteriser::new());
    let touched = press.depth_m.iter().filter(|&&d| d > 0.0).count();
    let depth = args.depth.then(|| out.with_extension("depth.png"));
    if let Some(path) = &depth {
        save(path, &encode_png_grey16(&micrometres(&press))?)?;
    }
    let difference = image.as_ref().filter(|_| args.difference);
    let difference = difference.map(|image| (out.with_extension("difference.png"), image));
    if let Some((path, image)) = &difference {
        let untouched = renderer.render(&scene.untouched(), args.noise())?;
        let change = TactileDifference::between(&untouched, image)?;
        save(path, &encode_png_rgb(&change.to_image(1.0))?)?;
    }
    let difference = difference.map(|(path, _)| path);
    let markers = markers.map(|(path, _)| path);
    Ok(Written {
        file: markers.clone().filter(|_| !drawn).unwrap_or(out),
        side: sensor.finger.name(),
        moment,
        deepest_m: press.deepest_m(),
        contact: touched as f64 / press.depth_m.len().max(1) as f64,
        depth,
        difference,
        markers,
    })
}

/// Returns the positions of the gel markers of a scene.
fn marker_array(sensor: &mut Sensor, scene: &TactileScene<'_>) -> Result<Array> {
    let Some(field) = sensor.renderer.marker_field(scene)? else {
        sensor.profile.marker_pattern()?;
        return Err(
            Error::usage("`--method lookup` draws no gel markers").remedy("use another method")
        );
    };
    let (values, shape) = field.to_array();
    Array::new(shape, values)
}

/// Converts depths to whole micrometres.
fn micrometres(press: &PressDepth) -> DepthImage {
    let (width, height) = (press.geometry.width as u32, press.geometry.height as u32);
    DepthImage::from_fn(width, height, |x, y| {
        let depth_m = press.depth_m[(y * width + x) as usize];
        Luma([(1e6 * depth_m).round() as u16])
    })
}
