//! `gripcast synth run` and `gripcast synth status`: the simulations of a plan.
//!
//! Exit codes of `run`: 0 all simulations of the shard have a result · 1 failed · 2 usage · 3 some
//! simulations failed · 75 stopped by SIGTERM, rerun to resume · 130 interrupted. Finished
//! simulations are kept; the running ones are repeated.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde_json::json;

use super::flags::JobsFlag;
use super::synth_merge::SelectionFlags;
use super::working::resumable;
use super::{Context, print, print_json};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_synth::plan::{Plan, Shard};
use gripcast_synth::{
    ImageSelection, MergeSettings, ResultStore, RunSettings, planned_engine, select_simulations,
};

/// Maximum number of failures in the error text.
const MAX_SHOWN_FAILURES: usize = 10;

/// Arguments of `run`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the plan
    #[arg(long, value_name = "DIR")]
    plan: PathBuf,
    /// Shard to run, from 0: INDEX/COUNT, or /COUNT with the index from SLURM_ARRAY_TASK_ID,
    /// JOB_COMPLETION_INDEX, AWS_BATCH_JOB_ARRAY_INDEX or PBS_ARRAY_INDEX [default: whole plan]
    #[arg(long, value_name = "I/N")]
    shard: Option<String>,
    #[command(flatten)]
    jobs: JobsFlag,
    /// Simulations to render; labels alone are faster, and a balanced dataset needs about half of
    /// the images
    #[arg(long, value_enum, default_value_t = ImagesName::All)]
    images: ImagesName,
    /// With --images chosen: render the current selection of `synth merge --partial`; nothing is
    /// simulated
    #[arg(long)]
    partial: bool,
    /// Retry failed simulations, for instance after restoring a damaged mesh
    #[arg(long)]
    retry_failed: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    #[command(
        flatten,
        next_help_heading = "Selection for --images chosen, as for synth merge"
    )]
    selection: SelectionFlags,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ImagesName {
    /// All labelled simulations
    All,
    /// None
    None,
    /// The selection of `synth merge`; needs labels of all simulations, or --partial
    Chosen,
}

/// Arguments of `status`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct StatusArgs {
    /// Folder of the plan
    #[arg(long, value_name = "DIR")]
    plan: PathBuf,
    /// Print the result as JSON
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
    let curation = args.selection.curation();
    if args.partial && args.images != ImagesName::Chosen {
        return Err(Error::usage("--partial needs --images chosen")
            .remedy("add --images chosen, or omit --partial"));
    }
    let summary = resumable(context, "simulating", move |progress| {
        let plan = Plan::read(&folder)?;
        let settings = RunSettings {
            shard,
            jobs: args.jobs.count(),
            retry_failed: args.retry_failed,
            simulate_open: !args.partial,
            images: match args.images {
                ImagesName::All => ImageSelection::All,
                ImagesName::None => ImageSelection::None,
                ImagesName::Chosen => {
                    let settings = MergeSettings {
                        curation,
                        allow_partial: args.partial,
                    };
                    ImageSelection::Only(select_simulations(&plan, &folder, &settings)?)
                }
            },
        };
        let engine = planned_engine(&plan, &folder)?;
        gripcast_synth::run(&plan, &folder, &settings, engine.as_ref(), &|at| {
            progress.count(at.done, at.total);
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
            "{} simulations in shard {shard}, {} run now, {failed} failed",
            summary.total, summary.simulated
        ))?;
    }
    if failed == 0 {
        return Ok(());
    }
    let mut text = format!("{failed} simulations failed:");
    for (id, reason) in summary.failed.iter().take(MAX_SHOWN_FAILURES) {
        text.push_str(&format!("\n  {id}: {reason}"));
    }
    if failed > MAX_SHOWN_FAILURES {
        text.push_str("\n  …");
    }
    Err(Error::new(ErrorKind::Partial, text)
        .remedy("fix the cause, then repeat them with --retry-failed"))
}

/// Runs `synth status`.
pub(super) fn status(args: &StatusArgs) -> Result<()> {
    let plan = Plan::read(&args.plan)?;
    let store = ResultStore::new(&args.plan);
    let mut outcomes: BTreeMap<String, usize> = BTreeMap::new();
    let [mut stable, mut slip, mut rows, mut without_images] = [0; 4];
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
        without_images += usize::from(result.lacks_images());
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
            "without_images": without_images,
            "outcomes": outcomes,
            "cpu_s": cpu_s,
            "estimated_open_cpu_s": open_s,
        }));
    }
    let outcomes: Vec<String> = outcomes
        .iter()
        .map(|(name, count)| format!("{count} {name}"))
        .collect();
    let missing = match without_images {
        0 => String::new(),
        count => format!(", {count} labelled without images"),
    };
    print(&format!(
        "{done} of {all} simulations done: {stable} stable, {slip} slip, {rows} renderings{missing}\n\
         outcomes: {}\n\
         {:.1} CPU hours used, about {:.1} to go",
        outcomes.join(", "),
        cpu_s / 3600.0,
        open_s / 3600.0
    ))
}
