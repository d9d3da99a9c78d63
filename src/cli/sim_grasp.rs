//! `gripcast sim grasp`: simulate one grasp.
//!
//! ```text
//! gripcast sim grasp --object builtin:mug --stop-force-n 40 --plot mug.svg
//! gripcast sim grasp --object part.stl --unit mm --mass-kg 0.05 --friction 0.5 --yaw-deg 30 --json
//! gripcast sim grasp --object part.stl --unit mm --pose grasp.json --trace grasp.bin
//! ```
//!
//! The gripper closes, adjusts its force and lifts. Without `--pose` it comes from above, centred
//! on the object. stdout has the result, with `--json` as one object; `--trace` writes every step
//! (`.json`, or `.bin` for programs), `--plot` the forces and heights (`.svg`).
//!
//! Exit codes: 0 simulated, whatever the outcome · 1 the object, the pose or a file is refused ·
//! 2 usage · 4 steps did not converge, so there is no outcome · 130 interrupted.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;
use serde_json::{Value, json};

use super::sim_object::{ObjectFlags, ObjectRecord, SimObject};
use super::working::interruptible;
use super::{Context, print_report};
use crate::note;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::save;
use gripcast_geometry::Pose;
use gripcast_replay::plot;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::{
    ForceRule, GraspOutcome, GraspPose, GraspResult, GraspSettings, GraspSummary, GripperState,
    Placement, Preset, STEADY_STEPS, Scene, TACCEL_DRIVE_WEIGHT, TraceFile, resting_pose, simulate,
};
use gripcast_sim::solver::{Drive, PhaseTimes};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub(crate) struct Args {
    #[command(flatten)]
    object: ObjectFlags,
    #[command(flatten)]
    place: PlaceFlags,
    #[command(flatten)]
    settings: SettingsFlags,
    #[command(flatten)]
    out: OutFlags,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Where the gripper stands")]
struct PlaceFlags {
    /// JSON with t_object_gripper, and optionally t_world_object and opening_m
    #[arg(long, value_name = "FILE", conflicts_with_all = [
        "height", "offset_x", "offset_y", "tilt_deg", "yaw_deg", "lean_deg",
    ])]
    pose: Option<PathBuf>,
    /// Which stable pose the object lies in, the most probable being 0
    #[arg(long, value_name = "N")]
    stable_pose: Option<usize>,
    /// Distance between the gels at the start [default: the object's width and 2 mm]
    #[arg(long, value_name = "M")]
    width: Option<f64>,
    /// Height of the gel centres above the ground [default: the object's middle]
    #[arg(long, value_name = "M")]
    height: Option<f64>,
    /// Shift along the closing direction
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    offset_x: f64,
    /// Shift across the closing direction
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    offset_y: f64,
    /// Turn about the vertical
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    yaw_deg: f64,
    /// One finger higher than the other
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    tilt_deg: f64,
    /// Approach out of the vertical, about the closing direction
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    lean_deg: f64,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "How it grasps")]
struct SettingsFlags {
    /// Set of parameters to start from
    #[arg(long, value_enum, default_value_t = PresetName::Paper)]
    preset: PresetName,
    /// Force of each gel at which closing ends
    #[arg(long, value_name = "N", default_value_t = 40.0, value_parser = above_zero)]
    stop_force_n: f64,
    /// Mesh of the gels
    #[arg(long, value_enum, default_value_t = GelName::Default)]
    gel: GelName,
    /// What moves the back of the gels: springs by area, or by nodal mass as in Taccel
    #[arg(long, value_enum, default_value_t = DriveName::Area)]
    drive: DriveName,
    /// How the fingers follow the force
    #[arg(long, value_enum, default_value_t = RuleName::BangBang)]
    rule: RuleName,
    /// Finger motion for each missing newton, with --rule proportional
    #[arg(long, value_name = "M_N", default_value_t = 5e-6, value_parser = above_zero)]
    gain: f64,
    /// Time step
    #[arg(long, value_name = "S", default_value_t = 0.01, value_parser = above_zero)]
    dt: f64,
    /// Speed at which Newton's iteration ends
    #[arg(long, value_name = "M_S", default_value_t = 1e-4, value_parser = above_zero)]
    tolerance: f64,
    /// Iterations after which a step counts as not converged
    #[arg(long, value_name = "N", default_value_t = 200,
        value_parser = clap::value_parser!(u32).range(1..))]
    max_iterations: u32,
    /// Duration of the adjustment
    #[arg(long, value_name = "S", default_value_t = 1.5, value_parser = above_zero)]
    adjust_s: f64,
    /// Height of the lift
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = above_zero)]
    lift: f64,
    /// Threads; the result does not depend on them [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "What is written")]
struct OutFlags {
    /// Write every step and the states at stage ends
    #[arg(long, value_name = "FILE.json|.bin")]
    trace: Option<PathBuf>,
    /// Draw forces and heights
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// A set of parameters.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(super) enum PresetName {
    /// E = 1 MPa, ν = 0.3
    Paper,
    /// E = 0.435 MPa, ν = 0.45
    Feats,
}

impl From<PresetName> for Preset {
    fn from(name: PresetName) -> Self {
        match name {
            PresetName::Paper => Self::Paper,
            PresetName::Feats => Self::Feats,
        }
    }
}

/// A gel mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum GelName {
    /// 13 × 11 × 3 nodes
    Coarse,
    /// 19 × 16 × 4 nodes
    Default,
    /// 26 × 21 × 5 nodes
    Fine,
}

impl From<GelName> for GelResolution {
    fn from(name: GelName) -> Self {
        match name {
            GelName::Coarse => Self::Coarse,
            GelName::Default => Self::Default,
            GelName::Fine => Self::Fine,
        }
    }
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum DriveName {
    /// 5e9 N/m³ for every mesh
    Area,
    /// 5e4 times mass / dt², softer on finer meshes
    Taccel,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum RuleName {
    /// Open above the threshold, else close, at 2 mm/s
    BangBang,
    /// In proportion to what is missing, at most 2 mm/s
    Proportional,
}

pub(super) fn above_zero(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err("must be above 0".to_owned())
    }
}

impl SettingsFlags {
    fn settings(&self) -> GraspSettings {
        let mut settings = GraspSettings::new(self.preset.into());
        settings.resolution = self.gel.into();
        if let DriveName::Taccel = self.drive {
            settings.drive = Drive::PerMass(TACCEL_DRIVE_WEIGHT);
        }
        settings.protocol.stop_force_n = self.stop_force_n;
        settings.protocol.adjust_s = self.adjust_s;
        settings.protocol.lift_m = self.lift;
        settings.protocol.rule = match self.rule {
            RuleName::BangBang => ForceRule::BangBang,
            RuleName::Proportional => ForceRule::Proportional {
                gain_m_per_n: self.gain,
            },
        };
        settings.solver.dt_s = self.dt;
        settings.solver.newton_tolerance_m_s = self.tolerance;
        settings.solver.max_iterations = self.max_iterations;
        settings
    }
}

/// The result as JSON.
#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    summary: GraspSummary,
    wall_s: f64,
    times: PhaseTimes,
    object: ObjectRecord,
    pose: PoseRecord,
    parameters: GraspSettings,
}

#[derive(Serialize)]
struct PoseRecord {
    t_world_object: Pose,
    t_object_gripper: Pose,
    opening_m: f64,
    /// How the object lies, where that was not given.
    stable_pose: Option<StablePoseRecord>,
}

#[derive(Clone, Copy, Serialize)]
struct StablePoseRecord {
    index: usize,
    probability: f64,
    tip_angle_deg: f64,
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    args.out.check()?;
    let object = SimObject::load(&args.object)?;
    let Place {
        t_world_object,
        stable_pose,
        placed,
    } = place(&object, &args.place)?;
    let settings = args.settings.settings();
    let scene = Scene {
        mesh: object.mesh.clone(),
        mass_kg: args.object.mass_kg,
        friction: args.object.friction,
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
        gel: settings.gel()?,
    };
    if !context.quiet {
        for warning in &object.warnings {
            note!("gripcast: {}: {warning}", args.object.object);
        }
    }
    let gel_axes_m = scene.gel.grid.axes().clone();
    let (result, wall_s) = timed(context, scene, settings, args.settings.threads)?;
    let mut summary = GraspSummary::new(&result, &settings.protocol, settings.solver.dt_s);
    summary
        .warnings
        .splice(0..0, object.warnings.iter().cloned());
    let report = Report {
        wall_s,
        times: result.times,
        object: object.record(&args.object),
        pose: PoseRecord {
            t_world_object,
            t_object_gripper: t_world_object.inverse() * placed.t_world_gripper,
            opening_m: placed.opening_m,
            stable_pose,
        },
        parameters: settings,
        summary,
    };
    write_files(&args, &report, result, json!(gel_axes_m))?;
    print_report(args.out.json, &report, text)?;
    finish(context, &report)
}

/// Where the object lies and the gripper stands.
struct Place {
    t_world_object: Pose,
    stable_pose: Option<StablePoseRecord>,
    placed: GripperState,
}

fn place(object: &SimObject, flags: &PlaceFlags) -> Result<Place> {
    let resting = || -> Result<(Pose, Option<StablePoseRecord>)> {
        let (index, pose) = resting_pose(&object.mesh, flags.stable_pose)?;
        let record = StablePoseRecord {
            index,
            probability: pose.probability,
            tip_angle_deg: pose.tip_angle_rad.to_degrees(),
        };
        Ok((pose.t_world_object, Some(record)))
    };
    if let Some(path) = &flags.pose {
        let pose = read_pose(path, flags)?;
        let (t_world_object, stable_pose) = match pose.t_world_object {
            Some(given) => (given, None),
            None => resting()?,
        };
        return Ok(Place {
            t_world_object,
            stable_pose,
            placed: pose.place(&object.mesh, &t_world_object),
        });
    }
    let (t_world_object, stable_pose) = resting()?;
    let placement = Placement {
        yaw_rad: flags.yaw_deg.to_radians(),
        roll_rad: flags.tilt_deg.to_radians(),
        pitch_rad: flags.lean_deg.to_radians(),
        offset_m: [flags.offset_x, flags.offset_y],
        height_m: flags.height,
        opening_m: flags.width,
    };
    Ok(Place {
        t_world_object,
        stable_pose,
        placed: placement.place(&object.mesh, &t_world_object)?,
    })
}

fn read_pose(path: &Path, flags: &PlaceFlags) -> Result<GraspPose> {
    let text = fs::read_to_string(path)
        .map_err(|e| Error::io("cannot read the pose", e).at(path.display()))?;
    let mut pose = GraspPose::from_json(&text).map_err(|e| e.at(path.display()))?;
    if pose.t_world_object.is_some() && flags.stable_pose.is_some() {
        return Err(Error::usage(
            "`--stable-pose` contradicts the `t_world_object` of the pose file",
        )
        .at(path.display())
        .remedy("leave one of them out"));
    }
    pose.opening_m = flags.width.or(pose.opening_m);
    Ok(pose)
}

/// Simulates, and says how long it took.
fn timed(
    context: &Context,
    scene: Scene,
    settings: GraspSettings,
    threads: Option<u16>,
) -> Result<(GraspResult, f64)> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads.map_or(0, usize::from))
        .build()
        .map_err(|e| Error::internal("cannot start threads").because(e))?;
    interruptible(context, "simulating the grasp", move |_| {
        let started = Instant::now();
        let result = pool.install(|| simulate(&scene, &settings.protocol, &settings.solver))?;
        Ok((result, started.elapsed().as_secs_f64()))
    })?
}

impl OutFlags {
    /// Refuses what could not be written, before anything is simulated.
    fn check(&self) -> Result<()> {
        let wanted = [
            ("--trace", &self.trace, &["json", "bin"][..]),
            ("--plot", &self.plot, &["svg"][..]),
        ];
        for (flag, path, suffixes) in wanted {
            let Some(path) = path else { continue };
            if !suffixes.contains(&suffix(path).as_str()) {
                return Err(Error::usage(format!(
                    "`{flag}` must name a file that ends in .{}",
                    suffixes.join(" or .")
                ))
                .at(path.display()));
            }
            let folder = path
                .parent()
                .filter(|folder| !folder.as_os_str().is_empty());
            if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
                return Err(
                    Error::not_found(format!("the folder for `{flag}` does not exist"))
                        .at(folder.display())
                        .remedy("create it first"),
                );
            }
        }
        Ok(())
    }
}

fn suffix(path: &Path) -> String {
    let suffix = path.extension().unwrap_or_default();
    suffix.to_string_lossy().to_ascii_lowercase()
}

fn write_files(args: &Args, report: &Report, result: GraspResult, axes: Value) -> Result<()> {
    if let Some(path) = &args.out.plot {
        let height = report.parameters.protocol.success_height_m;
        let image = plot(&result.trace, &report.summary, height, &args.object.object);
        save(path, image.as_bytes())?;
    }
    if let Some(path) = &args.out.trace {
        let mut header = serde_json::to_value(report)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        header["gel_axes_m"] = axes;
        let file = TraceFile {
            header,
            trace: result.trace,
        };
        let bytes = if suffix(path) == "bin" {
            file.to_bytes()?
        } else {
            file.to_json()?
        };
        save(path, &bytes)?;
    }
    Ok(())
}

/// The result for people.
fn text(report: &Report) -> String {
    let summary = &report.summary;
    let mut lines = vec![format!(
        "{}{}",
        outcome_text(summary.outcome),
        summary
            .detail
            .as_ref()
            .map_or(String::new(), |d| format!(": {d}"))
    )];
    if summary.steps > 0 {
        lines.push(format!(
            "lifted      {} mm",
            rounded(1e3 * summary.lifted_m, 1)
        ));
        lines.push(format!(
            "force       {} N left, {} N right, threshold {} N",
            rounded(summary.force_n.left, 2),
            rounded(summary.force_n.right, 2),
            summary.stop_force_n
        ));
    }
    if let (Some(mean), Some(std)) = (summary.mean_force_n, summary.std_force_n) {
        let steady = if summary.steady == Some(true) {
            "steady"
        } else {
            "not steady"
        };
        lines.push(format!(
            "adjustment  {} ± {std:.2} N over its last {STEADY_STEPS} steps, {steady}",
            rounded(mean, 2)
        ));
    }
    lines.push(format!(
        "time        {:.2} s simulated in {:.2} s: {} steps, {:.1} Newton iterations a step",
        summary.simulated_s, report.wall_s, summary.steps, summary.newton_per_step
    ));
    lines.join("\n")
}

/// A number with some decimals, and never minus zero.
fn rounded(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    let is_zero = text
        .trim_start_matches('-')
        .chars()
        .all(|c| c == '0' || c == '.');
    let text = if is_zero {
        text.trim_start_matches('-')
    } else {
        &text
    };
    text.to_owned()
}

fn outcome_text(outcome: GraspOutcome) -> &'static str {
    match outcome {
        GraspOutcome::Success => "success: the object was lifted and held",
        GraspOutcome::Slip => "slip: the object was not held through the lift",
        GraspOutcome::Eject => "eject: the object was squeezed out before the lift",
        GraspOutcome::Miss => "miss: the fingers closed without touching the object",
        GraspOutcome::GelsMet => "gels_met: the gels met before the force was reached",
        GraspOutcome::PenetratingStart => "penetrating_start: nothing was simulated",
        GraspOutcome::NotConverged => "not_converged: there is no outcome",
    }
}

/// Hints for people, and the error of a grasp without outcome.
fn finish(context: &Context, report: &Report) -> Result<()> {
    let summary = &report.summary;
    if !context.quiet {
        for warning in &summary.warnings {
            // Those of the mesh were said before.
            if warning.contains("converge") {
                note!("gripcast: {warning}");
            }
        }
        if summary.outcome == GraspOutcome::PenetratingStart {
            note!(
                "gripcast: the gripper starts in collision\n  → open it further (--width), raise \
                 it (--height) or shift it (--offset-x, --offset-y)"
            );
        }
    }
    if summary.outcome == GraspOutcome::NotConverged {
        return Err(Error::new(
            ErrorKind::Check,
            format!("{} steps did not converge", summary.unconverged_steps),
        )
        .remedy("try a smaller --dt, more --max-iterations or another --gel"));
    }
    Ok(())
}
