//! `gripcast synth report`: what became of a plan, as a page and as JSON.
//!
//! Exit codes: 0 the report is there and the plan finished · 1 it could not be made · 2 usage · 3 it
//! was written, but simulations of the plan are open or could not be done · 130 interrupted.

use std::path::{Path, PathBuf};

use super::replay_report::write_report;
use super::working::interruptible;
use super::{Context, create_folder, print, print_json};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::workers::cores;
use gripcast_synth::plan::Plan;
use gripcast_synth::report::{SynthReport, SynthReportSettings, page, report};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the plan with its results
    #[arg(long, value_name = "DIR")]
    plan: PathBuf,
    /// Folder of the dataset that was merged from it
    #[arg(long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    /// Folder of the report: report.html and report.json
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Grasps of each label on the contact sheet
    #[arg(long, value_name = "N", default_value_t = 24,
        value_parser = clap::value_parser!(u16).range(0..=100))]
    examples: u16,
    /// Decides which grasps and renderings are looked at
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Simulations that are looked at at a time; the report does not depend on it [default: all
    /// cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
    /// Print the report without its images as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the verb.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let (out, is_json) = (args.out.clone(), args.json);
    let mut report = interruptible(context, "looking at the results", move |progress| {
        let plan = Plan::read(&args.plan)?;
        let settings = args.settings();
        report(&plan, &args.plan, &settings, &|done, all| {
            progress.at(done as u64, all as u64);
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
            jobs: self.jobs.map_or_else(cores, usize::from),
        }
    }
}

/// The result for people.
fn text(report: &SynthReport, out: &Path) -> String {
    let progress = &report.progress;
    let rate = report.costs.per_core_hour.map_or_else(String::new, |rate| {
        format!("; {rate:.0} simulations an hour on a core")
    });
    let mut text = format!(
        "{} of {} simulations done: {} held, {} lost, {} without a label{rate}\n",
        progress.done,
        report.plan.simulations,
        progress.labels.stable,
        progress.labels.slip,
        progress.done - progress.labels.total()
    );
    if let Some(dataset) = &report.dataset {
        for (name, part) in &dataset.merge.splits {
            text.push_str(&format!(
                "{name}: {} rows, {} simulations held, {} were lost\n",
                part.rows, part.stable, part.slip
            ));
        }
    }
    text.push_str(&out.join("report.html").display().to_string());
    text
}

/// The error of a report on a plan that is not finished.
fn finish(report: &SynthReport) -> Result<()> {
    let progress = &report.progress;
    if progress.open + progress.failed == 0 {
        return Ok(());
    }
    let mut what = format!(
        "{} simulations of the plan are open, {} could not be done",
        progress.open, progress.failed
    );
    if !progress.damaged.is_empty() {
        what.push_str(&format!(
            "; of the open ones, {} with a damaged result, {} first",
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
