//! `gripcast synth run` and `gripcast synth status`: the simulations of a plan.
//!
//! Exit codes of `run`: 0 all simulations of the part have a result · 1 it could not run · 2 usage ·
//! 3 some simulations could not be done, each with its reason · 75 stopped by SIGTERM, run it again ·
//! 130 interrupted. Every finished simulation is kept; the one under way is done again.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde_json::json;

use super::synth_merge::ChoiceArgs;
use super::working::resumable;
use super::{Context, print, print_json};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::workers::cores;
use gripcast_synth::plan::{Plan, Shard};
use gripcast_synth::{
    ImageSelection, MergeSettings, ResultStore, RunSettings, planned_engine, select_simulations,
};

/// Reasons of failures that are shown.
const SHOWN_FAILURES: usize = 10;

/// Arguments of `run`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the plan
    #[arg(long, value_name = "DIR")]
    plan: PathBuf,
    /// Part of the plan, from 0: INDEX/COUNT, or /COUNT with the index from SLURM_ARRAY_TASK_ID,
    /// JOB_COMPLETION_INDEX, AWS_BATCH_JOB_ARRAY_INDEX or PBS_ARRAY_INDEX
    #[arg(long, value_name = "I/N")]
    shard: Option<String>,
    /// Simulations at a time; the results do not depend on it [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
    /// Which simulations get images; labels alone are there sooner, and a balanced dataset needs
    /// the images of half of them
    #[arg(long, value_enum, default_value_t = ImagesName::All)]
    images: ImagesName,
    /// With --images chosen: those that `synth merge --partial` takes of what has a label by now;
    /// nothing is simulated
    #[arg(long)]
    partial: bool,
    /// Try simulations again that could not be done, as after a damaged mesh was restored
    #[arg(long)]
    retry_failed: bool,
    /// Print what was done as JSON
    #[arg(long)]
    json: bool,
    #[command(
        flatten,
        next_help_heading = "With --images chosen, as given to synth merge"
    )]
    choice: ChoiceArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ImagesName {
    /// All with a label
    All,
    /// None of them
    None,
    /// Those that `synth merge` takes; all simulations have to have a label, or see --partial
    Chosen,
}

/// Arguments of `status`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct StatusArgs {
    /// Folder of the plan
    #[arg(long, value_name = "DIR")]
    plan: PathBuf,
    /// Print it as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `synth run`.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let shard = match &args.shard {
        Some(text) => Shard::parse(text, |name| std::env::var(name).ok())?,
        None => Shard::WHOLE,
    };
    let folder = args.plan.clone();
    let choice = args.choice.curation()?;
    if args.partial && args.images != ImagesName::Chosen {
        return Err(Error::usage(
            "--partial is for the images that a dataset of an unfinished plan needs",
        )
        .remedy("give --images chosen with it, or leave it out"));
    }
    let summary = resumable(context, "simulating", move |progress| {
        let plan = Plan::read(&folder)?;
        let settings = RunSettings {
            shard,
            jobs: args.jobs.map_or_else(cores, usize::from),
            retry_failed: args.retry_failed,
            simulate_open: !args.partial,
            images: match args.images {
                ImagesName::All => ImageSelection::All,
                ImagesName::None => ImageSelection::None,
                ImagesName::Chosen => {
                    let settings = MergeSettings {
                        curation: choice,
                        allow_partial: args.partial,
                    };
                    ImageSelection::Only(select_simulations(&plan, &folder, &settings)?)
                }
            },
        };
        let engine = planned_engine(&plan, &folder)?;
        gripcast_synth::run(&plan, &folder, &settings, engine.as_ref(), &|at| {
            progress.at(at.done as u64, at.total as u64);
        })
    })??;
    let failed = summary.failed.len();
    if args.json {
        print_json(&json!({
            "shard": shard.to_string(),
            "simulations": summary.total,
            "simulated_now": summary.simulated,
            "failed": summary.failed.iter().cloned().collect::<BTreeMap<_, _>>(),
        }))?;
    } else {
        print(&format!(
            "{} simulations of shard {shard}, {} of them now, {failed} could not be done",
            summary.total, summary.simulated
        ))?;
    }
    if failed == 0 {
        return Ok(());
    }
    let mut text = format!("{failed} simulations could not be done:");
    for (id, why) in summary.failed.iter().take(SHOWN_FAILURES) {
        text.push_str(&format!("\n  {id}: {why}"));
    }
    if failed > SHOWN_FAILURES {
        text.push_str("\n  …");
    }
    Err(Error::new(ErrorKind::Partial, text).remedy(
        "they are results like others; once the cause is fixed, --retry-failed does them again",
    ))
}

/// Runs `synth status`.
pub(super) fn status(args: &StatusArgs) -> Result<()> {
    let plan = Plan::read(&args.plan)?;
    let store = ResultStore::new(&args.plan);
    let mut outcomes: BTreeMap<String, usize> = BTreeMap::new();
    let [mut stable, mut slip, mut rows, mut lacking] = [0; 4];
    let [mut open_s, mut cpu_s] = [0.0; 2];
    let mut done = 0;
    for simulation in &plan.simulations {
        let Some(result) = store.load(&plan, &simulation.id)? else {
            open_s += simulation.cost_s;
            continue;
        };
        done += 1;
        stable += usize::from(result.stable == Some(true));
        slip += usize::from(result.stable == Some(false));
        rows += result.samples.as_ref().map_or(0, |file| file.rows);
        lacking += usize::from(result.lacks_images());
        let cpu = result.cpu_s;
        cpu_s += cpu.prepare + cpu.simulate + cpu.tactile + cpu.visual;
        *outcomes.entry(result.outcome).or_default() += 1;
    }
    let all = plan.simulations.len();
    if args.json {
        return print_json(&json!({
            "plan_sha256": plan.sha256,
            "simulations": all,
            "done": done,
            "stable": stable,
            "slip": slip,
            "rows": rows,
            "without_images": lacking,
            "outcomes": outcomes,
            "cpu_s": cpu_s,
            "estimated_open_cpu_s": open_s,
        }));
    }
    let outcomes: Vec<String> = outcomes
        .iter()
        .map(|(name, count)| format!("{count} {name}"))
        .collect();
    let lacking = match lacking {
        0 => String::new(),
        count => format!(", {count} with a label and without images"),
    };
    print(&format!(
        "{done} of {all} simulations done: {stable} held, {slip} lost, {rows} renderings{lacking}\n\
         outcomes: {}\n\
         {:.1} CPU hours used, about {:.1} to go",
        outcomes.join(", "),
        cpu_s / 3600.0,
        open_s / 3600.0
    ))
}
