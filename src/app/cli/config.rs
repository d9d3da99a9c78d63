//! `gripcast config show`: every setting, its value and where it comes from.

use super::{ConfigFlag, Context, print, print_json};
use crate::app::config;
use crate::error::Result;

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
        /// One JSON object on stdout
        #[arg(long)]
        json: bool,
    },
}

/// Runs the verb.
pub(crate) fn run(_context: &Context, args: Args) -> Result<()> {
    let Action::Show { file, json } = args.action;
    let layered = config::load(file.path().as_deref(), std::env::vars(), &[])?;
    if json {
        let object: serde_json::Map<String, serde_json::Value> = layered
            .values
            .iter()
            .map(|(key, (value, origin))| {
                let entry = serde_json::json!({"value": value, "origin": origin.to_string()});
                (key.clone(), entry)
            })
            .collect();
        print_json(&object)?;
    } else {
        for (key, (value, origin)) in &layered.values {
            print(&format!("{key:<32} {:<24} {origin}", value.to_string()))?;
        }
    }
    Ok(())
}
