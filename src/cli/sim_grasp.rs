//! `gripcast sim grasp`: simulates one grasp.
//!
//! ```text
//! gripcast sim grasp --object builtin:mug --stop-force-n 40 --plot mug.svg
//! gripcast sim grasp --object part.stl --unit mm --mass-kg 0.05 --friction 0.5 --yaw-deg 30 --json
//! gripcast sim grasp --object part.stl --unit mm --pose grasp.json --trace grasp.bin
//! gripcast sim grasp --object builtin:mug --trace mug.bin --fields every:10
//! ```
//!
//! The gripper closes, adjusts its force and lifts. Without `--pose` it approaches from above,
//! centred on the object. `--trace` writes every step (`.json`, or `.bin` for programs), `--plot`
//! the forces and heights (`.svg`). `--fields` adds displacement, traction, stick and slip of the
//! gels' faces to a binary trace: as text they would be six times as large.
//!
//! Exit codes: 0 simulated, whatever the outcome · 1 invalid object, pose or file · 2 usage ·
//! 4 steps did not converge, so there is no outcome · 130 interrupted.

use std::path::PathBuf;
use std::time::Instant;

use serde::Serialize;
use serde_json::{Value, json};

use super::flags::{
    ThreadsFlag, above_zero, check_output, degrees, gel_resolution, number, preset, suffix,
};
use super::sim_object::{ObjectFlags, ObjectRecord, read_grasp_pose};
use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::save;
use gripcast_base::number::NumberRange;
use gripcast_geometry::{Pose, PreparedMesh, TriangleMesh};
use gripcast_replay::plot;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::fields::FieldSampling;
use gripcast_sim::grasp::{
    ChosenStablePose, ForceRule, GRIPPER_OPENING_M, GraspOutcome, GraspResult, GraspSettings,
    GraspStart, GraspSummary, Placement, Preset, STEADY_STEPS, Scene, TACCEL_DRIVE_WEIGHT,
    TraceFile, simulate_with_fields,
};
use gripcast_sim::solver::{Drive, PhaseTimes};
use gripcast_tactile::SensorProfile;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    object: ObjectFlags,
    #[command(flatten)]
    pose: PoseFlags,
    #[command(flatten)]
    settings: SettingsFlags,
    #[command(flatten)]
    out: OutFlags,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Gripper pose")]
struct PoseFlags {
    /// JSON file with t_object_gripper, optionally t_world_object and opening_m
    #[arg(long, value_name = "FILE", conflicts_with_all = [
        "height", "offset_x", "offset_y", "yaw_deg", "roll_deg", "pitch_deg",
    ])]
    pose: Option<PathBuf>,
    /// Stable pose of the object, 0 being the most probable [default: the nearest within 5°, else
    /// 0]
    #[arg(long, value_name = "INDEX")]
    stable_pose: Option<usize>,
    /// Initial distance between the gels [default: object width + 2 mm]
    #[arg(long, value_name = "M", value_parser = above_zero)]
    width: Option<f64>,
    /// Largest opening of the gripper
    #[arg(long, value_name = "M", default_value_t = GRIPPER_OPENING_M, value_parser = above_zero)]
    max_opening: f64,
    /// Height of the gel centres above the ground [default: the object's centre]
    #[arg(long, value_name = "M", value_parser = number(NumberRange::FINITE))]
    height: Option<f64>,
    /// Offset along the closing direction
    #[arg(long, value_name = "M", default_value_t = 0.0,
        value_parser = number(NumberRange::FINITE))]
    offset_x: f64,
    /// Offset across the closing direction
    #[arg(long, value_name = "M", default_value_t = 0.0,
        value_parser = number(NumberRange::FINITE))]
    offset_y: f64,
    /// Rotation about the vertical [default: 0, or 90 if the object only fits then]
    #[arg(long, value_name = "DEG", value_parser = degrees)]
    yaw_deg: Option<f64>,
    /// Rotation about the gripper's y axis: one finger higher than the other
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = degrees)]
    roll_deg: f64,
    /// Rotation about the gripper's x axis (closing direction): approach off the vertical
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = degrees)]
    pitch_deg: f64,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Grasp and solver settings")]
struct SettingsFlags {
    /// Gel parameters
    #[arg(long, value_name = "PRESET", default_value = "paper", value_parser = preset())]
    preset: Preset,
    /// Sensor whose pad and elastic law the gels have [default: 25 × 20 × 4 mm, --preset]
    #[arg(long, value_name = "NAME|FILE.toml", conflicts_with = "preset")]
    profile: Option<String>,
    /// Gel mesh
    #[arg(long, value_name = "MESH", default_value = "default", value_parser = gel_resolution())]
    gel: GelResolution,
    /// Stopping force per finger
    #[arg(long, value_name = "NEWTON", default_value_t = 40.0, value_parser = above_zero)]
    stop_force_n: f64,
    /// Duration of the force adjustment
    #[arg(long, value_name = "S", default_value_t = 1.5, value_parser = above_zero)]
    adjust_s: f64,
    /// Force controller of the adjustment
    #[arg(long, value_enum, default_value_t = RuleName::BangBang)]
    rule: RuleName,
    /// Gain of --rule proportional: finger displacement per newton of force error
    #[arg(long, value_name = "M_PER_N", default_value_t = ForceRule::GAIN_M_PER_N, value_parser = above_zero)]
    gain: f64,
    /// Lift height
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = above_zero)]
    lift: f64,
    /// Boundary drive: penalty stiffness per area or per nodal mass
    #[arg(long, value_enum, default_value_t = DriveName::Area)]
    drive: DriveName,
    /// Time step
    #[arg(long, value_name = "S", default_value_t = 0.01, value_parser = above_zero)]
    dt: f64,
    /// Sliding speed below which friction is regularised: loaded contacts creep at up to this speed
    #[arg(long, value_name = "M_PER_S", default_value_t = 1e-3, value_parser = above_zero)]
    eps_v: f64,
    /// Newton convergence tolerance (max nodal speed, m/s)
    #[arg(long, value_name = "M_PER_S", default_value_t = 1e-4, value_parser = above_zero)]
    tolerance: f64,
    /// Newton iteration limit per step
    #[arg(long, value_name = "N", default_value_t = 200,
        value_parser = clap::value_parser!(u32).range(1..))]
    max_iterations: u32,
    #[command(flatten)]
    threads: ThreadsFlag,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Output")]
struct OutFlags {
    /// Write every step and the states at the ends of the phases
    #[arg(long, value_name = "FILE.json|.bin")]
    trace: Option<PathBuf>,
    /// Record displacement, traction, stick and slip of the gels' faces in the trace, which must be
    /// binary: every:N time steps, at the ends of the stages, or all
    #[arg(long, value_name = "every:N|stages|all", requires = "trace")]
    fields: Option<FieldSampling>,
    /// Plot forces and heights
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum DriveName {
    /// 5e9 N/m³, independent of the mesh
    Area,
    /// 5e4 · mass / dt² as in Taccel, softer on finer meshes
    Taccel,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum RuleName {
    /// Open above the stopping force, else close, at 2 mm/s
    BangBang,
    /// Proportional to the force error, at most 2 mm/s
    Proportional,
}

impl SettingsFlags {
    fn settings(&self) -> Result<GraspSettings> {
        let mut settings = GraspSettings::new(self.preset);
        if let Some(name) = &self.profile {
            let profile = SensorProfile::named_or_load(name)?;
            (settings.pad, settings.material) = (profile.pad(), profile.gel_material());
        }
        settings.resolution = self.gel;
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
        settings.solver.eps_v_m_s = self.eps_v;
        settings.solver.newton_tolerance_m_s = self.tolerance;
        settings.solver.max_iterations = self.max_iterations;
        Ok(settings)
    }
}

#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    summary: GraspSummary,
    /// Number of warnings of the mesh and the pose, which are printed before the simulation.
    #[serde(skip)]
    early_warnings: usize,
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
    /// The chosen stable pose, unless the pose file has `t_world_object`.
    stable_pose: Option<ChosenStablePose>,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    args.out.check()?;
    let settings = args.settings.settings()?;
    let prepared = args.object.mesh.load()?;
    let object = ObjectRecord::new(&args.object, &prepared);
    let PreparedMesh { mesh, warnings, .. } = prepared;
    let GraspStart {
        t_world_object,
        stable_pose,
        gripper: placed,
        warnings: of_pose,
    } = place(&mesh, &args.pose, &settings)?;
    let warnings = [warnings, of_pose].concat();
    let scene = Scene {
        mesh,
        mass_kg: args.object.mass_kg,
        friction: args.object.friction,
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
        gel: settings.gel()?,
    };
    let name = &args.object.mesh.object;
    context.warn(warnings.iter().map(|w| format!("{name}: {w}")));
    let gel_axes_m = scene.gel.grid.axes().clone();
    let pool = args.settings.threads.pool()?;
    let fields = args.out.fields;
    let (result, wall_s) = interruptible(context, "simulating the grasp", move |_| {
        let started = Instant::now();
        let result = pool.install(|| {
            simulate_with_fields(&scene, &settings.protocol, &settings.solver, fields)
        })?;
        Ok::<_, Error>((result, started.elapsed().as_secs_f64()))
    })??;
    let mut summary = GraspSummary::new(&result, &settings.protocol, settings.solver.dt_s);
    let early_warnings = warnings.len();
    summary.warnings.splice(0..0, warnings);
    let report = Report {
        early_warnings,
        wall_s,
        times: result.times,
        object,
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

fn place(mesh: &TriangleMesh, flags: &PoseFlags, settings: &GraspSettings) -> Result<GraspStart> {
    if let Some(path) = &flags.pose {
        let mut pose = read_grasp_pose(path)?;
        pose.opening_m = flags.width.or(pose.opening_m);
        return GraspStart::recorded(mesh, flags.stable_pose, &pose, flags.max_opening)
            .map_err(|e| e.at(path.display()));
    }
    let placement = Placement {
        yaw_rad: flags.yaw_deg.unwrap_or(0.0).to_radians(),
        roll_rad: flags.roll_deg.to_radians(),
        pitch_rad: flags.pitch_deg.to_radians(),
        offset_m: [flags.offset_x, flags.offset_y],
        height_m: flags.height,
        opening_m: flags.width,
        pad: settings.pad,
    };
    let may_turn = flags.yaw_deg.is_none();
    GraspStart::from_above(
        mesh,
        flags.stable_pose,
        &placement,
        flags.max_opening,
        may_turn,
    )
}

impl OutFlags {
    /// Refuses invalid output files before anything is simulated.
    fn check(&self) -> Result<()> {
        let trace = self.trace.iter();
        let plot = self.plot.iter();
        let formats: &[&str] = match self.fields {
            Some(_) => &["bin"],
            None => &["json", "bin"],
        };
        trace
            .map(|path| check_output("--trace", path, formats))
            .chain(plot.map(|path| check_output("--plot", path, &["svg"])))
            .collect()
    }
}

fn write_files(args: &Args, report: &Report, result: GraspResult, axes: Value) -> Result<()> {
    if let Some(path) = &args.out.plot {
        let height = report.parameters.protocol.success_height_m;
        let image = plot(
            &result.trace,
            &report.summary,
            height,
            &args.object.mesh.object,
        );
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

/// Formats the result.
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
            "force       {} N left, {} N right, threshold {} N{}",
            rounded(summary.force_n.left, 2),
            rounded(summary.force_n.right, 2),
            summary.stop_force_n,
            if summary.reached_stop_force {
                ""
            } else {
                ", never reached"
            }
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
    if let Some(friction_use) = summary.friction_use {
        lines.push(format!(
            "friction    {:.0} % of its limit in the lift",
            100.0 * friction_use
        ));
    }
    lines.push(format!(
        "time        {:.2} s simulated in {:.2} s: {} steps, {:.1} Newton iterations a step",
        summary.simulated_s, report.wall_s, summary.steps, summary.newton_per_step
    ));
    lines.join("\n")
}

/// Formats a number with fixed decimals and without a negative zero.
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
        GraspOutcome::Success => "success: the object was lifted",
        GraspOutcome::Slip => "slip: the object slipped during the lift",
        GraspOutcome::Eject => "eject: the object was squeezed out before the lift",
        GraspOutcome::Miss => "miss: the fingers closed without touching the object",
        GraspOutcome::GelsMet => "closed: the gels met before the force was reached",
        GraspOutcome::PenetratingStart => "penetrating_start: not simulated",
        GraspOutcome::NotConverged => "not_converged: no outcome",
    }
}

/// Prints warnings and returns the error of a grasp without an outcome.
fn finish(context: &Context, report: &Report) -> Result<()> {
    let summary = &report.summary;
    context.warn(&report.summary.warnings[report.early_warnings..]);
    if summary.outcome == GraspOutcome::PenetratingStart {
        context.warn([
            "the gripper starts in collision\n  → open it further (--width), raise it (--height) or \
             shift it (--offset-x, --offset-y)",
        ]);
    }
    if summary.outcome == GraspOutcome::NotConverged {
        return Err(Error::new(
            ErrorKind::Check,
            format!("{} steps did not converge", summary.unconverged_steps),
        )
        .remedy("try a smaller --dt, a larger --max-iterations or another --gel"));
    }
    Ok(())
}
