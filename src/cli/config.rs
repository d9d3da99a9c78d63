//! `gripcast config show`: every setting, its value and where it comes from.

use super::{ConfigFlag, Context, print, print_json};
use crate::config::Ignored;
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
        /// One JSON object on stdout
        #[arg(long)]
        json: bool,
    },
}

/// Runs the verb.
pub(crate) fn run(_context: &Context, args: Args) -> Result<()> {
    let Action::Show { file, json } = args.action;
    let layered = file.load(&[])?;
    if json {
        let object: serde_json::Map<String, serde_json::Value> = layered
            .values
            .iter()
            .map(|(key, (value, origin))| {
                let mut entry = serde_json::json!({"value": value, "origin": origin.to_string()});
                if let Some(Ignored { value, file }) = layered.ignored.get(key) {
                    entry["ignored"] = serde_json::json!({"value": value, "file": file});
                }
                (key.clone(), entry)
            })
            .collect();
        print_json(&object)?;
    } else {
        for (key, (value, origin)) in &layered.values {
            let ignored = layered
                .ignored
                .get(key)
                .map_or_else(String::new, |ignored| {
                    format!(
                        "; {} in {} is ignored",
                        ignored.value,
                        ignored.file.display()
                    )
                });
            print(&format!(
                "{key:<32} {:<24} {origin}{ignored}",
                value.to_string()
            ))?;
        }
    }
    Ok(())
}
