//! `gripcast sim validate`: validates the simulator against theory and converged finite elements.
//!
//! ```text
//! gripcast sim validate --quick
//! gripcast sim validate --cases press-plate,incline --json
//! ```
//!
//! Every check has an expected value, a measured value and a tolerance.
//!
//! Exit codes: 0 all passed · 2 unknown case · 4 a check failed · 130 interrupted.

use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_sim::validate::{self, CaseResult, Effort, Report, Tolerance};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Case groups, comma-separated [default: all]
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    cases: Vec<String>,
    /// Use coarser meshes, fewer grasps and wider tolerances
    #[arg(long)]
    quick: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    validate::check_names(&args.cases)?;
    let effort = if args.quick {
        Effort::Quick
    } else {
        Effort::Full
    };
    let names = args.cases.clone();
    let report = interruptible(context, "validating", move |progress| {
        let is_wanted = |name: &&str| names.is_empty() || names.iter().any(|n| n == *name);
        let groups: Vec<&str> = validate::case_names()
            .into_iter()
            .filter(is_wanted)
            .collect();
        let mut report = Report::default();
        for (done, group) in groups.iter().enumerate() {
            progress.count(done, groups.len());
            progress.line(*group);
            report.add(validate::run(&[(*group).to_owned()], effort)?.cases);
        }
        Ok::<_, Error>(report)
    })??;
    print_report(args.json, &report, text)?;
    if report.failed == 0 {
        return Ok(());
    }
    let all = report.cases.len();
    Err(Error::new(
        ErrorKind::Check,
        format!("{} of {all} checks failed", report.failed),
    ))
}

fn text(report: &Report) -> String {
    let widest = report.cases.iter().map(|case| case.name.len()).max();
    let width = widest.unwrap_or(0);
    let mut lines: Vec<String> = report.cases.iter().map(|case| line(case, width)).collect();
    lines.push(format!(
        "{} passed, {} failed",
        report.passed, report.failed
    ));
    lines.join("\n")
}

fn line(case: &CaseResult, width: usize) -> String {
    let mark = if case.passed { "ok  " } else { "FAIL" };
    let tolerance = match case.tolerance {
        Tolerance::Absolute(limit) => format!("within {limit} {}", case.unit),
        Tolerance::Relative(fraction) => format!("within {} %", 100.0 * fraction),
        Tolerance::AtLeast => "at least".to_owned(),
        Tolerance::Informational => "stated".to_owned(),
    };
    format!(
        "{mark} {:<width$}  expected {:>11} found {:>11} {}  {tolerance}",
        case.name,
        short(case.expected),
        short(case.found),
        case.unit,
    )
}

/// Formats a number with few digits whatever its size.
fn short(value: f64) -> String {
    if value == 0.0 || (1e-3..1e5).contains(&value.abs()) {
        format!("{value:.5}")
    } else {
        format!("{value:.4e}")
    }
}
