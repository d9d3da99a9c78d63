//! `gripcast synth plan`: what is to be simulated.
//!
//! The same flags give the same plan, byte for byte. Exit codes: 0 a plan was written · 1 it could
//! not be · 2 usage · 3 objects were left out of it, each with its reason · 130 interrupted.

use std::path::PathBuf;

use serde_json::json;

use super::sim_grasp::{GelName, PresetName, above_zero};
use super::working::{Progress, interruptible};
use super::{Context, print, print_json};
use crate::error::{Error, ErrorKind, Result};
use crate::sim::grasp::GraspSettings;
use crate::sim::rigid::{RigidEngine, RigidSettings};
use crate::sim::{Engine, FemEngine};
use crate::synth::plan::{
    MadePlan, PlanPreset, PlanSettings, RenderingPlan, family_drafts, make_plan,
};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Size of the plan
    #[arg(long, value_enum, default_value_t = PresetSize::Small)]
    preset: PresetSize,
    /// Folder of the plan and later of its results
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Everything that is drawn follows from it
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Objects of the built-in families [default: that of the preset]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    objects: Option<u32>,
    /// Grasps of each object [default: that of the preset]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    grasps: Option<u32>,
    /// Simulator
    #[arg(long, value_enum, default_value_t = EngineName::Fem)]
    engine: EngineName,
    /// Stopping forces at which each grasp is simulated
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [10.0, 40.0],
        value_parser = above_zero)]
    stop_force_n: Vec<f64>,
    /// Mesh of the gels
    #[arg(long, value_enum, default_value_t = GelName::Coarse)]
    gel: GelName,
    /// Set of parameters of the finite elements
    #[arg(long, value_enum, default_value_t = PresetName::Paper)]
    gel_preset: PresetName,
    /// Iterations after which a simulation is given up
    #[arg(long, value_name = "N", default_value_t = 50_000,
        value_parser = clap::value_parser!(u64).range(1..))]
    max_iterations: u64,
    /// Renderings of each simulation [default: that of the preset]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    renderings: Option<u32>,
    /// Paths for each pixel of a colour picture
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    samples: Option<u32>,
    /// Spread of the tactile sensors: 0 the shipped profile, 1 as real ones differ
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    sensor_spread: f64,
    /// Keep masses as estimated instead of mapping them to 10 to 200 g as the paper does
    #[arg(long)]
    true_masses: bool,
    /// Objects at a time; the plan does not depend on it [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
    /// Print what was planned as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum PresetSize {
    /// 4 objects, 2 grasps each: to see that it works
    Tiny,
    /// 60 objects, 5 grasps each
    Small,
    /// 453 objects, 24 grasps each, as in the paper
    Full,
}

impl From<PresetSize> for PlanPreset {
    fn from(size: PresetSize) -> Self {
        match size {
            PresetSize::Tiny => Self::Tiny,
            PresetSize::Small => Self::Small,
            PresetSize::Full => Self::Full,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum EngineName {
    /// Finite-element gels, incremental potential contact
    Fem,
    /// Rigid fingers and convex pieces
    Rigid,
}

/// Runs the verb.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let (out, is_json) = (args.out.clone(), args.json);
    let made = interruptible(context, "planning", move |progress| {
        let made = args.make(progress)?;
        made.plan.write(&args.out)?;
        Ok::<MadePlan, Error>(made)
    })??;
    let MadePlan { plan, left_out } = &made;
    let cost_h = plan.simulations.iter().map(|s| s.cost_s).sum::<f64>() / 3600.0;
    if is_json {
        print_json(&json!({
            "plan": out,
            "sha256": plan.sha256,
            "objects": plan.objects.len(),
            "simulations": plan.simulations.len(),
            "estimated_cpu_h": cost_h,
            "left_out": left_out
                .iter()
                .map(|one| json!({"object": one.name, "reason": one.reason}))
                .collect::<Vec<_>>(),
        }))?;
    } else {
        print(&format!(
            "{} simulations of {} objects, about {cost_h:.1} CPU hours; plan {}",
            plan.simulations.len(),
            plan.objects.len(),
            &plan.sha256[..12],
        ))?;
    }
    if left_out.is_empty() {
        return Ok(());
    }
    let mut text = format!("{} objects are not in the plan:", left_out.len());
    for one in left_out {
        text.push_str(&format!("\n  {}: {}", one.name, one.reason));
    }
    Err(Error::new(ErrorKind::Partial, text))
}

impl Args {
    fn make(&self, progress: &Progress) -> Result<MadePlan> {
        let preset = PlanPreset::from(self.preset);
        if !(0.0..=3.0).contains(&self.sensor_spread) {
            return Err(Error::new(
                ErrorKind::Usage,
                format!(
                    "`--sensor-spread` must be from 0 to 3, found {}",
                    self.sensor_spread
                ),
            ));
        }
        let of_preset = preset.rendering();
        let jobs = self.jobs.map_or_else(
            || std::thread::available_parallelism().map_or(1, usize::from),
            usize::from,
        );
        let settings = PlanSettings {
            preset: preset.name().to_owned(),
            seed: self.seed,
            grasps: self.grasps.map_or(preset.grasps(), |n| n as usize),
            stop_forces_n: self.stop_force_n.clone(),
            rendering: RenderingPlan {
                renderings: self.renderings.unwrap_or(of_preset.renderings),
                samples: self.samples.unwrap_or(of_preset.samples),
                sensor_spread: self.sensor_spread,
            },
            map_masses: !self.true_masses,
            jobs,
        };
        let count = self.objects.map_or(preset.objects(), |n| n as usize);
        progress.stage("making objects");
        let told = |done: usize| progress.at(done as u64, count as u64);
        let drafts = family_drafts(count, self.seed, jobs, &told)?;
        progress.stage("drawing grasps");
        make_plan(&settings, drafts, self.engine().as_ref(), None, &told)
    }

    fn engine(&self) -> Box<dyn Engine> {
        match self.engine {
            EngineName::Fem => {
                let mut settings = GraspSettings::new(self.gel_preset.into());
                settings.resolution = self.gel.into();
                settings.solver.max_grasp_iterations = self.max_iterations;
                Box::new(FemEngine { settings })
            }
            EngineName::Rigid => Box::new(RigidEngine::new(RigidSettings::default())),
        }
    }
}
