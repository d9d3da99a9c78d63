//! `gripcast dataset edit`: corrects object, scene or operator of saved grasps.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::ArgGroup;

use super::dataset_text::counted;
use super::print_report;
use gripcast_base::error::Result;
use gripcast_base::files::{GraspId, Label, ObjectName};
use gripcast_dataset::{EditReport, NameChange, Selection, edit};

/// Arguments of `dataset edit`.
#[derive(Debug, clap::Args)]
#[command(group = ArgGroup::new("selection").args(["ids", "all_of"]).required(true))]
#[command(group = ArgGroup::new("names")
    .args(["object", "scene", "operator"])
    .required(true)
    .multiple(true))]
pub(super) struct Args {
    /// Folder of the dataset
    dataset: PathBuf,
    /// Grasps to change
    #[arg(value_name = "ID")]
    ids: Vec<GraspId>,
    /// Change all grasps of this object
    #[arg(long, value_name = "OBJECT")]
    all_of: Option<ObjectName>,
    /// New object name
    #[arg(long, value_name = "NAME")]
    object: Option<ObjectName>,
    /// New scene name; empty removes it
    #[arg(long, value_name = "NAME")]
    scene: Option<Label>,
    /// New name of the operator; empty removes it
    #[arg(long, value_name = "NAME")]
    operator: Option<Label>,
    /// Only print what would be done
    #[arg(long)]
    dry_run: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) fn run(args: &Args) -> Result<()> {
    let selection = match &args.all_of {
        Some(object) => Selection::Object(object.clone()),
        None => Selection::Ids(args.ids.clone()),
    };
    let names = NameChange {
        object: args.object.clone(),
        scene: args.scene.clone(),
        operator: args.operator.clone(),
    };
    let report = edit(&args.dataset, &selection, &names, args.dry_run)?;
    print_report(args.json, &report, text)
}

fn text(report: &EditReport) -> String {
    let mut text = String::new();
    let names = &report.names;
    for grasp in &report.changed {
        let _ = writeln!(text, "{}  {} → {names}", grasp.id, grasp.before);
    }
    let changed = counted(report.changed.len(), "grasp");
    let unchanged = match report.unchanged {
        0 => String::new(),
        count => format!("; {} had these names", counted(count, "grasp")),
    };
    let state = match report.dry_run {
        true => "would change; nothing was changed",
        false => "changed",
    };
    let _ = writeln!(text, "{changed} {state}{unchanged}");
    text
}
