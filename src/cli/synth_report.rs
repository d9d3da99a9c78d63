//! `gripcast synth report`: reports on a plan and its dataset, as HTML and JSON.
//!
//! Exit codes: 0 written, plan finished · 1 failed · 2 usage · 3 written, but simulations of the
//! plan are open or failed · 130 interrupted.

use std::path::{Path, PathBuf};

use super::flags::JobsFlag;
use super::replay_report::write_report;
use super::working::interruptible;
use super::{Context, create_folder, print, print_json};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_synth::plan::Plan;
use gripcast_synth::report::{SynthReport, SynthReportSettings, page, report};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the plan with its results
    #[arg(long, value_name = "DIR")]
    plan: PathBuf,
    /// Folder of the dataset merged from it
    #[arg(long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    /// Output directory of report.html and report.json
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Example grasps per label
    #[arg(long, value_name = "N", default_value_t = 24,
        value_parser = clap::value_parser!(u16).range(0..=100))]
    examples: u16,
    /// Random seed of the sampled grasps and renderings
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    jobs: JobsFlag,
    /// Print the report as JSON, without images
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let (out, is_json) = (args.out.clone(), args.json);
    let mut report = interruptible(context, "reading the results", move |progress| {
        let plan = Plan::read(&args.plan)?;
        let settings = args.settings();
        report(&plan, &args.plan, &settings, &|done, all| {
            progress.count(done, all);
        })
    })??;
    create_folder(&out)?;
    write_report(&report, &page(&report)?, &out)?;
    if is_json {
        report.examples.clear();
        print_json(&report)?;
    } else {
        print(&text(&report, &out))?;
    }
    finish(&report)
}

impl Args {
    fn settings(&self) -> SynthReportSettings {
        SynthReportSettings {
            dataset: self.dataset.clone(),
            examples: usize::from(self.examples),
            seed: self.seed,
            jobs: self.jobs.count(),
        }
    }
}

/// Formats the result.
fn text(report: &SynthReport, out: &Path) -> String {
    let progress = &report.progress;
    let rate = report.costs.per_core_hour.map_or_else(String::new, |rate| {
        format!("; {rate:.0} simulations per core hour")
    });
    let mut text = format!(
        "{} of {} simulations done: {} stable, {} slip, {} unlabelled{rate}\n",
        progress.done,
        report.plan.simulations,
        progress.labels.stable,
        progress.labels.slip,
        progress.done - progress.labels.total()
    );
    if let Some(dataset) = &report.dataset {
        for (name, split) in &dataset.merge.splits {
            text.push_str(&format!(
                "{name}: {} rows, {} stable, {} slip\n",
                split.rows, split.stable, split.slip
            ));
        }
    }
    text.push_str(&out.join("report.html").display().to_string());
    text
}

/// Returns an error for an unfinished plan.
fn finish(report: &SynthReport) -> Result<()> {
    let progress = &report.progress;
    if progress.open + progress.failed == 0 {
        return Ok(());
    }
    let mut what = format!(
        "{} simulations of the plan are open, {} failed",
        progress.open, progress.failed
    );
    if !progress.damaged.is_empty() {
        what.push_str(&format!(
            "; {} of the open ones have a damaged result, the first is {}",
            progress.damaged.len(),
            progress.damaged[0]
        ));
    }
    let error = Error::new(ErrorKind::Partial, what);
    Err(match progress.open {
        0 => error,
        _ => error.remedy("finish them with `gripcast synth run`"),
    })
}
