//! `gripcast dataset list`: lists the grasps of a dataset.
//!
//! ```text
//! gripcast dataset list D --object mug --outcome unlabelled
//! gripcast dataset list D --since 2026-11-20 --until 2026-11-21 --limit 100 --json
//! gripcast dataset list D --before ID      # the next page
//! ```
//!
//! Queries and JSON are those of `GET /api/grasps`.
//!
//! Exit codes: 0 done · 1 failed · 2 usage.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::flags::named;
use super::print_report;
use crate::web::{GraspList, GraspPage, GraspQuery};
use gripcast_base::error::Result;
use gripcast_base::files::ObjectName;
use gripcast_dataset::{GraspIndex, Outcome};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder of the dataset
    dataset: PathBuf,
    /// Only grasps of this object
    #[arg(long, value_name = "NAME")]
    object: Option<ObjectName>,
    /// Only grasps with this outcome
    #[arg(long, value_parser = named([
        ("stable", "The object stayed in the gripper", Outcome::Stable),
        ("slip", "The object slipped or fell", Outcome::Slip),
        ("unlabelled", "Not labelled yet", Outcome::Unlabelled),
    ]))]
    outcome: Option<Outcome>,
    /// Only grasps taken at or after this time (RFC 3339), or date (UTC)
    #[arg(long, value_name = "TIME")]
    since: Option<String>,
    /// Only grasps taken before this time (RFC 3339), or date (UTC)
    #[arg(long, value_name = "TIME")]
    until: Option<String>,
    /// Only grasps older than this one: the next page
    #[arg(long, value_name = "ID")]
    before: Option<String>,
    /// Maximum number of grasps, 1 to 500
    #[arg(long, value_name = "N", default_value_t = 24)]
    limit: usize,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) fn run(args: &Args) -> Result<()> {
    let query = GraspQuery {
        limit: Some(args.limit),
        before: args.before.clone(),
        object: args.object.clone(),
        outcome: args.outcome,
        disagree: None,
        since: args.since.clone(),
        until: args.until.clone(),
    };
    let page = GraspList::new(GraspIndex::new(&args.dataset)).page(&query)?;
    print_report(args.json, &page, text)
}

fn text(page: &GraspPage) -> String {
    let mut text = String::new();
    for grasp in &page.grasps {
        let _ = writeln!(
            text,
            "{}  {:<10}  {}",
            grasp.id, grasp.outcome, grasp.object
        );
    }
    if let Some(next) = &page.next {
        let _ = writeln!(text, "older: `--before {next}`");
    }
    text
}
