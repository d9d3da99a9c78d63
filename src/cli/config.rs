//! `gripcast config show`: every setting with its value and origin.

use serde_json::json;
use toml::Value;

use super::{ConfigFlag, print_report};
use crate::config::{Ignored, Layered, Origin};
use gripcast_base::error::Result;

/// Arguments of `config`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Print every key, its value and its origin
    Show {
        #[command(flatten)]
        file: ConfigFlag,
        /// Print the result as JSON
        #[arg(long)]
        json: bool,
    },
}

/// Runs the command.
pub(crate) fn run(args: Args) -> Result<()> {
    let Action::Show { file, json } = args.action;
    let layered = file.load(&[])?;
    let entry = |(key, (value, origin)): (&String, &(Value, Origin))| {
        let mut entry = json!({"value": value, "origin": origin.to_string()});
        if let Some(Ignored { value, file }) = layered.ignored.get(key) {
            entry["ignored"] = json!({"value": value, "file": file});
        }
        (key.clone(), entry)
    };
    let entries: serde_json::Map<_, _> = layered.values.iter().map(entry).collect();
    print_report(json, &entries, |_| text(&layered))
}

fn text(layered: &Layered) -> String {
    let line = |(key, (value, origin)): (&String, &(Value, Origin))| {
        let ignored = layered.ignored.get(key);
        let ignored = ignored.map_or_else(String::new, |Ignored { value, file }| {
            format!("; {value} in {} is ignored", file.display())
        });
        format!("{key:<32} {:<24} {origin}{ignored}", value.to_string())
    };
    let lines: Vec<String> = layered.values.iter().map(line).collect();
    lines.join("\n")
}
