//! `gripcast-bench early-end`: how often a lift that ends once its outcome is certain has another
//! outcome than the full protocol, and the work that it saves.
//!
//! Procedural objects and grasps as in `gripcast synth`, each simulated with the full protocol; the
//! rule ([`LiftMonitor`]) then reads their traces. A grasp without contact before the lift is left
//! out, as from a dataset.
//!
//! Exit codes: 0 measured · 4 the rule is wrong for more than 0.5 % of the grasps · 130 interrupted.

use std::sync::Mutex;

use glam::DVec3;
use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast::cli::working::{Progress, interruptible};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::workers::cores;
use gripcast_geometry::{MassProperties, Pose};
use gripcast_sim::fem::{GelGrid, GelPad, GelResolution};
use gripcast_sim::grasp::{
    GraspOutcome, GraspResult, GraspSettings, LiftMonitor, Preset, StageName, TraceStep,
    height_above_ground,
};
use gripcast_sim::{Engine, EngineKind, FemEngine, GraspSetup};
use gripcast_synth::plan::{family_drafts, make_plan};
use gripcast_synth::simulate_labels;
use serde::Serialize;
use serde_json::{Value, json};

use crate::synth::plan_settings;

/// Maximum fraction of grasps with another outcome.
const MAX_WRONG: f64 = 0.005;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Number of objects, each with one grasp at 10 and 40 N
    #[arg(long, value_name = "N", default_value_t = 18)]
    objects: usize,
    /// Gel mesh
    #[arg(long, value_parser = GelResolution::from_name, default_value = "coarse")]
    gel: GelResolution,
    /// Random seed of the plan
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Figures of the rule.
#[derive(Clone, Debug, Default, Serialize)]
struct Figures {
    grasps: usize,
    stable: usize,
    /// Grasps that end early as held, and of those, the ones that the full protocol loses.
    held: [usize; 2],
    /// Grasps that end early as lost, and of those, the ones that the full protocol holds.
    lost: [usize; 2],
    /// Newton iterations of all grasps, and of those, the ones after the early end.
    iterations: [u64; 2],
}

/// Simulates in full and reads the rule from the trace.
struct Recorder {
    engine: FemEngine,
    figures: Mutex<Figures>,
}

impl Engine for Recorder {
    fn kind(&self) -> EngineKind {
        self.engine.kind()
    }

    fn parameters(&self) -> Result<Value> {
        self.engine.parameters()
    }

    fn success_height_m(&self) -> f64 {
        self.engine.success_height_m()
    }

    fn pad(&self) -> GelPad {
        self.engine.pad()
    }

    fn gel(&self) -> Result<Option<(GelGrid, f64)>> {
        self.engine.gel()
    }

    fn simulate(&self, setup: &GraspSetup, friction: f64, force_n: f64) -> Result<GraspResult> {
        let result = self.engine.simulate(setup, friction, force_n)?;
        let mut figures = self
            .figures
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        figures.add(setup, &result)?;
        Ok(result)
    }
}

impl Figures {
    fn add(&mut self, setup: &GraspSetup, result: &GraspResult) -> Result<()> {
        let stable = match result.outcome {
            GraspOutcome::Success => true,
            GraspOutcome::Slip => false,
            _ => return Ok(()),
        };
        self.grasps += 1;
        self.stable += usize::from(stable);
        let steps = &result.trace.steps;
        let iterations = |steps: &[TraceStep]| -> u64 {
            let reports = steps.iter().filter_map(|step| step.solver);
            reports.map(|report| u64::from(report.iterations)).sum()
        };
        self.iterations[0] += iterations(steps);
        let center_m = MassProperties::from_mesh(&setup.mesh)?.center_of_mass_m;
        let before = result
            .trace
            .snapshots
            .iter()
            .find(|s| s.stage == StageName::Adjustment);
        let Some(before) = before else { return Ok(()) };
        let mut monitor = LiftMonitor::default();
        for (index, step) in steps.iter().enumerate() {
            if step.stage != StageName::Lift {
                continue;
            }
            let lift = Pose::from_translation(DVec3::Z * step.lifted_m);
            let t_gripper_object = (lift * before.t_world_gripper).inverse() * step.t_world_object;
            let outcome = monitor.add(
                step.lifted_m,
                step.force.map(|force| force.normal_n),
                t_gripper_object,
                center_m,
                height_above_ground(&setup.mesh, &step.t_world_object),
            );
            let Some(outcome) = outcome else { continue };
            self.iterations[1] += iterations(&steps[index + 1..]);
            let (counts, is_wrong) = match outcome {
                GraspOutcome::Success => (&mut self.held, !stable),
                _ => (&mut self.lost, stable),
            };
            counts[0] += 1;
            counts[1] += usize::from(is_wrong);
            break;
        }
        Ok(())
    }

    fn wrong(&self) -> usize {
        self.held[1] + self.lost[1]
    }
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let own = args.clone();
    let figures = interruptible(context, "simulating", move |progress| {
        measure(&own, progress)
    })??;
    let params = json!({"objects": args.objects, "gel": args.gel.name(), "seed": args.seed});
    let text = format!(
        "{} grasps, {} stable: {} end early as held ({} wrong), {} as lost ({} wrong); {:.1} % of the \
         iterations saved",
        figures.grasps,
        figures.stable,
        figures.held[0],
        figures.held[1],
        figures.lost[0],
        figures.lost[1],
        1e2 * figures.iterations[1] as f64 / figures.iterations[0].max(1) as f64,
    );
    Report::new("early-end", params, json!(figures), text).print(args.json)?;
    if figures.wrong() as f64 > MAX_WRONG * figures.grasps as f64 {
        return Err(Error::new(
            ErrorKind::Check,
            "the early end is wrong for more than 0.5 % of the grasps",
        ));
    }
    Ok(())
}

fn measure(args: &Args, progress: &Progress) -> Result<Figures> {
    let folder = tempfile::tempdir().map_err(|e| Error::io("cannot create a folder", e))?;
    let mut settings = GraspSettings::new(Preset::Paper);
    settings.resolution = args.gel;
    let recorder = Recorder {
        engine: FemEngine { settings },
        figures: Mutex::default(),
    };
    let drafts = family_drafts(args.objects, args.seed, cores(), &|_| ())?;
    let settings = plan_settings(args.seed, 1, cores());
    let made = make_plan(&settings, drafts.into(), &recorder, None, &|_| ())?;
    made.write(folder.path())?;
    let total = made.plan.simulations.len();
    let on_progress = |done: usize| progress.count(done, total);
    simulate_labels(&made.plan, folder.path(), &recorder, cores(), &on_progress)?;
    let figures = recorder.figures.into_inner();
    Ok(figures.unwrap_or_else(std::sync::PoisonError::into_inner))
}
